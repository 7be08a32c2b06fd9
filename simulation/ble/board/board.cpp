// SPDX-License-Identifier: Apache-2.0
// The board's life, frames and radio; what the commands do is in board_commands.cpp and
// board_mesh_commands.cpp.
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
constexpr std::uint8_t tx_complete = 0xd2;
constexpr std::uint8_t heartbeat_received = 0xd8;

// Commands that do not end in a Command Response
constexpr std::uint8_t echo = 0x02;
constexpr std::uint8_t radio_reset = 0x0e;

constexpr std::uint16_t relay_feature = 0x0001;
constexpr std::size_t max_event_data = 235;
constexpr Key factory_uuid{0x5c, 0x1a, 0x6e, 0x00, 0x11, 0x22, 0x33, 0x44,
                           0x55, 0x66, 0x77, 0x88, 0x99, 0xaa, 0xbb, 0x01};

bool is_setup_command(std::uint8_t opcode) { return opcode >= 0x90 && opcode <= 0xaa; }

}  // namespace

Board::Board(Random random) : uuid_(factory_uuid), provisioner_(random) {}

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
void Board::on_power_up(TimePoint) {
  is_enabled_ = true;
  send_to_host({device_started, 0x02, 0x00, 0xfe});
}

void Board::restore(BoardFlash flash) {
  flash_ = std::move(flash);
  next_sequence_ = flash_.reserved_sequence;
}

void Board::reboot(TimePoint now, Duration downtime) {
  is_enabled_ = false;
  uuid_ = factory_uuid;
  provisioner_.reset();
  tokens_.clear();
  sessions_.clear();
  heard_.clear();
  next_sequence_ = flash_.reserved_sequence;
  last_token_ = 0;
  dropped_ = 0;
  to_host_.clear();
  to_host_octets_ = 0;
  to_air_.clear();
  boots_at_ = now + downtime;
}

void Board::on_host_bytes(ByteView bytes, TimePoint now) {
  for (const std::uint8_t octet : bytes) {
    if (boots_at_) return;  // nobody listens
    if (partial_.empty() && octet == 0) {
      respond(0x00, {Status::invalid_length, {}});
      continue;
    }
    partial_.push_back(octet);
    if (partial_.size() < 1 + std::size_t{partial_[0]}) continue;
    const Bytes packet(partial_.begin() + 1, partial_.end());
    partial_.clear();
    on_packet(packet, now);
  }
}

void Board::on_packet(ByteView packet, TimePoint now) {
  const std::uint8_t opcode = packet[0];
  const ByteView params = packet.subspan(1);
  if (is_setup_command(opcode)) last_setup_ = now;
  if (opcode == echo) {
    Bytes event{echo_response};
    put(event, params);
    return send_to_host(std::move(event));
  }
  if (opcode >= 0x60 && opcode <= 0x6f) return on_provisioning(opcode, params, now);
  if (opcode == radio_reset && params.empty()) return reboot(now);
  if (opcode == radio_reset) return respond(opcode, {Status::invalid_length, {}});
  const Command* command = find_command(opcode);
  if (command == nullptr) return respond(opcode, {Status::command_unknown, {}});
  if (params.size() < command->min_params || params.size() > command->max_params) {
    return respond(opcode, {Status::invalid_length, {}});
  }
  respond(opcode, (this->*command->run)(params, now));
}

void Board::on_provisioning(std::uint8_t opcode, ByteView params, TimePoint now) {
  if (const std::optional<Reply> reply = provisioner_.on_command(opcode, params, now)) {
    respond(opcode, *reply);
  }
  forward_events();
}

void Board::forward_events() {
  while (auto event = provisioner_.next_event()) send_to_host(std::move(*event));
}

void Board::respond(std::uint8_t opcode, const Reply& reply) {
  Bytes event{command_response, opcode, static_cast<std::uint8_t>(reply.status)};
  if (reply.status == Status::success) put(event, reply.data);
  send_to_host(std::move(event));
}

void Board::send_to_host(Bytes opcode_and_params) {
  Bytes packet{static_cast<std::uint8_t>(opcode_and_params.size())};
  put(packet, opcode_and_params);
  if (to_host_octets_ + packet.size() > transmit_buffer) {
    ++dropped_;
    return;
  }
  to_host_octets_ += packet.size();
  to_host_.push_back(std::move(packet));
}

std::optional<Bytes> Board::next_host_packet() {
  if (to_host_.empty()) return std::nullopt;
  Bytes packet = std::move(to_host_.front());
  to_host_.pop_front();
  to_host_octets_ -= packet.size();
  return packet;
}

std::optional<Board::Transmission> Board::next_transmission() {
  if (to_air_.empty()) return std::nullopt;
  Transmission first = std::move(to_air_.front());
  to_air_.pop_front();
  return first;
}

bool Board::hears(Address destination) const {
  return listens_to(destination) && flash_.appkeys.primary();
}

bool Board::listens_to(Address destination) const {
  if (boots_at_ || !is_enabled_) return false;
  if (is_group(destination)) return flash_.addresses.subscription(destination).has_value();
  return flash_.local_count > 0 && destination >= flash_.local_start &&
         destination < flash_.local_start + flash_.local_count;
}

bool Board::is_ready_for(Address destination, TimePoint now) const {
  constexpr std::chrono::milliseconds settled{500};
  return hears(destination) && last_setup_ && now - *last_setup_ >= settled;
}

/// Device keys belong to their owner's address, as far as messages that come are concerned.
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

void Board::on_heartbeat(Address source, std::uint8_t initial_ttl, std::uint8_t hops) {
  if (!listens_to(flash_.local_start)) return;
  Bytes event{heartbeat_received, initial_ttl, hops};
  put_u16_le(event, relay_feature);
  put_u16_le(event, source);
  send_to_host(std::move(event));
}

void Board::on_link_signal(const LinkSignal& signal, TimePoint now) {
  if (boots_at_) return;
  provisioner_.on_link_signal(signal, now);
  forward_events();
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
  send_to_host(std::move(event));
}

std::optional<TimePoint> Board::deadline() const {
  std::optional<TimePoint> next = first_of(boots_at_, provisioner_.deadline());
  for (const auto& [token, due] : tokens_) next = first_of(next, due);
  return next;
}

void Board::on_deadline(TimePoint now) {
  if (boots_at_ && *boots_at_ <= now) {
    boots_at_.reset();
    partial_.clear();
    on_power_up(now);
  }
  for (auto it = tokens_.begin(); it != tokens_.end();) {
    if (it->second > now) {
      ++it;
      continue;
    }
    send_tx_complete(it->first);
    it = tokens_.erase(it);
  }
  provisioner_.on_deadline(now);
  forward_events();
}

void Board::send_tx_complete(std::uint32_t token) {
  Bytes event{tx_complete};
  put_u32_le(event, token);
  send_to_host(std::move(event));
}

void Board::on_transfer_ended(std::uint64_t transfer, bool is_acknowledged) {
  const auto session = std::find_if(sessions_.begin(), sessions_.end(),
                                    [&](const Session& s) { return s.transfer == transfer; });
  if (session == sessions_.end()) return;  // the board has rebooted since
  if (is_acknowledged) send_tx_complete(session->token);
  sessions_.erase(session);
}

}  // namespace slamgw::sim::ble
