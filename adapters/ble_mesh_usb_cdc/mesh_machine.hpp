// SPDX-License-Identifier: Apache-2.0
// What BleMeshAdapter drives: one of two protocols on the serial port, BleMesh (Nordic's serial
// protocol) or CobsMesh (streams of COBS frames). The contract of protocol_machine.hpp.
#pragma once

#include <optional>
#include <string>
#include <variant>

#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"
#include "daemon/core/mesh_order.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/protocol_machine.hpp"
#include "daemon/core/robot_names.hpp"

namespace slamgw::ble {

/// To the port, in order.
struct WriteSerial {
  Bytes bytes;
};
/// Close the port, wait, open it again; answered by on_port_open or on_port_closed.
struct ReopenPort {
  Duration after{};
};
/// Make keys for a new mesh and store them; answered by on_keys or on_keys_failed.
struct GenerateKeys {};

/// Put the mesh's database on disk; answered by on_stored. Holds secrets.
struct StoreMesh {
  NodeDatabase database;
};
/// BleMesh::open_commands() may be other ones than before; keep them over a crash.
struct CommandsChanged {};
/// An operator's order has ended; once for each.
struct OrderEnded {
  std::uint64_t id = 0;
  OrderAnswer answer;
};

using MeshAction = std::variant<WriteSerial, ReopenPort, GenerateKeys, StoreMesh, CommandsChanged,
                                OrderEnded, MeshEvent>;

class MeshMachine {
 public:
  virtual ~MeshMachine() = default;

  /// Before anything else; subscribes for the robots that the configuration names.
  virtual void on_start() = 0;
  virtual void on_port_open(TimePoint now) = 0;
  /// Also when an attempt to open it failed.
  virtual void on_port_closed(const std::string& why, TimePoint now) = 0;
  virtual void on_bytes(ByteView bytes, TimePoint now) = 0;
  virtual void on_keys(const MeshKeys& keys, TimePoint now) = 0;
  virtual void on_keys_failed(const std::string& why, TimePoint now) = 0;
  /// `problem` is empty when the database is on disk.
  virtual void on_stored(const std::string& problem, TimePoint now) = 0;
  /// `id` comes back in OrderEnded.
  virtual void on_order(std::uint64_t id, MeshOrder order, TimePoint now) = 0;

  /// `robots` of the configuration was read again. A robot that is called otherwise by now goes
  /// under its old name and comes under the new one; what is owed to it stays owed.
  virtual void on_names(RobotNames names, TimePoint now) = 0;

  virtual void on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome, TimePoint now) = 0;
  virtual void on_broker_message(const BrokerMessage& message, CommandId command,
                                 TimePoint now) = 0;
  virtual void on_subscribe_result(const std::string& filter, bool granted, TimePoint now) = 0;
  virtual void on_broker_link(bool is_up, TimePoint now) = 0;
  /// Whether every MeshStep is told, or only repeats.
  virtual void on_trace(bool is_on) = 0;
  /// The daemon ends: no command is taken or waited for any more. What robots were promised to hear
  /// is still sent.
  virtual void on_stop(TimePoint) {}

  virtual std::optional<MeshAction> next_action() = 0;
  virtual std::optional<TimePoint> deadline() const = 0;
  virtual void on_deadline(TimePoint now) = 0;
  virtual std::optional<Presence> presence_of(std::string_view robot) const = 0;
  virtual std::size_t queued_for(std::string_view) const { return 0; }
  virtual Counters counters() const = 0;
};

}  // namespace slamgw::ble
