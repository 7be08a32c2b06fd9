// SPDX-License-Identifier: Apache-2.0
// A recording of robots' messages: the lines of `slam-gatewayctl --json watch`, one JSON document
// each. Pure.
#pragma once

#include <chrono>
#include <istream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "daemon/core/messages.hpp"

namespace slamgw::ctl {

/// A robot's message and when it came, after the first one of the recording.
struct RecordedMessage {
  std::chrono::microseconds after{0};
  BrokerMessage message;
};

/// Whether a watch event belongs into a recording: a message of a robot or to one, or how many
/// events were lost.
bool is_recorded(const nlohmann::json& event);

/// The messages of robots (`arrived`) that went up as they came, in the order of time. Throws
/// Failure that names the line for what is no recording.
std::vector<RecordedMessage> read_recording(std::istream& in, const std::string& name);

}  // namespace slamgw::ctl
