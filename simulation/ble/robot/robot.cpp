// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/robot/robot.hpp"

#include <fmt/format.h>

#include <algorithm>

namespace slamgw::sim::ble {
namespace {

/// Interval of retries while the board is not ready, or the transport is busy.
constexpr std::chrono::milliseconds look_again{20};
constexpr std::size_t vendor_opcode_octets = 3;

/// Health Current Status: test 0, company 0x0059, no fault.
Bytes healthy_status() { return {0x04, 0x00, 0x59, 0x00}; }

/// Nordic's convention for STATUS is one state octet.
Bytes status_message(Vendor status) { return vendor_message(status, Bytes{0x00}); }

}  // namespace

Robot::Robot(const RobotSettings& settings, const RobotBody& body)
    : settings_(settings), body_(body) {}

/// Robots start one after another.
void Robot::on_start(TimePoint now) {
  const unsigned number = settings_.number - 1;
  next_update_ = now + std::chrono::milliseconds{7 * number % 200};
  next_health_ = now + health_interval + std::chrono::milliseconds{37 * number % 1000};
}

std::optional<Robot::Outgoing> Robot::next_transmission() {
  if (outbox_.empty()) return std::nullopt;
  Outgoing first = std::move(outbox_.front());
  outbox_.pop_front();
  return first;
}

std::optional<UpdateEvent> Robot::next_event() {
  if (events_.empty()) return std::nullopt;
  UpdateEvent first = std::move(events_.front());
  events_.pop_front();
  return first;
}

void Robot::record(UpdateEvent::Kind kind, std::uint64_t number, Bytes payload) {
  if (settings_.is_recorded) events_.push_back({kind, number, std::move(payload)});
}

void Robot::on_command(std::string_view type, ByteView payload) {
  ++tally_.commands_received;
  if (!settings_.is_recorded) return;
  events_.push_back({UpdateEvent::Kind::command, 0, Bytes(payload.begin(), payload.end()), type});
}

/// An update of a robot of another mesh: the number of its id, then the update.
void Robot::on_relayed(ByteView parameters) {
  if (parameters.size() < 2) return;
  const std::string sender = fmt::format("0x{:04x}", get_u16_le(parameters, 0));
  const ByteView update = parameters.subspan(2);
  ++tally_.heard[sender];
  if (!settings_.is_recorded) return;
  events_.push_back({UpdateEvent::Kind::heard, 0, Bytes(update.begin(), update.end()), {}, sender});
}

void Robot::on_failed_assertion() {
  is_gone_ = true;
  ++tally_.failed_assertions;
  reliable_.reset();
  outbox_.clear();
}

TimePoint Robot::deadline() const {
  if (is_gone_) return TimePoint::max();
  const bool has_more = !settings_.messages || produced_ < *settings_.messages;
  TimePoint next = next_health_;
  if (has_more) next = std::min(next, next_update_);
  if (reliable_) next = std::min({next, reliable_->repeat_at, reliable_->gives_up_at});
  return next;
}

void Robot::on_deadline(const Publications& publications, TimePoint now) {
  if (next_health_ <= now) publish_health(publications.health, now);
  if (reliable_) repeat(now);
  if (next_update_ <= now) produce(publications, now);
}

void Robot::publish_health(const std::optional<Publication>& to, TimePoint now) {
  const bool is_periodic = to && to->period > Duration{};
  next_health_ = now + (is_periodic ? to->period : Duration{health_interval});
  if (is_periodic) {
    transmit({settings_.address, to->address, to->ttl, healthy_status()}, now);
  }
}

void Robot::produce(const Publications& publications, TimePoint now) {
  if (settings_.messages && produced_ >= *settings_.messages) return;
  const bool is_blocked =
      reliable_.has_value() || (settings_.has_segment_timing && segmented_until_ > now);
  const bool introduces =
      body_.introduces_itself() && !has_introduced_itself_ && publications.min_com;
  const bool pauses = (settings_.messages && !settings_.on_busy) || introduces;
  if ((!introduces && !publications.sensor_update) || (is_blocked && pauses)) {
    next_update_ = now + look_again;
    return;
  }
  next_update_ = std::max(next_update_ + settings_.period, now);
  if (introduces) {
    has_introduced_itself_ = true;
    return publish(false, body_.introduction(), *publications.min_com, now);
  }
  if (produced_ == 0) first_update_ = now;
  ++produced_;
  tick(*publications.sensor_update, now);
}

/// The access layer refuses a second SET, the transport a second segmented message. The thesis's
/// robots drop refused updates.
void Robot::tick(const Publication& to, TimePoint now) {
  const Bytes update = body_.next_message(produced_, now - first_update_);
  if (reliable_) {
    if (settings_.on_busy == OnBusy::cancel) cancel();
    return refuse(update);
  }
  const bool is_segmented = segment_count(update.size() + vendor_opcode_octets) > 1;
  const bool is_kept = settings_.is_acknowledged && settings_.on_busy == OnBusy::refuse;
  const bool is_blocked = settings_.has_segment_timing && segmented_until_ > now &&
                          (is_segmented || !settings_.on_busy);
  if (is_blocked && !is_kept) return refuse(update);
  publish(true, update, to, now);
}

void Robot::refuse(const Bytes& update) {
  ++tally_.lost;
  record(UpdateEvent::Kind::refused, produced_, update);
}

void Robot::cancel() {
  if (reliable_->number > 0) record(UpdateEvent::Kind::cancelled, reliable_->number);
  reliable_.reset();
}

MeshMessage Robot::set_message(bool is_positions, const Bytes& parameters, const Publication& to) {
  if (settings_.is_acknowledged && settings_.is_numbered) {
    Bytes numbered{++transaction_};
    put(numbered, parameters);
    const Vendor set =
        is_positions ? Vendor::sensor_update_set_numbered : Vendor::min_com_set_numbered;
    return {settings_.address, to.address, to.ttl, vendor_message(set, numbered)};
  }
  const Vendor set = is_positions ? Vendor::sensor_update_set : Vendor::min_com_set;
  const Vendor set_unreliable =
      is_positions ? Vendor::sensor_update_set_unreliable : Vendor::min_com_set_unreliable;
  return {settings_.address, to.address, to.ttl,
          vendor_message(settings_.is_acknowledged ? set : set_unreliable, parameters)};
}

void Robot::publish(bool is_update, const Bytes& parameters, const Publication& to, TimePoint now) {
  const bool is_positions = is_update && body_.introduces_itself();  // probes are of min_com
  const Vendor status = is_positions ? Vendor::sensor_update_status : Vendor::min_com_status;
  const MeshMessage message = set_message(is_positions, parameters, to);
  if (is_update) {
    ++tally_.sent;
    record(UpdateEvent::Kind::sent, produced_, parameters);
  }
  if (settings_.is_acknowledged) {
    const Duration interval = reliable_interval(to.ttl, message.payload.size());
    const Bytes of_status = settings_.is_numbered ? Bytes{0x00, transaction_} : Bytes{};
    reliable_ = Reliable{message,      status,         is_update ? produced_ : 0, of_status,
                         interval * 2, now + interval, now + reliable_timeout};
  }
  if (!may_transmit(message, now)) return;  // the reliable layer tries again when a repeat is due
  transmit(message, now);
  outbox_.back().is_unacknowledged_update = is_update && !settings_.is_acknowledged;
}

/// Repeats come 1, 2, 4, 8 ... intervals after the first transmission.
void Robot::repeat(TimePoint now) {
  if (reliable_->gives_up_at <= now) {
    if (reliable_->number > 0) {
      ++tally_.lost;
      record(UpdateEvent::Kind::given_up, reliable_->number);
    }
    reliable_.reset();
    return;
  }
  if (reliable_->repeat_at > now) return;
  const TimePoint first = reliable_->gives_up_at - reliable_timeout;
  reliable_->repeat_at = first + reliable_->interval;
  reliable_->interval *= 2;
  if (!may_transmit(reliable_->message, now)) return;
  if (reliable_->number > 0) record(UpdateEvent::Kind::repeated, reliable_->number);
  transmit(reliable_->message, now);
}

bool Robot::may_transmit(const MeshMessage& message, TimePoint now) const {
  return segment_count(message.payload.size()) == 1 || segmented_until_ <= now;
}

void Robot::transmit(const MeshMessage& message, TimePoint now) {
  if (settings_.has_segment_timing && segment_count(message.payload.size()) > 1) {
    segmented_until_ = now + segmented_session(message.destination, message.ttl);
  }
  outbox_.push_back({message, false});
}

void Robot::on_unacknowledged_segments(const MeshMessage& message, TimePoint now) {
  segmented_until_ = now + failed_session(message.ttl);
}

void Robot::on_message(const MeshMessage& message, TimePoint now) {
  if (const std::optional<Vendor> opcode = vendor_opcode(message.payload)) {
    return on_vendor(*opcode, message, now);
  }
  const std::optional<std::uint16_t> opcode = two_octet_opcode(message.payload);
  if (!opcode) return;
  const ByteView parameters = ByteView(message.payload).subspan(2);
  if (*opcode == on_off_get) answer(message, {0x82, 0x04, static_cast<std::uint8_t>(is_on_)});
  if (*opcode == on_off_set || *opcode == on_off_set_unacknowledged) {
    on_on_off(message, parameters, false, *opcode == on_off_set, now);
  }
}

void Robot::on_vendor(Vendor opcode, const MeshMessage& message, TimePoint now) {
  const ByteView parameters = ByteView(message.payload).subspan(3);
  switch (opcode) {
    case Vendor::simple_on_off_set:
    case Vendor::simple_on_off_set_unreliable:
      return on_on_off(message, parameters, true, opcode == Vendor::simple_on_off_set, now);
    case Vendor::simple_on_off_get:
      return answer(message, vendor_message(Vendor::simple_on_off_status,
                                            Bytes{static_cast<std::uint8_t>(is_on_)}));
    case Vendor::sensor_update_relayed: return on_relayed(parameters);
    case Vendor::pos_cmd_set:
    case Vendor::pos_cmd_set_unreliable:
      on_command("cmd", parameters);
      if (settings_.obeys && parameters.size() == 4) {
        body_.head_for(get_i16_le(parameters, 0), get_i16_le(parameters, 2));
      }
      if (opcode == Vendor::pos_cmd_set_unreliable) return;
      [[fallthrough]];
    case Vendor::pos_cmd_get: return answer(message, status_message(Vendor::pos_cmd_status));
    case Vendor::min_com_set:
    case Vendor::min_com_set_unreliable:
      on_command("min_com", parameters);
      if (opcode == Vendor::min_com_set_unreliable) return;
      [[fallthrough]];
    case Vendor::min_com_get: return answer(message, status_message(Vendor::min_com_status));
    case Vendor::min_com_status:
    case Vendor::sensor_update_status:
      if (!is_unicast(message.destination)) return;  // as Nordic's reliable publish requires
      if (!is_status_for_open(opcode, parameters)) return;
      if (reliable_->number > 0) {
        ++tally_.acknowledged;
        record(UpdateEvent::Kind::acknowledged, reliable_->number);
      }
      reliable_.reset();
      return;
    case Vendor::simple_on_off_status:
    case Vendor::sensor_update_set:
    case Vendor::sensor_update_get:
    case Vendor::sensor_update_set_unreliable:
    case Vendor::min_com_set_numbered:
    case Vendor::sensor_update_set_numbered:
    case Vendor::pos_cmd_status: return;
  }
}

bool Robot::is_status_for_open(Vendor opcode, ByteView parameters) const {
  if (!reliable_ || reliable_->status != opcode) return false;
  const Bytes& expected = reliable_->status_parameters;
  return expected.empty() || std::ranges::equal(parameters, expected);
}

void Robot::on_on_off(const MeshMessage& message, ByteView parameters, bool is_simple,
                      bool wants_status, TimePoint now) {
  if (parameters.size() < 2 || parameters[0] > 1) return;
  const Transaction current{message.source, parameters[1], now};
  const bool is_repeat = last_transaction_ && last_transaction_->source == current.source &&
                         last_transaction_->tid == current.tid &&
                         now - last_transaction_->at < same_transaction;
  if (!is_repeat) {
    last_transaction_ = current;
    on_command("run", parameters.first(1));
    is_on_ = parameters[0] == 1;
    if (settings_.obeys) body_.set_running(is_on_);
  }
  if (!wants_status) return;
  const auto state = static_cast<std::uint8_t>(is_on_);
  answer(message, is_simple ? vendor_message(Vendor::simple_on_off_status, Bytes{state})
                            : Bytes{0x82, 0x04, state});
}

void Robot::answer(const MeshMessage& request, Bytes payload) {
  MeshMessage message{settings_.address, request.source, settings_.ttl, std::move(payload)};
  message.encryption = request.encryption;
  outbox_.push_back({std::move(message), false});
}

bool Robot::has_sent_everything() const {
  return is_gone_ || (settings_.messages && produced_ >= *settings_.messages && !reliable_);
}

}  // namespace slamgw::sim::ble
