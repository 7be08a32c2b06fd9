// SPDX-License-Identifier: Apache-2.0
// The robots on the BLE mesh: what they say becomes reports with receipts, what the broker says
// becomes repeated commands, and who is heard is online. Stands on BoardLink for the serial board
// and lets Provisioner take robots in through it; no I/O, no clock. Called by BleMeshAdapter, which
// drains its actions after each input.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/mesh_action.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/board_link.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/provisioner.hpp"
#include "adapters/ble_mesh_usb_cdc/robots/robot.hpp"
#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "daemon/core/burst.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/protocol_machine.hpp"
#include "daemon/core/robot_names.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::ble {

class BleMesh {
 public:
  /// Six times what the stock board's replay list holds; more is not a mesh this board can hear.
  static constexpr std::size_t max_robots = 256;
  /// Retained topics for one robot.
  static constexpr std::size_t max_retained = 32;

  /// `database`: this gateway's mesh.json, if there is one. `random` makes the keys for new robots,
  /// `seed` Echo nonces.
  BleMesh(Settings settings, TopicScheme topics, RobotNames names,
          std::optional<NodeDatabase> database, RandomSource random, std::uint64_t seed);

  void on_start();
  void on_port_open(TimePoint now);
  void on_port_closed(const std::string& why, TimePoint now);
  void on_bytes(ByteView bytes, TimePoint now);
  void on_keys(const MeshKeys& keys, TimePoint now);
  void on_keys_failed(const std::string& why, TimePoint now);
  void on_stored(const std::string& problem, TimePoint now);
  void on_order(std::uint64_t id, MeshOrder order, TimePoint now);
  void on_names(RobotNames names, TimePoint now);

  void on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome, TimePoint now);
  void on_broker_message(const BrokerMessage& message, CommandId command, TimePoint now);
  void on_subscribe_result(const std::string& filter, bool granted, TimePoint now);
  void on_broker_link(bool is_up, TimePoint now);
  void on_trace(bool is_on) { is_traced_ = is_on; }
  void on_stop(TimePoint now);

  std::optional<MeshAction> next_action() { return actions_.pop(); }
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);
  std::optional<Presence> presence_of(std::string_view robot) const;
  Counters counters() const;
  const NodeDatabase* unsaved() const {
    const NodeTable& nodes = provisioner_.nodes();
    return nodes.ledger().is_saved() ? nullptr : nodes.database();
  }
  /// Commands that have no outcome yet.
  std::vector<OpenCommand> open_commands() const;
  /// How many of them are for this robot.
  std::size_t queued_for(std::string_view robot) const;

 private:
  struct MeshCounters {
    std::uint64_t reports = 0;
    std::uint64_t repeats = 0;
    std::uint64_t rejected = 0;
    std::uint64_t unknown_opcodes = 0;
    std::uint64_t statuses_sent = 0;
    std::uint64_t sends_dropped = 0;
    std::array<std::uint64_t, command_result_count> commands{};  ///< by CommandResult
  };

  void settle(TimePoint now);
  void on_link_action(LinkAction action, TimePoint now);
  void on_link_up(std::string detail, TimePoint now);
  void on_link_down(const std::string& why, TimePoint now);

  // ble_mesh_members.cpp: who belongs to the mesh
  void on_provisioner_action(ProvisionerAction action, TimePoint now);
  void follow_nodes(TimePoint now);
  void add_node(const Node& node);
  void add_configured();
  void leave_name(Robot& robot, const std::string& why, TimePoint now);
  void take_name(Robot& robot, std::string id);
  void take_out(Robot& robot, TimePoint now);
  std::uint16_t primary_of(std::uint16_t address) const;

  void on_message(const MessageReceived& message, TimePoint now);
  void on_vendor_message(Robot& robot, VendorMessage kind, const MessageReceived& message,
                         ByteView params, TimePoint now);
  void on_set(Robot& robot, VendorModel model, const MessageReceived& message, ByteView params,
              std::optional<std::uint8_t> number, TimePoint now);
  SetFilter::Doubt doubt_of(VendorModel model) const;
  void report(const Robot& robot, VendorModel model, const MessageReceived& message,
              ByteView params, std::uint64_t receipt_id, std::optional<std::uint8_t> number = {});
  /// A SET came again and does not go up.
  void tell_repeat(const Robot& robot, VendorModel model, const MessageReceived& message,
                   ByteView params, std::optional<std::uint8_t> number);
  void send_status(const Robot& robot, std::uint16_t element, Bytes status, TimePoint now);
  void reject(std::uint16_t source, std::string_view why, TimePoint now);

  Robot* robot_at(std::uint16_t address, TimePoint now);
  Robot* robot_called(std::string_view id);
  void on_heard(Robot& robot, TimePoint now);
  void tell_heard(Robot& robot, TimePoint now);
  void on_silent(Robot& robot);
  void announce(Robot& robot, Presence presence);
  void subscribe(const Robot& robot);

  bool may_take_retained(Robot& robot, const BrokerMessage& message);
  void transmit_due(Robot& robot, TimePoint now);
  void conclude(const Robot& robot, EndedCommands ended);
  void send(const Robot& robot, std::uint16_t element, Bytes access, bool is_urgent, TimePoint now);
  const std::string& type_of(VendorModel model) const;
  void emit(MeshEvent event) { actions_.push(std::move(event)); }

  Settings settings_;
  TopicScheme topics_;
  RobotNames names_;
  BoardLink link_;
  Provisioner provisioner_;
  std::string down_reason_ = "not started";
  ActionQueue<MeshAction> actions_;
  std::map<std::uint16_t, Robot> robots_;
  /// Receipt -> the inbox that waits for it; at most three for each robot.
  std::map<std::uint64_t, std::pair<std::uint16_t, VendorModel>> open_receipts_;
  std::uint64_t last_receipt_ = 0;
  std::uint8_t last_tid_ = 0;
  bool is_stopping_ = false;
  bool is_traced_ = false;
  Burst reject_burst_;
  Burst full_burst_;
  MeshCounters counters_;
};

}  // namespace slamgw::ble
