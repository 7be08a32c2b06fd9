// SPDX-License-Identifier: Apache-2.0
// The BLE mesh on one radio. Its parts do the work: Radio sends and receives, Provisioner adds and
// configures nodes, and Robots knows which robots are online. Uplink takes robots' messages,
// Downlink sends commands, and Relay passes on updates of robots on other meshes. This class passes
// events between its parts. It does no I/O, reads no clock and does not depend on the kind of
// radio. The radio's shell, a BleMeshShell, calls it and drains its actions after each input.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/provisioning/provisioner.hpp"
#include "adapters/ble_mesh_usb_cdc/robots/relay.hpp"
#include "adapters/ble_mesh_usb_cdc/robots/uplink.hpp"

namespace slamgw::ble {

class BleMesh {
 public:
  /// Robots that turn deaf within this time after the radio came up may have heard its address in
  /// an earlier life. Deafness that begins later has another cause.
  static constexpr Duration address_suspected_for = std::chrono::minutes{10};

  /// `database` is the content of this gateway's mesh.json; empty if there is none. `random` makes
  /// the mesh's keys.
  BleMesh(Settings settings, TopicScheme topics, RobotNames names,
          std::optional<NodeDatabase> database, std::unique_ptr<Radio> radio, RandomSource random);

  /// Call first. Subscribes to the commands for the robots that the configuration and the database
  /// name.
  void on_start();
  /// Sets the TID that the first on/off Set follows. Call before the first command, with a random
  /// number: robots drop a TID that they saw within 6 s, also from the daemon before a restart.
  void begin_tids_after(std::uint8_t tid) { downlink_.begin_tids_after(tid); }
  /// `problem` is empty when the database is on disk.
  void on_stored(const std::string& problem, TimePoint now);
  // Inputs of the radio's serial port. A radio without one gets its inputs from its shell, which
  // then calls settle().
  void on_port_open(TimePoint now);
  void on_port_closed(const std::string& why, TimePoint now);
  void on_bytes(ByteView bytes, TimePoint now);
  Radio& radio() const { return *radio_; }
  /// Handles the actions that the radio has left.
  void settle(TimePoint now);

  /// `id` comes back in OrderEnded.
  void on_order(std::uint64_t id, const BleOrder& order, TimePoint now);
  /// Call when `robots` of the configuration was read again. A renamed robot goes offline under its
  /// old name and comes online under the new one; its open receipts stay open.
  void on_names(RobotNames names, TimePoint now);

  void on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome, TimePoint now);
  void on_broker_message(const RobotMessage& message, TimePoint now);
  /// Takes a message of a robot on any mesh, for `ble_mesh.relay`.
  void on_robot_message(const BrokerMessage& message, TimePoint now);
  void on_subscribe_result(const std::string& robot, const std::string& filter, bool granted,
                           TimePoint now);
  void on_broker_link(bool is_up, TimePoint now);
  /// Sets the function that says whether this gateway serves a robot, for a mesh that several
  /// gateways share.
  void ask_who_serves(ServiceGate::MayServe may_serve) { gate_.ask(std::move(may_serve)); }
  /// Returns true if other gateways' radios hear the robots of this mesh, too.
  bool is_shared() const { return gate_.is_shared(); }
  /// See MeshAdapter.
  void on_session_held(const std::string& robot, TimePoint now);
  std::vector<WaitingMessage> give_up(const std::string& robot, TimePoint now);
  /// While on, reports every MessageStep; while off, only repeats.
  void on_trace(bool is_on) { is_traced_ = is_on; }
  /// Refuses open and new commands, because the daemon ends. Robots' messages are still
  /// acknowledged. No device joins any more, unless it may have its address already.
  void on_stop(TimePoint now);
  /// Returns true if no device is joining.
  bool is_settled() const { return provisioner_.is_settled(); }

  std::optional<MeshAction> next_action() { return actions_.pop(); }
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);
  std::optional<Presence> presence_of(std::string_view robot) const;
  Counters counters() const;
  /// Returns the database if it may not be on disk yet, else null. Write it before the daemon ends.
  const NodeDatabase* unsaved() const;
  /// Returns the commands that have no outcome yet, by robot.
  std::map<std::string, OpenCommands> open_commands() const;
  /// Returns the number of open commands for this robot.
  std::size_t queued_for(std::string_view robot) const;

 private:
  void on_radio_event(RadioEvent& event, TimePoint now);
  void on_link_up(const LinkIsUp& up, TimePoint now);
  void on_link_down(const LinkIsDown& down, TimePoint now);
  void on_send_refused(const SendRefused& refused, TimePoint now);
  void on_iv_update(const IvUpdate& update, TimePoint now);
  void on_message(const MessageReceived& message, TimePoint now);
  bool is_banned(std::uint16_t source) const;
  /// Marks the robot at `source` as online and returns it. Returns null if there is no room for it,
  /// or if only another gateway knows it. `message` is null for a heartbeat.
  Robot* hear(std::uint16_t source, const MessageReceived* message, TimePoint now);
  void judge_hearing(TimePoint now);
  bool try_new_life(TimePoint now);
  void on_stranger(std::uint16_t source, TimePoint now);
  void emit(MeshEvent event) { actions_.push(std::move(event)); }

  Settings settings_;
  TopicScheme topics_;
  MeshActions actions_;
  bool is_traced_ = false;
  std::unique_ptr<Radio> radio_;
  LinkState link_;
  Provisioner provisioner_;
  ServiceGate gate_;
  MeshPart shared_;
  Downlink downlink_;
  Robots robots_;
  Uplink uplink_;
  Relay relay_;
  bool are_mostly_deaf_ = false;
  std::optional<std::uint32_t> lower_iv_index_;  ///< reported once, and not believed yet
  TimePoint up_since_{};                         ///< when the link came up
  std::optional<std::uint32_t> tried_life_;      ///< begun by try_new_life()
  LogThrottle stranger_throttle_{std::chrono::minutes{10}};
};

}  // namespace slamgw::ble
