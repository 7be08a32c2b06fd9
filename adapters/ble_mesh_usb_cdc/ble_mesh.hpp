// SPDX-License-Identifier: Apache-2.0
// The BLE mesh on a radio. Its parts do the work: Radio (the air), Provisioner (who joins and is
// configured), Robots (who is there), Uplink (robots' messages), Downlink (commands to them) and
// Relay (what robots on other meshes say).
// This class carries between them; no I/O, no clock, no kind of radio. Called by the radio's shell,
// a BleMeshShell, which drains its actions after each input.
#pragma once

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
  /// Robots that are deaf within this time after the radio came up may have heard its address
  /// before. What begins later has another cause.
  static constexpr Duration address_suspected_for = std::chrono::minutes{10};

  /// `database`: this gateway's mesh.json, if there is one.
  BleMesh(Settings settings, TopicScheme topics, RobotNames names,
          std::optional<NodeDatabase> database, std::unique_ptr<Radio> radio);

  /// Before anything else; subscribes for the robots that the configuration names.
  void on_start();
  void on_keys(const MeshKeys& keys, TimePoint now);
  void on_keys_failed(const std::string& why, TimePoint now);
  /// The radio forgets all and comes up again with an address that no robot has heard from. False
  /// when it is down, or keeps its address anyway.
  bool begin_new_life(TimePoint now);
  /// `problem` is empty when the database is on disk.
  void on_stored(const std::string& problem, TimePoint now);
  /// `id` comes back in OrderEnded.
  void on_order(std::uint64_t id, const BleOrder& order, TimePoint now);
  /// `robots` of the configuration was read again. A renamed robot goes offline under its old name
  /// and comes online under the new one; its open receipts stay open.
  void on_names(RobotNames names, TimePoint now);

  void on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome, TimePoint now);
  void on_broker_message(const RobotMessage& message, TimePoint now);
  /// Of `ble_mesh.relay`: what a robot on any mesh has said.
  void on_robot_message(const BrokerMessage& message, TimePoint now);
  void on_subscribe_result(const std::string& robot, const std::string& filter, bool granted,
                           TimePoint now);
  void on_broker_link(bool is_up, TimePoint now);
  /// In a mesh that several gateways share: asked before anything of a robot is dealt with.
  void ask_who_serves(ServiceGate::MayServe may_serve) { gate_.ask(std::move(may_serve)); }
  /// Other gateways have radios in this mesh.
  bool is_shared() const { return gate_.is_shared(); }
  /// As MeshAdapter.
  void on_session_held(const std::string& robot, TimePoint now);
  std::vector<WaitingMessage> give_up(const std::string& robot, TimePoint now);
  /// Whether every MeshStep is reported, or only repeats.
  void on_trace(bool is_on) { is_traced_ = is_on; }
  /// The daemon ends: no command is accepted or waited for any more. Acknowledgements of robots'
  /// messages are still sent.
  void on_stop(TimePoint now);

  std::optional<MeshAction> next_action() { return actions_.pop(); }
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);
  std::optional<Presence> presence_of(std::string_view robot) const;
  Counters counters() const;
  /// The database when the disk may not have it yet: to be written before the daemon ends.
  const NodeDatabase* unsaved() const;
  /// Commands that have no outcome yet.
  OpenCommands open_commands() const;
  /// How many of them are for this robot.
  std::size_t queued_for(std::string_view robot) const;

 protected:
  Radio& radio() { return *radio_; }
  /// Call after each input of the radio: carries on what it has left.
  void settle(TimePoint now);

 private:
  void on_radio_event(RadioEvent& event, TimePoint now);
  void on_link_up(const LinkIsUp& up, TimePoint now);
  void on_link_down(const LinkIsDown& down, TimePoint now);
  void on_send_refused(const SendRefused& refused, TimePoint now);
  void on_message(const MessageReceived& message, TimePoint now);
  bool is_banned(std::uint16_t source) const;
  /// The robot that this came from, which is online now; null when there is no room for it, or
  /// when another gateway serves it.
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
  TimePoint up_since_{};  ///< the link
  std::optional<std::uint32_t> tried_life_;
  LogThrottle stranger_throttle_{std::chrono::minutes{10}};
};

}  // namespace slamgw::ble
