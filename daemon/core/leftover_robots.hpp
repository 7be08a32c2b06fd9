// SPDX-License-Identifier: Apache-2.0
// Robots that an earlier life of the daemon left behind as online in their retained presence: those
// that are not heard again soon are to be called offline. Pure; part of Gateway.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/messages.hpp"

namespace slamgw {

class LeftoverRobots {
 public:
  /// After the broker was reached first. BLE robots that live are heard within it (a health status
  /// every 10 s), sessions of MQTT-SN clients are there from the start.
  static constexpr std::chrono::seconds grace{40};
  static constexpr std::size_t max_robots = 10000;
  /// Ten times what the gateway says of a robot; a larger one is not its own.
  static constexpr std::size_t max_octets = 4096;

  /// `filter` matches the retained presence of all robots of this gateway.
  explicit LeftoverRobots(std::string filter) : filter_(std::move(filter)) {}

  const std::string& filter() const { return filter_; }
  /// Whether it still looks; until then its filter is to be subscribed.
  bool is_looking() const { return is_looking_; }
  void on_broker_up(TimePoint now);
  /// True when the message is a presence; the caller drops it.
  bool take(const BrokerMessage& message);

  struct Leftover {
    std::string robot;
    std::string presence;  ///< the JSON as it was retained, not offline
  };
  std::optional<TimePoint> deadline() const;
  /// Once, when the time has come; ends the looking.
  std::optional<std::vector<Leftover>> finish(TimePoint now);

 private:
  std::string filter_;
  bool is_looking_ = true;
  std::optional<TimePoint> up_since_;
  std::map<std::string, std::string> found_;
};

}  // namespace slamgw
