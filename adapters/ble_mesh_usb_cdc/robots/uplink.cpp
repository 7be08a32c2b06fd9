// SPDX-License-Identifier: Apache-2.0
// BleMesh's way up: from an access message to a report, and back with the STATUS that it owes.
#include <fmt/format.h>

#include <algorithm>

#include "adapters/ble_mesh_usb_cdc/access/on_off.hpp"
#include "adapters/ble_mesh_usb_cdc/ble_mesh.hpp"
#include "adapters/ble_mesh_usb_cdc/robots/reliable_publish.hpp"

namespace slamgw::ble {
namespace {

constexpr Opcode health_current_status = 0x04;
/// The type whose payload the gateway reads (contract section 5).
constexpr std::string_view update_type = "update";
constexpr const char* no_room = "the gateway has no room for it; the robot keeps it";

}  // namespace

void BleMesh::on_message(const MessageReceived& message, TimePoint now) {
  if (message.source == 0 || message.source > last_unicast_address)
    return reject(message.source, "its source is no unicast address", now);
  Robot* robot = robot_at(message.source, now);
  if (robot == nullptr) return;
  on_heard(*robot, now);
  if (provisioner_.on_message(message, now)) return settle(now);
  if (message.actual_length > message.payload.size())
    return reject(message.source, "the serial board cut it short", now);
  const auto access = decode_access(message.payload);
  if (!access.has_value()) return reject(message.source, "it has no valid opcode", now);

  robot->highest_ttl = std::max(robot->highest_ttl, message.ttl);
  if (const auto kind = vendor_message_of(access->opcode)) {
    // Not from others: configuration messages come with a device key, which only answers those.
    robot->appkey_handle = message.appkey_handle;
    on_vendor_message(*robot, *kind, message, access->params, now);
  } else if (access->opcode == generic_on_off_status || access->opcode == simple_on_off_status) {
    conclude(*robot, robot->commands.on_status(access->opcode, now));
    transmit_due(*robot, now);
  } else if (access->opcode != health_current_status) {  // which only says that it is there
    ++counters_.unknown_opcodes;
  }
}

void BleMesh::on_vendor_message(Robot& robot, VendorMessage kind, const MessageReceived& message,
                                ByteView params, TimePoint now) {
  switch (kind.kind) {
    case MessageKind::set: on_set(robot, kind.model, message, params, {}, now); break;
    case MessageKind::set_numbered:
      if (params.empty()) return reject(message.source, "it has no transaction number", now);
      on_set(robot, kind.model, message, params.subspan(1), params.front(), now);
      break;
    case MessageKind::set_unreliable: report(robot, kind.model, message, params, 0); break;
    case MessageKind::get:
      send_status(robot, message.source, encode_status(kind.model), now);
      break;
    case MessageKind::status:
      conclude(robot, robot.commands.on_status(opcode_of(kind), now));
      transmit_due(robot, now);
      break;
  }
}

/// Of `update` nothing is lost for the sake of no doubles; all else goes up once, if that can be.
SetFilter::Doubt BleMesh::doubt_of(VendorModel model) const {
  return type_of(model) == update_type ? SetFilter::Doubt::take_for_new
                                       : SetFilter::Doubt::take_for_repeat;
}

void BleMesh::on_set(Robot& robot, VendorModel model, const MessageReceived& message,
                     ByteView params, std::optional<std::uint8_t> number, TimePoint now) {
  Inbox& inbox = robot.inboxes[static_cast<std::size_t>(model)];
  // The TTL that robots send with is not in the message: the mesh's, or more if more was seen.
  const std::uint8_t ttl = std::max(settings_.ttl, robot.highest_ttl);
  const Duration interval = reliable_interval(ttl, message.payload.size());
  switch (number ? inbox.filter.on_numbered_set(*number, params, now)
                 : inbox.filter.on_set(params, interval, doubt_of(model), now)) {
    case SetFilter::Verdict::repeat_open: return tell_repeat(robot, model, message, params, number);
    case SetFilter::Verdict::repeat_answered:
      tell_repeat(robot, model, message, params, number);
      inbox.filter.on_answered(now);
      return send_status(robot, message.source, inbox.status, now);
    case SetFilter::Verdict::fresh: break;
  }
  // A receipt still open here is of a SET that the robot has given up. Answering that one late
  // would acknowledge this one, so it is forgotten, and so is a STATUS that still waits.
  link_.withdraw(inbox.element, inbox.status);
  open_receipts_.erase(inbox.open_receipt);
  inbox.open_receipt = ++last_receipt_;
  inbox.element = message.source;
  inbox.status = encode_status(model, number);
  open_receipts_.emplace(inbox.open_receipt, std::pair(robot.address, model));
  for (int i = 0; i < inbox.filter.missed(); ++i) report(robot, model, message, params, 0);
  report(robot, model, message, params, inbox.open_receipt, number);
}

void BleMesh::tell_repeat(const Robot& robot, VendorModel model, const MessageReceived& message,
                          ByteView params, std::optional<std::uint8_t> number) {
  ++counters_.repeats;
  emit(MeshStep{.kind = MeshStep::Kind::repeat,
                .mesh = Mesh::ble,
                .robot = robot.id,
                .topic = topics_.robot_topic(robot.id, type_of(model)),
                .qos = Qos::at_least_once,
                .wire = {number, std::nullopt},
                .bytes = params.size(),
                .radio = RadioFacts{message.rssi_dbm, robot.hops(message.ttl), message.ttl}});
}

void BleMesh::on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome, TimePoint now) {
  const auto open = open_receipts_.find(receipt_id);
  if (open == open_receipts_.end()) return;
  const auto [address, model] = open->second;
  open_receipts_.erase(open);
  Robot& robot = robots_.at(address);  // its receipts go with it
  Inbox& inbox = robot.inboxes[static_cast<std::size_t>(model)];
  inbox.open_receipt = 0;
  switch (outcome) {
    case ReceiptOutcome::safe:
      inbox.filter.on_answered(now);
      send_status(robot, inbox.element, inbox.status, now);
      break;
    case ReceiptOutcome::refused: inbox.filter.on_refused(); break;
  }
  if (is_traced_) {
    const bool is_safe = outcome == ReceiptOutcome::safe;
    emit(MeshStep{.kind = is_safe ? MeshStep::Kind::acknowledged : MeshStep::Kind::refused,
                  .mesh = Mesh::ble,
                  .robot = robot.id,
                  .receipt = {Mesh::ble, receipt_id},
                  .why = is_safe ? "" : no_room});
  }
  settle(now);
}

