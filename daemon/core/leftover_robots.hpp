// SPDX-License-Identifier: Apache-2.0
// Robots whose retained presence an earlier process left as online. PresencePublisher marks those
// robots as offline that are not heard again soon. Pure; part of Gateway.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/messages.hpp"

namespace slamgw {

class LeftoverRobots {
 public:
  /// Time from the first connection to the broker in which living robots are heard. BLE robots send
  /// a health status every 10 s; sessions of MQTT-SN clients are restored at the start.
  static constexpr std::chrono::seconds grace{40};
  static constexpr std::size_t max_robots = 10000;
  /// Ten times the size of a presence that the gateway writes; no gateway wrote a larger one.
  static constexpr std::size_t max_octets = 4096;

  /// `root`: the beginning of the topics of this gateway's presence.
  explicit LeftoverRobots(std::string root) : root_(std::move(root)) {}

  void on_broker_up(TimePoint now);
  /// True when the message is a presence of this gateway; the caller drops it.
  bool take(const BrokerMessage& message);

  struct Leftover {
    std::string robot;
    std::string presence;  ///< the JSON as it was retained
  };
  std::optional<TimePoint> deadline() const;
  /// Returns the leftovers once, when `grace` is over.
  std::optional<std::vector<Leftover>> finish(TimePoint now);

 private:
  std::string root_;
  bool is_collecting_ = true;  ///< until finish()
  std::optional<TimePoint> up_since_;
  std::map<std::string, std::string> found_;
};

}  // namespace slamgw
