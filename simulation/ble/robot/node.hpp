// SPDX-License-Identifier: Apache-2.0
// The mesh stack of one robot: beacons while it is unprovisioned, its end of a provisioning link,
// then keys, sequence numbers and replay protection, and the configuration server. What the robot's
// models say and understand is Robot. No radio and no clock: Network carries.
#pragma once

#include <deque>
#include <optional>

#include "simulation/ble/replay_list.hpp"
#include "simulation/ble/robot/config_server.hpp"
#include "simulation/ble/robot/heartbeats.hpp"
#include "simulation/ble/robot/provisionee.hpp"
#include "simulation/ble/robot/robot.hpp"

namespace slamgw::sim::ble {

class Node {
 public:
  static constexpr std::chrono::seconds beacon_interval{1};
  /// The robot begins when its configuration has not changed for so long.
  static constexpr std::chrono::seconds settling_time{1};

  struct Settings {
    const Firmware* firmware = &firmware_3_1_0;
    Key uuid{};
    unsigned number = 1;  ///< of the robot, from 1
    std::optional<Key> static_oob;
    /// Not provisioned but in the mesh from the start, with this address and whatever keys the
    /// board has; takes no configuration.
    std::optional<Address> fixed_address;
  };

  Node(const Settings& settings, Random random);

  void on_start(TimePoint now);
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);
  /// The UUID to be sent as an unprovisioned device's beacon.
  std::optional<Key> next_beacon();

  /// True when `open` is for this device, or the link is its own.
  bool takes(const LinkSignal& signal) const;
  void on_link_signal(const LinkSignal& signal, TimePoint now);
  std::optional<LinkSignal> next_link_signal();

  /// It acknowledges the segments of this message: the network key and the address are its own, and
  /// replay protection lets them pass.
  bool acknowledges(const MeshMessage& message) const;
  /// It understands an acknowledgement of its own segments, and replay protection lets it pass.
  bool would_accept(Address source, const SegmentAcknowledgement& acknowledgement) const {
    return (settings_.fixed_address || configuration_.has_net_key(acknowledgement.net_key)) &&
           heard_.would_accept(source, acknowledgement.sequence);
  }
  /// True when the robot's models shall see it; configuration messages are answered here.
  bool on_message(const MeshMessage& message, TimePoint now);
  std::optional<MeshMessage> next_answer();
  /// Gives a model's message its source, keys and sequence number; false when the node can't send
  /// it.
  bool prepare(MeshMessage& message);

  /// A message of the node has left.
  void on_transmitted() { heartbeats_.on_transmitted(); }
  std::optional<Heartbeats::Heartbeat> next_heartbeat();
  /// A heartbeat of another node has come. Returns false when this node does not hear it.
  void on_heartbeat(const Node& source, const Heartbeats::Heartbeat& heartbeat, std::uint8_t hops,
                    TimePoint now);
  bool is_relay() const { return !is_gone() && address() != 0 && configuration_.relay == 1; }

  /// The assertion that its firmware has failed, once: from then on the node is gone.
  const std::optional<std::string>& failed_assertion() const { return failed_assertion_; }

  /// That it sends under; nothing for the keys that the board has.
  std::optional<Key> net_key() const;

  /// What the configuration lets the robot publish at this time.
  Robot::Publications publications(TimePoint now) const;
  /// 0 while unprovisioned.
  Address address() const;
  unsigned number() const { return settings_.number; }

  const NodeConfiguration& configuration() const { return configuration_; }
  std::uint32_t next_sequence() const { return next_sequence_; }
  /// Switched off and on: what it heard is forgotten, what it was told is not.
  void power_cycle();
  /// By hand, as its owner does: an unprovisioned device again, whose sequence number begins anew.
  void reset_by_hand(TimePoint now);
  /// Before the start, from a state file.
  void restore(NodeConfiguration configuration, std::uint32_t next_sequence);

 private:
  bool is_gone() const { return failed_assertion_.has_value(); }
  bool is_for_us(Address destination) const;
  bool reaches(const MeshMessage& message) const;
  const AppKey* find_app_key(const Key& key) const;
  bool is_taken_by_model(const MeshMessage& message, std::uint16_t app_key_index) const;
  void answer_link(ByteView pdu, TimePoint now);
  void end_link();
  void configure(const MeshMessage& request, TimePoint now);
  void reset(TimePoint now);
  const AppKey* publishing_key(const Model& model) const;
  std::optional<Robot::Publication> publication_of(ModelId id) const;

  Settings settings_;
  Random random_;
  KeyPair key_pair_;
  NodeConfiguration configuration_;
  std::uint32_t next_sequence_ = 0;
  ReplayList heard_;
  std::optional<TimePoint> next_beacon_;
  std::optional<TimePoint> configured_at_;
  bool is_beacon_due_ = false;
  std::optional<std::uint32_t> link_;
  std::optional<TimePoint> link_ends_;
  std::optional<Provisionee> provisionee_;
  std::optional<std::string> failed_assertion_;
  Heartbeats heartbeats_;
  std::deque<LinkSignal> signals_;
  std::deque<MeshMessage> answers_;
};

}  // namespace slamgw::sim::ble
