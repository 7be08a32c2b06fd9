// SPDX-License-Identifier: Apache-2.0
// One robot on BLE Mesh: three vendor models, an on/off server and a health server. No radio and no
// clock: BleNetwork carries what it transmits and tells it whether the board can hear.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "simulation/ble/access.hpp"
#include "simulation/robot_body.hpp"
#include "simulation/tally.hpp"

namespace slamgw::sim::ble {

constexpr std::chrono::seconds reliable_timeout{60};
constexpr std::chrono::seconds health_interval{10};
constexpr std::chrono::seconds same_transaction{6};  ///< Generic OnOff: same TID, same command

struct RobotSettings {
  Address address = first_robot;
  std::uint8_t ttl = default_ttl;
  bool is_acknowledged = false;  ///< SET with repeats until STATUS, else SET_UNRELIABLE
  bool is_unicast = false;       ///< publishes to the gateway instead of to groups
  bool has_segment_timing = false;
  bool obeys = false;
  std::optional<std::uint64_t> messages;  ///< updates to send; nothing: no end
  Duration period = std::chrono::milliseconds{200};
};

class Robot {
 public:
  struct Outgoing {
    MeshMessage message;
    bool is_unacknowledged_update = false;
  };
  /// What the robot can know of the gateway: nothing while it is not ready.
  struct Gateway {
    bool is_ready = false;  ///< to hear this robot's updates
    Address address = 0;    ///< 0: none yet
  };

  Robot(RobotSettings settings, RobotBody body);

  /// The address that this robot's updates go to.
  Address update_destination(Address gateway) const {
    return settings_.is_unicast ? gateway : sensor_update_group;
  }

  void on_start(TimePoint now);
  void on_deadline(Gateway gateway, TimePoint now);
  void on_message(const MeshMessage& message, TimePoint now);
  /// An unacknowledged update got lost on the air.
  void on_update_dropped() { ++tally_.lost; }
  TimePoint deadline() const;
  std::optional<Outgoing> next_transmission();

  bool has_sent_everything() const;
  const Tally& tally() const { return tally_; }

 private:
  /// A reliable message that waits for its STATUS; one at a time, as in Nordic's access layer.
  struct Reliable {
    MeshMessage message;
    Vendor status;
    bool is_update;
    Duration interval;
    TimePoint repeat_at;
    TimePoint gives_up_at;
  };

  void produce(Gateway gateway, TimePoint now);
  void publish(bool is_update, const Bytes& parameters, Gateway gateway, TimePoint now);
  void repeat(TimePoint now);
  void transmit(const MeshMessage& message, TimePoint now);
  bool may_transmit(const MeshMessage& message, TimePoint now) const;
  void on_vendor(Vendor opcode, const MeshMessage& message, TimePoint now);
  void on_on_off(const MeshMessage& message, ByteView parameters, bool is_simple, bool wants_status,
                 TimePoint now);
  void answer(const MeshMessage& request, Bytes payload);

  RobotSettings settings_;
  RobotBody body_;
  bool has_introduced_itself_ = false;
  TimePoint next_update_{};
  TimePoint next_health_{};
  std::uint64_t produced_ = 0;
  std::optional<Reliable> reliable_;
  TimePoint segmented_until_{};  ///< --segment-timing: no other segmented message before
  bool is_on_ = true;
  struct Transaction {
    Address source;
    std::uint8_t tid;
    TimePoint at;
  };
  std::optional<Transaction> last_transaction_;
  std::deque<Outgoing> outbox_;
  Tally tally_;
};

}  // namespace slamgw::sim::ble
