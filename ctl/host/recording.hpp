// SPDX-License-Identifier: Apache-2.0
// A recording of robots' messages, the lines of `slam-gatewayctl --json watch`; and its replay to a
// broker with the recorded timing, for those who develop servers without robots.
#pragma once

#include <chrono>
#include <istream>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/mqtt/settings.hpp"

namespace slamgw::ctl {

/// A robot's message and when it came, after the first one of the recording.
struct RecordedMessage {
  std::chrono::microseconds after{0};
  BrokerMessage message;
};

/// The `at` of a watch event, `2026-11-21T06:31:07.042137Z` with any number of digits for the
/// fraction, or none: since 1970.
std::optional<std::chrono::microseconds> parse_event_time(const std::string& text);

/// Whether a watch event belongs into a recording: a message of a robot or to one, or how many
/// events were lost.
bool is_recorded(const nlohmann::json& event);

/// The messages of robots (`arrived`) that went up as they came, in the order of time. Throws
/// Failure that names the line for what is no recording.
std::vector<RecordedMessage> read_recording(std::istream& in, const std::string& name);

struct Replayed {
  std::uint64_t published = 0;
  std::uint64_t refused = 0;
  std::string why;  ///< of the last one that was refused
};

/// Returns when the broker has taken the last message. `speed`: 2 is twice as fast. Throws Failure
/// when the broker is not reached, or goes away. `is_user_typed`: no file has the user.
Replayed replay(std::vector<RecordedMessage> messages, BrokerSettings broker, double speed,
                bool is_user_typed = false);

}  // namespace slamgw::ctl
