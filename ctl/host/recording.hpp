// SPDX-License-Identifier: Apache-2.0
// A recording of robots' messages, the lines of `slam-gatewayctl --json watch`; and its replay to a
// broker with the recorded timing, for developing servers without robots.
#pragma once

#include <chrono>
#include <fstream>
#include <istream>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/mqtt/settings.hpp"

namespace slamgw::ctl {

/// A robot's message, and its time after the first message of the recording.
struct RecordedMessage {
  std::chrono::microseconds after{0};
  BrokerMessage message;
};

/// Parses the `at` of a watch event, `2026-11-21T06:31:07.042137Z` with any number of digits for
/// the fraction, or none. Returns the time since 1970.
std::optional<std::chrono::microseconds> parse_event_time(const std::string& text);

/// Returns whether a watch event belongs in a recording: a message from or to a robot, or the
/// number of lost events.
bool is_recorded(const nlohmann::json& event);

/// Opens a recording for more lines; a last line that was cut ends before them. Throws Failure when
/// the file can't be written.
std::ofstream open_recording(const std::string& path);

/// Returns robots' messages (`arrived`) that were published unchanged, in the order of time. Throws
/// Failure that names the line if the text is not a recording.
std::vector<RecordedMessage> read_recording(std::istream& in, const std::string& name);

struct Replayed {
  std::uint64_t published = 0;
  std::uint64_t refused = 0;
  std::string why;  ///< why the broker refused the last refused message
};

/// Returns when the broker has taken the last message. `speed`: 2 is twice as fast. Throws Failure
/// when the broker can't be reached or goes away. `is_user_typed`: no file names the user, so
/// failures name none.
Replayed replay(std::vector<RecordedMessage> messages, BrokerSettings broker, double speed,
                bool is_user_typed = false);

}  // namespace slamgw::ctl
