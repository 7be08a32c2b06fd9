// SPDX-License-Identifier: Apache-2.0
// The provisioner on its links (Mesh Profile 1.0 section 5.4.2), in the order of Nordic's firmware:
// after both public keys the host is asked for the shared secret, then for the OOB value.
#include <algorithm>

#include "simulation/ble/board/provisioner.hpp"

namespace slamgw::sim::ble {
namespace {

constexpr std::uint8_t link_established = 0xc1;
constexpr std::uint8_t link_closed = 0xc2;
constexpr std::uint8_t capabilities_received = 0xc3;
constexpr std::uint8_t provisioning_complete = 0xc5;
constexpr std::uint8_t ecdh_request = 0xc7;
constexpr std::uint8_t provisioning_failed = 0xc9;

Key key_from(ByteView parameters) {
  Key key{};
  std::copy_n(parameters.begin(), key.size(), key.begin());
  return key;
}

}  // namespace

void Provisioner::send(std::uint8_t id, Pdu type, ByteView parameters) {
  signals_.push_back({LinkSignal::Kind::pdu, contexts_[id].link, {}, make_pdu(type, parameters)});
}

void Provisioner::send_confirmation(std::uint8_t id) {
  Context& context = contexts_[id];
  context.random = random_key(random_);
  context.state = State::confirmation;
  send(id, Pdu::confirmation,
       confirmation(context.authentication, context.random, context.auth_value));
}

void Provisioner::close(std::uint8_t id, CloseReason reason, TimePoint now) {
  contexts_[id].state = State::closing;
  contexts_[id].close_reason = reason;
  contexts_[id].due = now + closing_time;
  signals_.push_back({LinkSignal::Kind::close, contexts_[id].link, {}, {}});
}

void Provisioner::on_link_signal(const LinkSignal& signal, TimePoint now) {
  const auto found = std::find_if(contexts_.begin(), contexts_.end(), [&](const Context& c) {
    return c.state != State::idle && c.link == signal.link;
  });
  if (found == contexts_.end()) return;
  Context& context = *found;
  const auto id = static_cast<std::uint8_t>(found - contexts_.begin());
  switch (signal.kind) {
    case LinkSignal::Kind::opened:
      if (context.state != State::opening) return;
      events_.push_back({link_established, id});
      put_u8(context.inputs, context.attention_s);
      send(id, Pdu::invite, Bytes{context.attention_s});
      context.state = State::capabilities;
      context.due = now + link_time;
      return;
    case LinkSignal::Kind::pdu: return on_pdu(id, signal.pdu, now);
    case LinkSignal::Kind::open:  // only provisioners say these two here
    case LinkSignal::Kind::close: return;
  }
}

void Provisioner::on_pdu(std::uint8_t id, ByteView pdu, TimePoint now) {
  Context& context = contexts_[id];
  const bool has_link = context.state != State::idle && context.state != State::opening &&
                        context.state != State::closing;
  if (!has_link) return;
  if (pdu.empty() || pdu_size(pdu[0]) != pdu.size()) return close(id, CloseReason::fail, now);
  context.due = now + link_time;
  const Pdu type = static_cast<Pdu>(pdu[0]);
  const ByteView parameters = pdu.subspan(1);
  if (type == Pdu::failed) {
    events_.push_back({provisioning_failed, id, parameters[0]});
    return close(id, CloseReason::fail, now);
  }
  if (type == Pdu::capabilities && context.state == State::capabilities) {
    return on_capabilities(id, parameters);
  }
  if (type == Pdu::public_key && context.state == State::public_key) {
    return on_public_key(id, parameters);
  }
  if (type == Pdu::confirmation && context.state == State::confirmation) {
    context.peer_confirmation = key_from(parameters);
    context.state = State::random;
    return send(id, Pdu::random, context.random);
  }
  if (type == Pdu::random && context.state == State::random) return on_random(id, parameters, now);
  if (type == Pdu::complete && context.state == State::complete) return on_complete(id, now);
  close(id, CloseReason::fail, now);
}

/// In the event the octets are those of the PDU without the algorithms; its two masks are
/// little-endian.
void Provisioner::on_capabilities(std::uint8_t id, ByteView parameters) {
  Context& context = contexts_[id];
  put(context.inputs, parameters);
  context.state = State::oob_use;
  Bytes event{capabilities_received, id,           parameters[0], parameters[3],
              parameters[4],         parameters[5]};
  put_u16_le(event, get_u16_be(parameters, 6));
  put_u8(event, parameters[8]);
  put_u16_le(event, get_u16_be(parameters, 9));
  events_.push_back(std::move(event));
}

void Provisioner::on_public_key(std::uint8_t id, ByteView parameters) {
  Context& context = contexts_[id];
  std::copy_n(parameters.begin(), context.peer.size(), context.peer.begin());
  put(context.inputs, key_pair_.public_key);
  put(context.inputs, context.peer);
  context.state = State::ecdh_secret;
  Bytes event{ecdh_request, id};
  put(event, context.peer);
  put(event, key_pair_.private_key);
  events_.push_back(std::move(event));
}

/// A wrong confirmation is not told to the host but by the closed link.
void Provisioner::on_random(std::uint8_t id, ByteView parameters, TimePoint now) {
  Context& context = contexts_[id];
  const Key peer_random = key_from(parameters);
  if (confirmation(context.authentication, peer_random, context.auth_value) !=
      context.peer_confirmation) {
    return close(id, CloseReason::fail, now);
  }
  const SessionKeys keys =
      session_keys(context.secret, context.authentication, context.random, peer_random);
  context.device_key = keys.device_key;
  context.state = State::complete;
  send(id, Pdu::data, aes_ccm_encrypt(keys.session_key, keys.nonce, encode(context.data)));
}

void Provisioner::on_complete(std::uint8_t id, TimePoint now) {
  const Context& context = contexts_[id];
  Bytes event{provisioning_complete, id};
  put_u32_le(event, context.data.iv_index);
  put_u16_le(event, context.data.net_key_index);
  put_u16_le(event, context.data.address);
  put_u8(event, static_cast<std::uint8_t>(context.data.flags >> 1 & 1));
  put_u8(event, static_cast<std::uint8_t>(context.data.flags & 1));
  put(event, context.device_key);
  put(event, context.data.net_key);
  events_.push_back(std::move(event));
  close(id, CloseReason::success, now);
}

std::optional<TimePoint> Provisioner::deadline() const {
  std::optional<TimePoint> next;
  for (const Context& context : contexts_) {
    if (context.state != State::idle) next = first_of(next, context.due);
  }
  return next;
}

void Provisioner::on_deadline(TimePoint now) {
  for (std::uint8_t id = 0; id < contexts; ++id) {
    Context& context = contexts_[id];
    if (context.state == State::idle || context.due > now) continue;
    if (context.state != State::closing) {
      close(id, CloseReason::timeout, now);
      continue;
    }
    events_.push_back({link_closed, id, static_cast<std::uint8_t>(context.close_reason)});
    context = Context{};
  }
}

}  // namespace slamgw::sim::ble
