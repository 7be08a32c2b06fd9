// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/connect_failure.hpp"

#include <fmt/format.h>
#include <mosquitto.h>

#include <array>
#include <cctype>
#include <string_view>

namespace slamgw {
namespace {

/// Returns the reason code of MQTT 5 that means the same as a return code of MQTT 3.1.1 (section
/// 3.2.2.3).
int as_reason(int code) {
  constexpr std::array reasons{0, 0x84, 0x85, 0x88, 0x86, 0x87};
  return code > 0 && code < 6 ? reasons[static_cast<std::size_t>(code)] : code;
}

/// Returns the standard's words for a reason code; nothing for a code that is not a failure.
std::string_view words_of(int reason) {
  const std::string_view words = mosquitto_reason_string(reason);
  return reason < 0x80 || words.starts_with("Unknown") ? std::string_view() : words;
}

}  // namespace

std::string explain_connect_failure(int code) {
  switch (as_reason(code)) {
    case 0x84: return "the broker does not speak this version of MQTT";
    case 0x85: return "the broker refuses the client id";
    case 0x86: return "the broker refuses user name or password";
    case 0x87: return "the broker does not authorise this user";
    case 0x88: return "the broker is not available";
    case 0x89: return "the broker is busy";
    case 0x8b: return "the broker shuts down";
  }
  const std::string_view words = words_of(code);
  if (words.empty()) return fmt::format("the broker refuses with code 0x{:02x}", code);
  return fmt::format("the broker refuses: {}", words);
}

std::string explain_rival(const std::string& client_id) {
  return fmt::format(
      "another client connects as '{}': give each gateway its own gateway.id or "
      "broker.client_id",
      client_id);
}

bool is_version_refusal(int code) { return as_reason(code) == 0x84; }

bool is_not_authorised(int code) { return as_reason(code) == 0x86 || as_reason(code) == 0x87; }

std::string explain_publish_refusal(int reason_code) {
  if (reason_code == 0x87) return "not authorised";
  std::string words(words_of(reason_code));
  for (char& each : words) each = static_cast<char>(std::tolower(each));
  return words.empty() ? "no reason given" : words;
}

}  // namespace slamgw
