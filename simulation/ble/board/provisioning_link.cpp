// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/board/provisioning_link.hpp"

#include <algorithm>

namespace slamgw::sim::ble {
namespace {

constexpr std::uint8_t link_established = 0xc1;
constexpr std::uint8_t link_closed = 0xc2;
constexpr std::uint8_t capabilities_received = 0xc3;
constexpr std::uint8_t provisioning_complete = 0xc5;
constexpr std::uint8_t auth_request = 0xc6;
constexpr std::uint8_t ecdh_request = 0xc7;
constexpr std::uint8_t provisioning_failed = 0xc9;

/// Returns `size` octets from `offset` on.
template <std::size_t size>
std::array<std::uint8_t, size> octets_at(ByteView params, std::size_t offset) {
  std::array<std::uint8_t, size> out{};
  std::copy_n(params.begin() + static_cast<std::ptrdiff_t>(offset), size, out.begin());
  return out;
}

ProvisioningData data_from(ByteView params) {
  ProvisioningData data;
  data.net_key = octets_at<16>(params, 17);
  data.net_key_index = get_u16_le(params, 33);
  data.iv_index = get_u16_le(params, 35) | static_cast<std::uint32_t>(get_u16_le(params, 37)) << 16;
  data.address = get_u16_le(params, 39);
  const int iv_update = params[41] & 1;
  const int key_refresh = params[42] & 1;
  data.flags = static_cast<std::uint8_t>(iv_update << 1 | key_refresh);
  return data;
}

std::size_t value_size(OobMethod method) {
  return method == OobMethod::static_oob ? sizeof(Key) : 0;
}

}  // namespace

void ProvisioningLink::reset() {
  state_ = State::idle;
  context_ = Context{};
}

Reply ProvisioningLink::provision(ByteView params, std::uint32_t link, TimePoint now) {
  if (state_ != State::idle) return {Status::invalid_state};
  state_ = State::opening;
  context_ = Context{};
  context_.link = link;
  context_.due = now + link_time;
  context_.data = data_from(params);
  if (shared_.firmware.has_attention_octet) context_.attention_s = params[43];
  shared_.signals.push_back({LinkSignal::Kind::open, link, octets_at<16>(params, 1), {}});
  return {Status::success, {id_}};
}

/// The board ignores the capabilities of the device.
Reply ProvisioningLink::oob_use(ByteView params, TimePoint now) {
  if (state_ != State::oob_use) return {Status::invalid_state};
  const auto method = static_cast<OobMethod>(params[1]);
  if (!takes_size(method, params[3])) return {Status::invalid_length};
  context_.method = method;
  const Bytes start{0, 0, static_cast<std::uint8_t>(method), 0, 0};
  put(context_.inputs, start);
  send(Pdu::start, start);
  send(Pdu::public_key, shared_.key_pair.public_key);
  state_ = State::public_key;
  context_.due = now + link_time;
  return {Status::success, {id_}};
}

bool ProvisioningLink::takes_size(OobMethod method, std::uint8_t size) const {
  if (method == OobMethod::none) return size == 0;
  if (method != OobMethod::static_oob) return false;
  return size == sizeof(Key) || !shared_.firmware.checks_static_oob_size;
}

Reply ProvisioningLink::auth_data(ByteView params, TimePoint now) {
  const ByteView value = params.subspan(1);
  const bool has_size = value.size() == value_size(context_.method);
  const bool is_awaited = state_ == State::auth_data;
  if (shared_.firmware.checks_link_before_size && !is_awaited) return {Status::invalid_state};
  if (!has_size) return {Status::invalid_length};
  if (!is_awaited) return {Status::invalid_state};
  std::copy(value.begin(), value.end(), context_.auth_value.begin());
  context_.due = now + link_time;
  send_confirmation();
  return {Status::success, {id_}};
}

Reply ProvisioningLink::ecdh_secret(ByteView params, TimePoint now) {
  if (state_ != State::ecdh_secret) return {Status::invalid_state};
  context_.secret = octets_at<32>(params, 1);
  context_.authentication = authentication(context_.inputs, context_.secret);
  context_.due = now + link_time;
  if (context_.method == OobMethod::static_oob) {
    state_ = State::auth_data;
    shared_.events.push_back(
        {auth_request, id_, static_cast<std::uint8_t>(context_.method), 0, sizeof(Key)});
  } else {
    send_confirmation();
  }
  return {Status::success, {id_}};
}

void ProvisioningLink::send(Pdu type, ByteView parameters) {
  shared_.signals.push_back({LinkSignal::Kind::pdu, context_.link, {}, make_pdu(type, parameters)});
}

void ProvisioningLink::send_confirmation() {
  context_.random = random_key(shared_.random);
  state_ = State::confirmation;
  send(Pdu::confirmation,
       confirmation(context_.authentication, context_.random, context_.auth_value));
}

void ProvisioningLink::close(CloseReason reason, TimePoint now) {
  state_ = State::closing;
  context_.close_reason = reason;
  context_.due = now + closing_time;
  shared_.signals.push_back({LinkSignal::Kind::close, context_.link, {}, {}});
}

void ProvisioningLink::on_signal(const LinkSignal& signal, TimePoint now) {
  switch (signal.kind) {
    case LinkSignal::Kind::opened: return on_opened(now);
    case LinkSignal::Kind::pdu: return on_pdu(signal.pdu, now);
    case LinkSignal::Kind::open:  // only provisioners send these two
    case LinkSignal::Kind::close: return;
  }
}

void ProvisioningLink::on_opened(TimePoint now) {
  if (state_ != State::opening) return;
  shared_.events.push_back({link_established, id_});
  put_u8(context_.inputs, context_.attention_s);
  send(Pdu::invite, Bytes{context_.attention_s});
  state_ = State::capabilities;
  context_.due = now + link_time;
}

void ProvisioningLink::on_pdu(ByteView pdu, TimePoint now) {
  const bool is_open =
      state_ != State::idle && state_ != State::opening && state_ != State::closing;
  if (!is_open) return;
  if (pdu.empty() || pdu_size(pdu[0]) != pdu.size()) return close(CloseReason::fail, now);
  context_.due = now + link_time;
  on_expected(static_cast<Pdu>(pdu[0]), pdu.subspan(1), now);
}

void ProvisioningLink::on_expected(Pdu type, ByteView parameters, TimePoint now) {
  if (type == Pdu::failed) {
    shared_.events.push_back({provisioning_failed, id_, parameters[0]});
    return close(CloseReason::fail, now);
  }
  if (type == Pdu::capabilities && state_ == State::capabilities) {
    return on_capabilities(parameters);
  }
  if (type == Pdu::public_key && state_ == State::public_key) return on_public_key(parameters);
  if (type == Pdu::confirmation && state_ == State::confirmation) {
    context_.peer_confirmation = octets_at<16>(parameters, 0);
    state_ = State::random;
    return send(Pdu::random, context_.random);
  }
  if (type == Pdu::random && state_ == State::random) return on_random(parameters, now);
  if (type == Pdu::complete && state_ == State::complete) return on_complete(now);
  close(CloseReason::fail, now);
}

/// The event holds the octets of the PDU without the algorithms; its two masks are little-endian.
void ProvisioningLink::on_capabilities(ByteView parameters) {
  put(context_.inputs, parameters);
  state_ = State::oob_use;
  Bytes event{capabilities_received, id_,           parameters[0],
              parameters[3],         parameters[4], parameters[5]};
  put_u16_le(event, get_u16_be(parameters, 6));
  put_u8(event, parameters[8]);
  put_u16_le(event, get_u16_be(parameters, 9));
  shared_.events.push_back(std::move(event));
}

void ProvisioningLink::on_public_key(ByteView parameters) {
  context_.peer = octets_at<64>(parameters, 0);
  put(context_.inputs, shared_.key_pair.public_key);
  put(context_.inputs, context_.peer);
  state_ = State::ecdh_secret;
  Bytes event{ecdh_request, id_};
  put(event, context_.peer);
  put(event, shared_.key_pair.private_key);
  shared_.events.push_back(std::move(event));
}

/// After a wrong confirmation, the host gets only the event that the link is closed.
void ProvisioningLink::on_random(ByteView parameters, TimePoint now) {
  const Key peer_random = octets_at<16>(parameters, 0);
  if (confirmation(context_.authentication, peer_random, context_.auth_value) !=
      context_.peer_confirmation) {
    return close(CloseReason::fail, now);
  }
  const SessionKeys keys =
      session_keys(context_.secret, context_.authentication, context_.random, peer_random);
  context_.device_key = keys.device_key;
  state_ = State::complete;
  send(Pdu::data, aes_ccm_encrypt(keys.session_key, keys.nonce, encode(context_.data)));
}

void ProvisioningLink::on_complete(TimePoint now) {
  Bytes event{provisioning_complete, id_};
  put_u32_le(event, context_.data.iv_index);
  put_u16_le(event, context_.data.net_key_index);
  put_u16_le(event, context_.data.address);
  put_u8(event, static_cast<std::uint8_t>(context_.data.flags >> 1 & 1));
  put_u8(event, static_cast<std::uint8_t>(context_.data.flags & 1));
  put(event, context_.device_key);
  put(event, context_.data.net_key);
  shared_.events.push_back(std::move(event));
  close(CloseReason::success, now);
}

std::optional<TimePoint> ProvisioningLink::deadline() const {
  return state_ == State::idle ? std::nullopt : std::optional(context_.due);
}

void ProvisioningLink::on_deadline(TimePoint now) {
  if (state_ == State::idle || context_.due > now) return;
  if (state_ != State::closing) return close(CloseReason::timeout, now);
  shared_.events.push_back({link_closed, id_, static_cast<std::uint8_t>(context_.close_reason)});
  reset();
}

}  // namespace slamgw::sim::ble
