// SPDX-License-Identifier: Apache-2.0
// The payload of each message of the load: its client, its number, and when it was due. Not a wire
// format: both ends are this machine.
#pragma once

#include <chrono>
#include <cstdint>
#include <cstring>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <fmt/format.h>

namespace slamgw::bench {

using Clock = std::chrono::steady_clock;  // CLOCK_MONOTONIC: the same in every process
using Bytes = std::vector<std::uint8_t>;
using ByteView = std::span<const std::uint8_t>;

struct Message {
  std::int64_t due_ns = 0;  ///< when it should have been sent, by Clock
  std::uint32_t run = 0;    ///< separates late messages of another run
  std::uint32_t client = 0;
  std::uint32_t sequence = 0;  ///< from 0, for each client
  std::uint32_t unused = 0;
};
constexpr std::size_t payload_bytes = 24;
static_assert(sizeof(Message) == payload_bytes);

inline std::int64_t to_ns(Clock::time_point time) {
  return std::chrono::nanoseconds(time.time_since_epoch()).count();
}

inline Bytes to_payload(const Message& message) {
  Bytes payload(payload_bytes);
  std::memcpy(payload.data(), &message, payload_bytes);
  return payload;
}

inline std::optional<Message> from_payload(ByteView payload) {
  if (payload.size() != payload_bytes) return std::nullopt;
  Message message;
  std::memcpy(&message, payload.data(), payload_bytes);
  return message;
}

/// MQTT-SN client id of a client, and the id in its topic.
inline std::string robot_id(std::size_t client) { return fmt::format("load-{:05}", client); }
inline std::string topic_of(std::size_t client) {
  return "ntnu-slam/robot/" + robot_id(client) + "/load";
}
inline const std::string every_topic = "ntnu-slam/robot/+/load";

}  // namespace slamgw::bench
