// SPDX-License-Identifier: Apache-2.0
// Robots whose retained presence an earlier process left as online. Those that are not heard again
// soon are to be marked offline. Pure; part of Gateway.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/messages.hpp"

namespace slamgw {

class LeftoverRobots {
 public:
  /// From the first connection to the broker on. Living BLE robots are heard within it (a health
  /// status every 10 s); sessions of MQTT-SN clients are restored at the start.
  static constexpr std::chrono::seconds grace{40};
  /// After its SUBACK the broker sends what it has retained: when nothing more of it has come for
  /// so long, the subscription can end. While it stands, the broker sends back each presence that
  /// the gateway publishes.
  static constexpr std::chrono::seconds retained_patience{5};
  static constexpr std::size_t max_robots = 10000;
  /// Ten times the size of a presence that the gateway writes; a larger one is not ours.
  static constexpr std::size_t max_octets = 4096;

  /// `filter` matches the retained presence of all robots of this gateway.
  explicit LeftoverRobots(std::string filter) : filter_(std::move(filter)) {}

  const std::string& filter() const { return filter_; }
  /// True until finish(). Until then the gateway subscribes to `filter` at each new connection.
  bool is_collecting() const { return is_collecting_; }
  void on_broker_up(TimePoint now);
  /// The broker has granted `filter`, perhaps this one.
  void on_granted(const std::string& filter, TimePoint now);
  /// True when the message is a presence; the caller drops it.
  bool take(const BrokerMessage& message, TimePoint now);
  /// True once for each connection: the filter is to be unsubscribed.
  bool end_subscription(TimePoint now);

  struct Leftover {
    std::string robot;
    std::string presence;  ///< the JSON as it was retained, not offline
  };
  std::optional<TimePoint> deadline() const;
  /// Returns the leftovers once, when `grace` is over.
  std::optional<std::vector<Leftover>> finish(TimePoint now);

 private:
  std::string filter_;
  bool is_collecting_ = true;
  std::optional<TimePoint> up_since_;
  bool is_subscribed_ = false;
  std::optional<TimePoint> quiet_at_;
  std::map<std::string, std::string> found_;
};

}  // namespace slamgw
