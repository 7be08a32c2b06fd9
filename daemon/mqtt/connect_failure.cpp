// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/connect_failure.hpp"

#include <fmt/format.h>

#include <array>
#include <string_view>

namespace slamgw {
namespace {

struct Words {
  int code;
  std::string_view text;
};

// MQTT 3.1.1 section 3.2.2.3, MQTT 5 section 3.2.2.2.
constexpr std::array connect_words{
    Words{1, "does not speak this version of MQTT"},
    Words{2, "refuses the client id"},
    Words{3, "is not available"},
    Words{4, "refuses user name or password"},
    Words{5, "does not authorise this user"},
    Words{0x80, "refuses without a reason"},
    Words{0x81, "reports a malformed CONNECT"},
    Words{0x82, "reports a protocol error"},
    Words{0x84, "does not speak this version of MQTT"},
    Words{0x85, "refuses the client id"},
    Words{0x86, "refuses user name or password"},
    Words{0x87, "does not authorise this user"},
    Words{0x88, "is not available"},
    Words{0x89, "is busy"},
    Words{0x8a, "has banned this client"},
    Words{0x8b, "shuts down"},
    Words{0x8c, "refuses the authentication method"},
    Words{0x90, "refuses the last will's topic"},
    Words{0x95, "reports that the CONNECT is too large"},
    Words{0x97, "reports an exceeded quota"},
    Words{0x9a, "does not keep retained messages"},
    Words{0x9b, "does not support the last will's QoS"},
    Words{0x9c, "asks to use another server"},
    Words{0x9d, "has moved to another server"},
    Words{0x9f, "limits the connection rate"},
};

constexpr std::array publish_words{
    Words{0x80, "unspecified error"}, Words{0x83, "implementation specific error"},
    Words{0x87, "not authorised"},    Words{0x90, "topic name invalid"},
    Words{0x91, "packet id in use"},  Words{0x95, "packet too large"},
    Words{0x97, "quota exceeded"},    Words{0x99, "payload format invalid"},
};

template <std::size_t n>
std::string_view find(const std::array<Words, n>& table, int code) {
  for (const Words& words : table) {
    if (words.code == code) return words.text;
  }
  return {};
}

}  // namespace

std::string explain_connect_failure(int code) {
  if (const std::string_view words = find(connect_words, code); !words.empty()) {
    return fmt::format("the broker {}", words);
  }
  return fmt::format("the broker refuses with code 0x{:02x}", code);
}

std::string explain_rival(const std::string& client_id) {
  return fmt::format(
      "another client connects as '{}': give each gateway its own gateway.id or "
      "broker.client_id",
      client_id);
}

bool is_version_refusal(int code) { return code == 1 || code == 0x84; }

bool is_not_authorised(int code) { return code == 4 || code == 5 || code == 0x86 || code == 0x87; }

std::string explain_publish_refusal(int reason_code) {
  const std::string_view words = find(publish_words, reason_code);
  return words.empty() ? "no reason given" : std::string(words);
}

}  // namespace slamgw
