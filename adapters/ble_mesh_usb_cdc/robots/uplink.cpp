// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/robots/uplink.hpp"

#include <fmt/format.h>

#include <algorithm>

#include "adapters/ble_mesh_usb_cdc/access/robot_models.hpp"

namespace slamgw::ble {
namespace {

constexpr Opcode health_current_status = 0x04;
/// The type whose payload the gateway reads (docs/topics.md).
constexpr std::string_view update_type = "update";
constexpr const char* no_room = "the gateway has no room for it; the robot keeps it";

Inbox& inbox_of(Robot& robot, VendorModel model) {
  return robot.inboxes[static_cast<std::size_t>(model)];
}

}  // namespace

void Uplink::on_message(Robot& robot, const MessageReceived& message, TimePoint now) {
  if (message.actual_length > message.payload.size())
    return reject(message.source, "the radio cut it short", now);
  const auto access = decode_access(message.payload);
  if (!access.has_value()) return reject(message.source, "it has no valid opcode", now);

  robot.highest_ttl = std::max(robot.highest_ttl, message.ttl.value_or(0));
  if (const auto kind = vendor_message_of(access->opcode)) {
    // Other messages may come under a device key, with which no STATUS is sent.
    robot.key = message.key;
    on_vendor_message(robot, *kind, message, access->params, now);
  } else if (access->opcode == generic_on_off_status || access->opcode == simple_on_off_status) {
    on_status(robot, access->opcode, now);
  } else if (access->opcode != health_current_status) {  // only a sign of life
    ++counters_.unknown_opcodes;
  }
}

void Uplink::on_vendor_message(Robot& robot, VendorMessage kind, const MessageReceived& message,
                               ByteView params, TimePoint now) {
  const bool is_answer = kind.kind == MessageKind::status;
  if (!is_answer && !gate_.is_open_for(robot)) return leave_to_others(robot, kind, message, now);
  switch (kind.kind) {
    case MessageKind::set: return on_set({robot, kind.model, message, params}, now);
    case MessageKind::set_numbered:
      if (params.empty()) return reject(message.source, "it has no transaction number", now);
      return on_set({robot, kind.model, message, params.subspan(1), params.front()}, now);
    case MessageKind::set_unreliable: return report({robot, kind.model, message, params}, 0);
    case MessageKind::get:
      return send_status(robot, message.source, encode_status(kind.model), now);
    case MessageKind::status: return on_status(robot, opcode_of(kind), now);
  }
}

void Uplink::on_status(Robot& robot, Opcode status, TimePoint now) {
  if (downlink_.on_status(robot, status, now)) robots_.on_hearing(robot, false);
}

void Uplink::leave_to_others(Robot& robot, VendorMessage kind, const MessageReceived& message,
                             TimePoint now) {
  ++counters_.left_to_others;
  Inbox& inbox = inbox_of(robot, kind.model);
  auto unserved = std::move(inbox.unserved);
  forget(inbox);
  if (kind.kind != MessageKind::set && kind.kind != MessageKind::set_numbered) return;
  const bool is_again =
      unserved && unserved->message.payload == message.payload && unserved->may_come_again(now);
  if (!is_again) unserved = {message, now, now};
  unserved->is_repeated = is_again;
  unserved->last = now;
  inbox.unserved = std::move(unserved);
}

void Uplink::forget(Inbox& inbox) {
  radio_.withdraw(inbox.element, inbox.status);
  inbox = {};
}

void Uplink::on_given_up(Robot& robot) {
  for (Inbox& inbox : robot.inboxes) forget(inbox);
}

/// Inboxes without an unserved message stay as they are. So a repeat of a message that this gateway
/// acknowledged before a short loss of the session is still recognized.
void Uplink::on_session_held(Robot& robot, TimePoint now) {
  for (Inbox& inbox : robot.inboxes) {
    const auto unserved = std::exchange(inbox.unserved, std::nullopt);
    if (unserved && unserved->is_open(now)) take_up(robot, *unserved);
  }
}

/// Gives the copies that were heard to the filter, which then knows when the next one is due.
void Uplink::take_up(Robot& robot, const UnservedSet& unserved) {
  for (const TimePoint heard : {unserved.first, unserved.last})
    on_message(robot, unserved.message, heard);
}

/// In doubt an `update` is reported, because a lost one does more harm than a doubled one. A
/// message of another type is then taken for a repeat.
RepeatFilter::Verdict Uplink::judge(const VendorReport& set, TimePoint now) const {
  RepeatFilter& filter = inbox_of(set.robot, set.model).filter;
  if (set.number) return filter.on_numbered_set(*set.number, set.params, now);
  // The message does not show the TTL that the robot sent with. It is taken to be the mesh's, or
  // the highest that was seen.
  const std::uint8_t ttl = std::max(settings_.ttl, set.robot.highest_ttl);
  const auto doubt = type_of(set.model) == update_type ? RepeatFilter::Doubt::take_for_new
                                                       : RepeatFilter::Doubt::take_for_repeat;
  return filter.on_set(set.params, reliable_interval(ttl, set.message.payload.size()), doubt, now);
}

void Uplink::on_set(const VendorReport& set, TimePoint now) {
  Inbox& inbox = inbox_of(set.robot, set.model);
  const RepeatFilter::Verdict verdict = judge(set, now);
  set.robot.is_asking = true;
  if (inbox.filter.is_unheard()) robots_.on_hearing(set.robot, true);
  if (inbox.filter.was_heard()) robots_.on_hearing(set.robot, false);
  switch (verdict) {
    case RepeatFilter::Verdict::repeat_open: return report_repeat(set);
    case RepeatFilter::Verdict::repeat_answered:
      report_repeat(set);
      inbox.filter.on_answered(now);
      return send_status(set.robot, set.message.source, inbox.status, now);
    case RepeatFilter::Verdict::fresh: break;
  }
  // A receipt that is still open is of a SET that the robot has given up. A late answer to that SET
  // would acknowledge this one. So the receipt is forgotten, and a STATUS that still waits is
  // withdrawn.
  radio_.withdraw(inbox.element, inbox.status);
  inbox.open_receipt = ++last_receipt_;
  inbox.element = set.message.source;
  inbox.status = encode_status(set.model, set.number);
  VendorReport missed = set;
  missed.number.reset();
  for (int i = 0; i < inbox.filter.missed(); ++i) report(missed, 0);
  report(set, inbox.open_receipt);
}

void Uplink::report(const VendorReport& what, std::uint64_t receipt_id) {
  ++counters_.reports;
  const Robot& robot = what.robot;
  emit(Report{.mesh = Mesh::ble,
              .robot = robot.id,
              .topic = topics_.robot_topic(robot.id, type_of(what.model)),
              .payload = {what.params.begin(), what.params.end()},
              .qos = Qos::at_least_once,
              .retain = false,
              .receipt = {Mesh::ble, receipt_id},
              .is_will = false,
              .radio = robot.radio_facts(what.message),
              .wire = {what.number, std::nullopt}});
}

/// Counts a repeated SET and reports it as a MessageStep; it is not published again.
void Uplink::report_repeat(const VendorReport& set) {
  ++counters_.repeats;
  const Robot& robot = set.robot;
  emit(MessageStep{.kind = StepKind::repeat,
                   .mesh = Mesh::ble,
                   .robot = robot.id,
                   .topic = topics_.robot_topic(robot.id, type_of(set.model)),
                   .qos = Qos::at_least_once,
                   .wire = {set.number, std::nullopt},
                   .bytes = set.params.size(),
                   .radio = robot.radio_facts(set.message)});
}

void Uplink::on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome, TimePoint now) {
  Robot* robot = nullptr;
  Inbox* inbox = nullptr;
  for (auto& [address, each] : robots_)
    for (Inbox& candidate : each.inboxes)
      if (receipt_id != 0 && candidate.open_receipt == receipt_id) {
        robot = &each;
        inbox = &candidate;
      }
  if (inbox == nullptr) return;
  inbox->open_receipt = 0;
  if (!gate_.is_open_for(*robot)) return forget(*inbox);
  switch (outcome) {
    case ReceiptOutcome::safe:
      inbox->filter.on_answered(now);
      send_status(*robot, inbox->element, inbox->status, now);
      break;
    case ReceiptOutcome::refused: inbox->filter.on_refused(); break;
  }
  if (!is_traced_) return;
  const bool is_safe = outcome == ReceiptOutcome::safe;
  emit(MessageStep{.kind = is_safe ? StepKind::acknowledged : StepKind::refused,
                   .mesh = Mesh::ble,
                   .robot = robot->id,
                   .receipt = {Mesh::ble, receipt_id},
                   .why = is_safe ? "" : no_room});
}

void Uplink::send_status(const Robot& robot, std::uint16_t element, Bytes status, TimePoint now) {
  ++counters_.statuses_sent;
  // If the radio does not take the STATUS, the robot asks again.
  radio_.send({element, robot.key, std::move(status), /*is_urgent=*/true}, now);
}

void Uplink::reject(std::uint16_t source, std::string_view why, TimePoint now) {
  ++counters_.rejected;
  if (const auto count = reject_throttle_.on_event(now))
    warn(fmt::format("{} message(s) from the BLE mesh rejected, the last from 0x{:04x}: {}", *count,
                     source, why));
}

const std::string& Uplink::type_of(VendorModel model) const {
  switch (model) {
    case VendorModel::min_com: return settings_.min_com_type;
    case VendorModel::sensor_update: return settings_.sensor_update_type;
    case VendorModel::pos_cmd: break;
  }
  return settings_.pos_cmd_type;
}

}  // namespace slamgw::ble
