// SPDX-License-Identifier: Apache-2.0
// The commands; what happens on a link is in provisioner_link.cpp.
#include "simulation/ble/board/provisioner.hpp"

#include <algorithm>
#include <utility>

namespace slamgw::sim::ble {
namespace {

constexpr std::uint8_t unprovisioned_received = 0xc0;
constexpr std::size_t longest_command = 1 + 96;  // Keypair Set

/// Up to `size` octets from `offset` on; the firmware reads what is in its buffer.
template <std::size_t size>
std::array<std::uint8_t, size> octets_at(ByteView params, std::size_t offset) {
  std::array<std::uint8_t, size> out{};
  std::copy_n(params.begin() + static_cast<std::ptrdiff_t>(offset), size, out.begin());
  return out;
}

}  // namespace

Provisioner::Provisioner(Random random) : random_(random) { reset(); }

void Provisioner::reset() {
  is_scanning_ = false;
  key_pair_ = make_key_pair(random_);  // the firmware makes one when it starts
  contexts_ = {};
  events_.clear();
  signals_.clear();
}

std::optional<Reply> Provisioner::on_command(std::uint8_t opcode, ByteView params, TimePoint now) {
  Bytes padded(params.begin(), params.end());
  padded.resize(std::max(params.size(), longest_command));
  const bool has_context = opcode == 0x63 || (opcode >= 0x66 && opcode <= 0x68);
  if (has_context && padded[0] >= contexts) return Reply{Status::invalid_data, {}};
  switch (opcode) {
    case 0x61: return scan(true);
    case 0x62: return scan(false);
    case 0x63: return provision(padded, now);
    case 0x64:  // Listen: nobody provisions the board here
    case 0x6a:  // Capabilities Set: for Listen
      return Reply{};
    case 0x66: return oob_use(padded, now);
    case 0x67:
      return auth_data(ByteView(padded).first(std::max<std::size_t>(params.size(), 1)), now);
    case 0x68: return ecdh_secret(padded, now);
    case 0x69: return keypair_set(padded);
    default: return std::nullopt;
  }
}

Reply Provisioner::scan(bool is_on) {
  if (is_scanning_ == is_on) return {Status::invalid_state, {}};
  is_scanning_ = is_on;
  return {};
}

Reply Provisioner::provision(ByteView params, TimePoint now) {
  const std::uint8_t id = params[0];
  if (contexts_[id].state != State::idle) return {Status::invalid_state, {}};
  Context context;
  context.state = State::opening;
  context.link = ++last_link_;
  context.due = now + link_time;
  context.data.net_key = octets_at<16>(params, 17);
  context.data.net_key_index = get_u16_le(params, 33);
  context.data.iv_index =
      get_u16_le(params, 35) | static_cast<std::uint32_t>(get_u16_le(params, 37)) << 16;
  context.data.address = get_u16_le(params, 39);
  const int iv_update = params[41] & 1;
  const int key_refresh = params[42] & 1;
  context.data.flags = static_cast<std::uint8_t>(iv_update << 1 | key_refresh);
  context.attention_s = params[43];
  contexts_[id] = std::move(context);
  signals_.push_back({LinkSignal::Kind::open, last_link_, octets_at<16>(params, 1), {}});
  return {Status::success, {id}};
}

/// Sizes as the firmware wants them, here and in Auth Data: 0 without OOB, 16 for static OOB.
Reply Provisioner::oob_use(ByteView params, TimePoint now) {
  const std::uint8_t id = params[0];
  Context& context = contexts_[id];
  if (context.state != State::oob_use) return {Status::invalid_state, {}};
  const auto method = static_cast<OobMethod>(params[1]);
  if (method != OobMethod::none && method != OobMethod::static_oob) {
    return {Status::invalid_parameter, {}};
  }
  const std::size_t wanted_size = method == OobMethod::none ? 0 : sizeof(Key);
  if (params[3] != wanted_size) return {Status::invalid_length, {}};
  context.method = method;
  const Bytes start{0, 0, static_cast<std::uint8_t>(method), 0, 0};
  put(context.inputs, start);
  send(id, Pdu::start, start);
  send(id, Pdu::public_key, key_pair_.public_key);
  context.state = State::public_key;
  context.due = now + link_time;
  return {Status::success, {id}};
}

Reply Provisioner::ecdh_secret(ByteView params, TimePoint now) {
  const std::uint8_t id = params[0];
  Context& context = contexts_[id];
  if (context.state != State::ecdh_secret) return {Status::invalid_state, {}};
  context.secret = octets_at<32>(params, 1);
  context.authentication = authentication(context.inputs, context.secret);
  context.due = now + link_time;
  if (context.method == OobMethod::static_oob) {
    context.state = State::auth_data;
    events_.push_back({0xc6, id, static_cast<std::uint8_t>(context.method), 0, sizeof(Key)});
  } else {
    send_confirmation(id);
  }
  return {Status::success, {id}};
}

Reply Provisioner::auth_data(ByteView params, TimePoint now) {
  const std::uint8_t id = params[0];
  Context& context = contexts_[id];
  const ByteView value = params.subspan(1);
  const std::size_t wanted_size = context.method == OobMethod::none ? 0 : sizeof(Key);
  if (value.size() != wanted_size) return {Status::invalid_length, {}};
  if (context.state != State::auth_data) return {Status::invalid_state, {}};
  std::copy(value.begin(), value.end(), context.auth_value.begin());
  context.due = now + link_time;
  send_confirmation(id);
  return {Status::success, {id}};
}

Reply Provisioner::keypair_set(ByteView params) {
  key_pair_.private_key = octets_at<32>(params, 0);
  key_pair_.public_key = octets_at<64>(params, 32);
  return {};
}

void Provisioner::on_beacon(const Beacon& beacon) {
  if (!is_scanning_) return;
  Bytes event{unprovisioned_received};
  put(event, beacon.uuid);
  put_u8(event, static_cast<std::uint8_t>(beacon.rssi_dbm));
  put_u8(event, 0x00);  // no GATT bearer
  put_u8(event, 0x01);  // random static address, least significant octet first
  put_u16_le(event, beacon.number);
  put(event, Bytes{0xf9, 0x0b, 0x6e, 0xc1});
  events_.push_back(std::move(event));
}

std::optional<Bytes> Provisioner::next_event() {
  if (events_.empty()) return std::nullopt;
  Bytes event = std::move(events_.front());
  events_.pop_front();
  return event;
}

std::optional<LinkSignal> Provisioner::next_link_signal() {
  if (signals_.empty()) return std::nullopt;
  LinkSignal signal = std::move(signals_.front());
  signals_.pop_front();
  return signal;
}

}  // namespace slamgw::sim::ble
