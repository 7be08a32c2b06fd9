// SPDX-License-Identifier: Apache-2.0
// A robot's heartbeats as Nordic's firmware has them (Mesh Profile 1.0 sections 3.6.7 and 4.3.2.61
// to 4.3.2.66): publishes some, and counts those of one source. No radio: Network carries.
#pragma once

#include <optional>
#include <string>

#include "simulation/ble/firmware.hpp"
#include "simulation/ble/robot/config_message.hpp"

namespace slamgw::sim::ble {

class Heartbeats {
 public:
  explicit Heartbeats(const Firmware& firmware) : firmware_(&firmware) {}

  /// Returns nothing for messages of other parts.
  std::optional<Answer> on_message(ByteView message, const NodeConfiguration& configuration,
                                   TimePoint now);
  const std::optional<std::string>& failed_assertion() const { return failed_assertion_; }
  /// Call when the robot has sent a message.
  void on_transmitted();
  std::optional<TimePoint> deadline() const { return next_at_; }
  void on_deadline(TimePoint now);

  struct Heartbeat {
    Address destination = 0;
    std::uint8_t ttl = 0;
  };
  std::optional<Heartbeat> next() { return std::exchange(next_, std::nullopt); }
  bool hears(Address destination, const NodeConfiguration& configuration) const;
  /// Call when it receives a heartbeat. `hops`: 1 without relays.
  void on_heartbeat(Address source, Address destination, std::uint8_t hops, TimePoint now);
  void reset() { *this = Heartbeats(*firmware_); }

 private:
  static constexpr std::uint8_t no_min_hops = 0x7f;
  struct Publication {
    Address destination = 0;
    std::uint32_t count = 0;
    std::uint32_t period_s = 0;
    std::uint8_t ttl = 0;
    std::uint16_t features = 0;
    std::uint16_t net_key_index = 0;
  };
  struct Subscription {
    Address source = 0;
    Address destination = 0;
    std::uint32_t count = 0;
    std::uint8_t min_hops = no_min_hops;
    std::uint8_t max_hops = 0;
  };

  Answer publication_get(ByteView parameters);
  Answer publication_set(ByteView parameters);
  Answer subscription_get(ByteView parameters);
  Answer subscription_set(ByteView parameters);
  void start();
  void publish();
  Bytes subscription_status() const;
  std::uint32_t seconds_left() const;

  const Firmware* firmware_;
  const NodeConfiguration* configuration_ = nullptr;  ///< set while a message is answered
  TimePoint now_{};                                   ///< likewise
  std::optional<std::string> failed_assertion_;
  Publication publication_;
  bool waits_for_transmission_ = false;  ///< for the first one
  std::optional<TimePoint> next_at_;
  std::optional<Heartbeat> next_;
  Subscription subscription_;
  TimePoint counts_until_{};
};

}  // namespace slamgw::sim::ble
