// SPDX-License-Identifier: Apache-2.0
#include "ctl/host/recording.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <ctime>
#include <optional>

#include "ctl/connection.hpp"
#include "ctl/text.hpp"
#include "daemon/control/wire.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::ctl {
namespace {

using nlohmann::json;
using std::chrono::microseconds;

/// `2026-11-21T06:31:07.042137Z`, with any number of digits for the fraction, or none.
std::optional<microseconds> parse_time(const std::string& text) {
  std::tm time{};
  int length = 0;
  const int fields =
      std::sscanf(text.c_str(), "%4d-%2d-%2dT%2d:%2d:%2d%n", &time.tm_year, &time.tm_mon,
                  &time.tm_mday, &time.tm_hour, &time.tm_min, &time.tm_sec, &length);
  if (fields != 6) return std::nullopt;
  time.tm_year -= 1900;
  time.tm_mon -= 1;
  microseconds parsed = std::chrono::seconds(timegm(&time));
  std::size_t at = static_cast<std::size_t>(length);
  if (at < text.size() && text[at] == '.') {
    microseconds unit{100000};
    for (++at; at < text.size() && text[at] >= '0' && text[at] <= '9'; ++at, unit /= 10)
      parsed += unit * (text[at] - '0');
  }
  return text.substr(at) == "Z" ? std::optional(parsed) : std::nullopt;
}

std::optional<BrokerMessage> message_of(const json& event) {
  const auto payload = control::parse_hex(text_at(event, "payload"));
  const std::string topic = text_at(event, "topic");
  const std::uint64_t qos = count_at(event, "qos");
  if (!event.contains("payload") || !payload || !is_valid_topic_name(topic) || qos > 2)
    return std::nullopt;
  return BrokerMessage{topic, *payload, static_cast<Qos>(qos), false, {}};
}

/// The clock was set while it was recorded, for instance on a host that starts without the time:
/// waiting it out would look like a replay that hangs.
void check_gaps(const std::vector<RecordedMessage>& messages, const std::string& name) {
  constexpr std::chrono::days longest{30};
  for (std::size_t i = 1; i < messages.size(); ++i) {
    const auto gap = messages[i].after - messages[i - 1].after;
    if (gap > longest)
      throw Failure(
          fmt::format("{}: {} days lie between messages {} and {} in order of time, so the "
                      "clock was set meanwhile; remove the lines on one side of it",
                      name, std::chrono::floor<std::chrono::days>(gap).count(), i, i + 1));
  }
}

}  // namespace

bool is_recorded(const json& event) {
  const std::string kind = text_at(event, "event");
  return kind == "arrived" || kind == "command" || kind == "lost";
}

std::vector<RecordedMessage> read_recording(std::istream& in, const std::string& name) {
  std::vector<RecordedMessage> messages;
  std::size_t number = 0;
  for (std::string line; std::getline(in, line);) {
    ++number;
    if (line.empty()) continue;
    const json event = json::parse(line, nullptr, false);
    const auto at = event.is_object() ? parse_time(text_at(event, "at")) : std::nullopt;
    // One with a reason was not published as it came: no server has seen it on its topic.
    const bool is_message =
        event.is_object() && text_at(event, "event") == "arrived" && text_at(event, "why").empty();
    const auto message = is_message ? message_of(event) : std::nullopt;
    const bool is_cut = event.is_discarded() && in.eof();  // the program that wrote it was killed
    if (is_cut && number > 1) break;
    if (!at || (is_message && !message))
      throw Failure(
          fmt::format("{}:{}: is no line that slam-gatewayctl record writes", name, number));
    if (message) messages.push_back({*at, *message});
  }
  std::ranges::stable_sort(messages, {}, &RecordedMessage::after);
  check_gaps(messages, name);
  if (!messages.empty()) {
    const microseconds first = messages.front().after;
    for (RecordedMessage& message : messages) message.after -= first;
  }
  return messages;
}

}  // namespace slamgw::ctl
