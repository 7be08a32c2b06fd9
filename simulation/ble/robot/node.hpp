// SPDX-License-Identifier: Apache-2.0
// The mesh stack of one robot: beacons while it is unprovisioned, its end of a provisioning link,
// then keys, sequence numbers and replay protection, and the configuration server. Robot has the
// models. No radio and no clock: Network delivers messages.
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
  /// The robot begins when its configuration has not changed for this long.
  static constexpr std::chrono::seconds settling_time{1};

  struct Settings {
    const Firmware* firmware = &firmware_3_1_0;
    Key uuid{};
    unsigned number = 1;  ///< of the robot, from 1
    std::optional<Key> static_oob;
    /// In the mesh from the start without provisioning, with this address and the keys of the
    /// board; accepts no configuration.
    std::optional<Address> fixed_address;
  };

  Node(const Settings& settings, Random random);

  void on_start(TimePoint now);
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);
  /// Returns the UUID to send as an unprovisioned device's beacon.
  std::optional<Key> next_beacon();

  /// Returns true when `open` is for this device, or the link is its own.
  bool takes(const LinkSignal& signal) const;
  void on_link_signal(const LinkSignal& signal, TimePoint now);
  std::optional<LinkSignal> next_link_signal();

  /// Returns true if it acknowledges the segments of this message: network key and address are its
  /// own, and replay protection accepts them.
  bool acknowledges(const MeshMessage& message) const;
  /// Returns true if it accepts an acknowledgement of its own segments.
  bool would_accept(Address source, const SegmentAcknowledgement& acknowledgement) const {
    return (settings_.fixed_address || configuration_.has_net_key(acknowledgement.net_key)) &&
           heard_.would_accept(source, acknowledgement.sequence);
  }
  /// Returns true for a message to the robot's models; configuration messages are answered here.
  bool on_message(const MeshMessage& message, TimePoint now);
  std::optional<MeshMessage> next_answer();
  /// Sets source, keys and sequence number of a model's message; returns false when the node can't
  /// send it.
  bool prepare(MeshMessage& message);

  /// Call when the node has sent a message.
  void on_transmitted() { heartbeats_.on_transmitted(); }
  std::optional<Heartbeats::Heartbeat> next_heartbeat();
  /// Call when a heartbeat of another node arrives. Returns false when this node does not hear it.
  void on_heartbeat(const Node& source, const Heartbeats::Heartbeat& heartbeat, std::uint8_t hops,
                    TimePoint now);
  bool is_relay() const { return !is_gone() && address() != 0 && configuration_.relay == 1; }

  /// Returns the failed assertion of its firmware, once: from then on the node is stopped.
  const std::optional<std::string>& failed_assertion() const { return failed_assertion_; }

  /// Returns the network key that it sends under; nothing for the keys of the board.
  std::optional<Key> net_key() const;

  /// Returns the publications that the configuration permits at this time.
  Robot::Publications publications(TimePoint now) const;
  /// Returns 0 while unprovisioned.
  Address address() const;
  unsigned number() const { return settings_.number; }

  const NodeConfiguration& configuration() const { return configuration_; }
  std::uint32_t next_sequence() const { return next_sequence_; }
  /// Switches off and on: clears the replay list, but not the configuration.
  void power_cycle();
  /// Resets by hand, as its owner does: an unprovisioned device, whose sequence number restarts.
  void reset_by_hand(TimePoint now);
  /// Call before the start, with the content of a state file.
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
