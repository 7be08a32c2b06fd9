// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/board/board.hpp"

#include <algorithm>

namespace slamgw::sim::ble {
namespace {

// Events (reference: Nordic's serial_evt documentation)
constexpr std::uint8_t device_started = 0x81;
constexpr std::uint8_t echo_response = 0x82;
constexpr std::uint8_t command_response = 0x84;
constexpr std::uint8_t received_unicast = 0xd0;
constexpr std::uint8_t received_subscription = 0xd1;
constexpr std::uint8_t heartbeat_received = 0xd8;

// Commands that the board executes itself; the first two have no Command Response
constexpr std::uint8_t echo = 0x02;
constexpr std::uint8_t radio_reset = 0x0e;
constexpr std::uint8_t enable = 0x90;
constexpr std::uint8_t disable = 0x91;
constexpr std::uint8_t packet_send = 0xab;
constexpr std::uint8_t clear_state = 0xac;
constexpr std::uint8_t network_state_set = 0xae;

constexpr std::uint16_t relay_feature = 0x0001;
constexpr std::size_t max_event_data = 235;

bool is_setup_command(std::uint8_t opcode) { return opcode >= 0x90 && opcode <= 0xaa; }
bool is_provisioning_command(std::uint8_t opcode) { return opcode >= 0x60 && opcode <= 0x6f; }
bool has_no_params(std::uint8_t opcode) {
  return opcode == radio_reset || opcode == enable || opcode == disable || opcode == clear_state;
}

}  // namespace

Board::Board(const Firmware& firmware, BoardStorage storage, Random random, Duration octet_time)
    : firmware_(firmware),
      storage_(storage),
      octet_time_(octet_time),
      to_host_(octet_time),
      device_(firmware, flash_, to_host_),
      keys_(flash_),
      addresses_(flash_),
      sender_(firmware, flash_),
      provisioner_(firmware, random) {}

void Board::configure(const Key& net_key, const Key& app_key) {
  flash_.subnets.add(0, 0, net_key);
  flash_.appkeys.add(0, 0, app_key);
  flash_.local_start = 0x0001;
  flash_.local_count = 1;
  for (const Address group : {min_com_group, sensor_update_group, pos_cmd_group}) {
    flash_.addresses.add_subscription(group);
  }
}

/// The stock example starts the mesh by itself.
void Board::on_power_up() {
  is_enabled_ = true;
  if (start_event_ == StartEvent::said) to_host_.push({device_started, 0x02, 0x00, 0xfe});
}

void Board::restore(BoardFlash flash) {
  flash_ = std::move(flash);
  sender_.reset();
}

void Board::reboot(TimePoint now, Duration downtime, StartEvent start_event) {
  if (!has_storage()) flash_ = BoardFlash();
  is_enabled_ = false;
  start_event_ = start_event;
  device_.reset();
  provisioner_.reset();
  sender_.reset();
  heard_.clear();
  to_host_.reset();
  boots_at_ = now + downtime;
}

void Board::on_host_bytes(ByteView bytes, TimePoint now) {
  if (on_line_.empty()) next_octet_at_ = now + octet_time_;
  const std::size_t room = max_on_line - on_line_.size();
  const ByteView taken = bytes.first(std::min(bytes.size(), room));
  on_line_.insert(on_line_.end(), taken.begin(), taken.end());
  take_from_line(now);
}

void Board::take_from_line(TimePoint now) {
  while (!on_line_.empty() && next_octet_at_ <= now) {
    const std::uint8_t octet = on_line_.front();
    on_line_.pop_front();
    on_octet(octet, next_octet_at_);
    next_octet_at_ += octet_time_;
  }
}

/// Returns when the current packet is complete, or all octets on the line have arrived.
std::optional<TimePoint> Board::next_command_at() const {
  if (on_line_.empty()) return std::nullopt;
  const std::size_t missing =
      partial_.empty() ? 1 + std::size_t{on_line_.front()} : 1 + partial_[0] - partial_.size();
  const std::size_t octets = std::min(missing, on_line_.size());
  return next_octet_at_ + octet_time_ * static_cast<Duration::rep>(octets - 1);
}

void Board::on_octet(std::uint8_t octet, TimePoint now) {
  if (boots_at_) return;  // the board is not running
  if (partial_.empty() && octet == 0) return respond(0x00, {Status::invalid_length});
  partial_.push_back(octet);
  if (partial_.size() < 1 + std::size_t{partial_[0]}) return;
  const Bytes packet(partial_.begin() + 1, partial_.end());
  partial_.clear();
  on_packet(packet, now);
}

void Board::on_packet(ByteView packet, TimePoint now) {
  const std::uint8_t opcode = packet[0];
  const ByteView params = packet.subspan(1);
  if (is_setup_command(opcode)) last_setup_ = now;
  if (opcode == echo) {
    Bytes event{echo_response};
    put(event, params);
    return to_host_.push(event);
  }
  if (is_provisioning_command(opcode)) return on_provisioning(opcode, params, now);
  if (has_no_params(opcode) && !params.empty()) return respond(opcode, {Status::invalid_length});
  if (opcode == radio_reset) return reboot(now);
  respond(opcode, run_command(opcode, params, now).value_or(Reply{Status::command_unknown}));
}

std::optional<Reply> Board::run_command(std::uint8_t opcode, ByteView params, TimePoint now) {
  if (opcode == enable) return set_enabled(true);
  if (opcode == disable) return set_enabled(false);
  if (opcode == packet_send) return sender_.send(params, is_enabled_, now);
  if (opcode == clear_state) return state_clear();
  if (opcode == network_state_set && firmware_.has_network_state) return set_network_state(params);
  if (auto reply = device_.on_command(opcode, params)) return reply;
  if (auto reply = keys_.on_command(opcode, params)) return reply;
  return addresses_.on_command(opcode, params);
}

Reply Board::set_enabled(bool is_enabled) {
  if (is_enabled_ == is_enabled) return {Status::invalid_state};
  is_enabled_ = is_enabled;
  return {};
}

Reply Board::state_clear() {
  flash_ = BoardFlash();
  sender_.on_state_cleared();
  if (firmware_.clears_replay_list) heard_.clear();
  return {};
}

/// Refuses on a board with storage, which keeps its own numbers.
Reply Board::set_network_state(ByteView params) {
  constexpr std::size_t size = 11;
  if (params.size() != size) return {Status::invalid_length};
  if (has_storage()) return {Status::invalid_state};
  const Reply reply = sender_.set_network_state(params);
  forward_events();
  return reply;
}

void Board::on_provisioning(std::uint8_t opcode, ByteView params, TimePoint now) {
  const std::optional<Reply> reply = provisioner_.on_command(opcode, params, now);
  forward_events();
  if (reply) respond(opcode, *reply);
}

void Board::forward_events() {
  while (auto event = provisioner_.next_event()) to_host_.push(*event);
  while (auto event = sender_.next_event()) to_host_.push(*event);
}

void Board::respond(std::uint8_t opcode, const Reply& reply) {
  Bytes event{command_response, opcode, static_cast<std::uint8_t>(reply.status)};
  if (reply.status == Status::success) put(event, reply.data);
  to_host_.push(event);
}

bool Board::hears(Address destination) const {
  return listens_to(destination) && flash_.appkeys.primary();
}

bool Board::listens_to(Address destination) const {
  if (boots_at_ || !is_enabled_) return false;
  if (is_unicast(destination)) return flash_.is_local(destination);
  return destination != all_proxies && flash_.addresses.subscription(destination).has_value();
}

bool Board::is_ready_for(Address destination, TimePoint now) const {
  constexpr std::chrono::milliseconds settled{500};
  return hears(destination) && last_setup_ && now - *last_setup_ >= settled;
}

/// Device keys are bound to the source address of received messages.
std::optional<Board::Handles> Board::decrypt(const MeshMessage& message) const {
  if (!message.encryption) {
    const std::optional<Handle> key = flash_.appkeys.primary();
    if (!key) return std::nullopt;
    return Handles{*key, flash_.appkeys.find(*key)->subnet};
  }
  const std::optional<Handle> subnet = flash_.subnets.find_key(message.encryption->net_key, 0);
  if (!subnet) return std::nullopt;
  const KeyTable& keys = message.encryption->is_device_key ? flash_.devkeys : flash_.appkeys;
  const std::optional<Handle> key = keys.find_key(message.encryption->key, *subnet);
  if (!key) return std::nullopt;
  if (message.encryption->is_device_key && keys.find(*key)->index != message.source) {
    return std::nullopt;
  }
  return Handles{*key, *subnet};
}

void Board::on_beacon(const Beacon& beacon) {
  if (boots_at_) return;
  provisioner_.on_beacon(beacon);
  forward_events();
}

void Board::on_heartbeat(Address source, const std::optional<Key>& net_key,
                         std::uint8_t initial_ttl, std::uint8_t hops) {
  if (!firmware_.has_heartbeats || !listens_to(flash_.local_start)) return;
  if (net_key && !flash_.subnets.find_key(*net_key, 0)) return;
  Bytes event{heartbeat_received, initial_ttl, hops};
  put_u16_le(event, relay_feature);
  put_u16_le(event, source);
  to_host_.push(event);
}

void Board::on_link_signal(const LinkSignal& signal, TimePoint now) {
  if (boots_at_) return;
  provisioner_.on_link_signal(signal, now);
  forward_events();
}

void Board::on_transfer_ended(std::uint64_t transfer, bool is_acknowledged) {
  sender_.on_transfer_ended(transfer, is_acknowledged);
  forward_events();
}

std::optional<SegmentAcknowledgement> Board::acknowledge_segments(const MeshMessage& message) {
  if (!is_unicast(message.destination) || !listens_to(message.destination)) return std::nullopt;
  const std::optional<Handle> subnet = message.encryption
                                           ? flash_.subnets.find_key(message.encryption->net_key, 0)
                                           : flash_.subnets.primary();
  if (!subnet) return std::nullopt;
  return SegmentAcknowledgement{sender_.take_sequence(1), flash_.subnets.find(*subnet)->key};
}

void Board::on_radio(const Reception& reception) {
  const MeshMessage& message = reception.message;
  if (!listens_to(message.destination)) return;
  const std::optional<Handles> handles = decrypt(message);
  if (!handles || !heard_.accept(message.source, message.sequence)) return;

  const bool is_to_us = is_unicast(message.destination);
  const std::size_t octets = std::min(message.payload.size(), max_event_data);
  Bytes event{is_to_us ? received_unicast : received_subscription};
  put_u16_le(event, message.source);
  put_u16_le(event,
             is_to_us ? message.destination : *flash_.addresses.subscription(message.destination));
  put_u16_le(event, handles->key);
  put_u16_le(event, handles->subnet);
  put_u8(event, reception.ttl);
  put_u8(event, 0x01);  // random static address, least significant octet first
  put_u16_le(event, message.source);
  put(event, Bytes{0xf9, 0x0b, 0x6e, 0xc1});
  put_u8(event, static_cast<std::uint8_t>(reception.rssi_dbm));
  put_u16_le(event, static_cast<std::uint16_t>(message.payload.size()));
  put(event, ByteView(message.payload).first(octets));
  to_host_.push(event);
}

std::optional<TimePoint> Board::deadline() const {
  const auto radio = first_of(first_of(boots_at_, provisioner_.deadline()), sender_.deadline());
  return first_of(first_of(radio, next_command_at()), to_host_.deadline());
}

void Board::on_deadline(TimePoint now) {
  if (boots_at_ && *boots_at_ <= now) {
    boots_at_.reset();
    partial_.clear();
    on_power_up();
  }
  take_from_line(now);
  to_host_.on_deadline(now);
  sender_.on_deadline(now);
  provisioner_.on_deadline(now);
  forward_events();
}

}  // namespace slamgw::sim::ble