void BleMesh::report(const Robot& robot, VendorModel model, const MessageReceived& message,
                     ByteView params, std::uint64_t receipt_id,
                     std::optional<std::uint8_t> number) {
  ++counters_.reports;
  emit(Report{.mesh = Mesh::ble,
              .robot = robot.id,
              .topic = topics_.robot_topic(robot.id, type_of(model)),
              .payload = {params.begin(), params.end()},
              .qos = Qos::at_least_once,
              .retain = false,
              .receipt = {Mesh::ble, receipt_id},
              .is_will = false,
              .radio = RadioFacts{message.rssi_dbm, robot.hops(message.ttl), message.ttl},
              .wire = {number, std::nullopt}});
}

void BleMesh::send_status(const Robot& robot, std::uint16_t element, Bytes status, TimePoint now) {
  ++counters_.statuses_sent;
  send(robot, element, std::move(status), true, now);
}

void BleMesh::reject(std::uint16_t source, std::string_view why, TimePoint now) {
  ++counters_.rejected;
  if (const auto count = reject_burst_.on_event(now))
    emit(Notice{Severity::warning,
                fmt::format("{} message(s) from the BLE mesh rejected, the last from 0x{:04x}: {}",
                            *count, source, why),
                {}});
}

const std::string& BleMesh::type_of(VendorModel model) const {
  switch (model) {
    case VendorModel::min_com: return settings_.min_com_type;
    case VendorModel::sensor_update: return settings_.sensor_update_type;
    case VendorModel::pos_cmd: break;
  }
  return settings_.pos_cmd_type;
}

}  // namespace slamgw::ble
