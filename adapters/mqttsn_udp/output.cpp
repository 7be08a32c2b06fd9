// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/output.hpp"

#include <algorithm>
#include <type_traits>
#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

Counters Output::counters() const {
  constexpr std::array<std::string_view, std::tuple_size_v<decltype(counts_)>> names = {
      "datagrams_in",        "datagrams_out",    "malformed",
      "oversized",           "unexpected",       "strangers",
      "unanswered",          "connects",         "connects_refused",
      "handshakes_given_up", "clients_lost",     "clients_revived",
      "clients_evicted",     "published_up",     "repeats_suppressed",
      "unknown_topic_ids",   "topics_refused",   "receipts_refused",
      "unconnected_refused", "delivered_down",   "retransmitted",
      "deliveries_given_up", "queue_dropped",    "too_large_down",
      "topics_set_aside",    "wills_refused",    "unvalidated",
      "subscribes_bounded",  "answered_unsaved", "banned",
      "identity_missing"};
  static_assert(!names.back().empty(), "a name for each counter");
  Counters counters;
  for (std::size_t i = 0; i < names.size(); ++i) counters.push_back({names[i], counts_[i]});
  return counters;
}

namespace {

/// Returns true if the client relies on this answer: its session must match it even after a crash.
bool is_promise(const Packet& packet) {
  const auto is_one = [](const auto& answer) {
    using Type = std::decay_t<decltype(answer)>;
    if constexpr (std::is_same_v<Type, Puback>) return false;
    if constexpr (requires { answer.code; }) return answer.code == ReturnCode::accepted;
    return std::is_same_v<Type, Unsuback> || std::is_same_v<Type, Disconnect> ||
           std::is_same_v<Type, Register>;
  };
  return std::visit(is_one, packet);
}

}  // namespace

void Output::send(const ClientSession& session, Packet packet) {
  // A PINGRESP confirms the address at which a sleeper has woken, if that is new.
  const bool is_news = std::holds_alternative<Pingresp>(packet) && changed_.has(session);
  const ClientSession* const promised = is_news || is_promise(packet) ? &session : nullptr;
  if (session.peer) send(*session.peer, session.local, std::move(packet), 0, promised);
}

void Output::send(const Peer& to, const LocalAddress& from, Packet packet, std::uint8_t radius,
                  const ClientSession* promised) {
  Bytes bytes = encode(std::move(packet));
  if (!to.node_id.empty()) bytes = encode_encapsulation(radius, to.node_id, bytes);
  if (!validation.may_send(to.endpoint.address, bytes.size())) return count(Count::unvalidated);
  validation.on_sent(to.endpoint.address, bytes.size());
  count(Count::datagrams_out);
  SendDatagram datagram{from, to.endpoint, std::move(bytes), to.identity};
  if (promised) changed_.mark(*promised);
  if (!unsaved_.take(datagram, promised ? &promised->client_id : nullptr)) {
    if (promised && has_store_) count(Count::answered_unsaved);
    return actions_.push(std::move(datagram));
  }
  if (unsaved_.is_full()) send_unsaved();
}

std::vector<std::string> Output::take_changed(std::size_t max) {
  const std::set<std::string> first = unsaved_.begin_save();
  for (const std::string& id : first) changed_.unmark(id);
  std::vector<std::string> ids = changed_.take(max - std::min(max, first.size()));
  ids.insert(ids.begin(), first.begin(), first.end());
  return ids;
}

void Output::on_saved(bool is_saved, TimePoint now) {
  if (is_saved) {
    for (SendDatagram& datagram : unsaved_.on_saved()) actions_.push(std::move(datagram));
    return;
  }
  const bool is_news = has_unsaved_answers() && unsaved_lines_.on_event(now);
  send_unsaved();
  if (!is_news) return;
  emit(Notice{
      Severity::warning,
      "the disk fails or is too slow: MQTT-SN clients are answered before their sessions are "
      "saved, and after a crash some have to connect again",
      {}});
}

void Output::send_unsaved() {
  for (SendDatagram& datagram : unsaved_.give_up()) {
    count(Count::answered_unsaved);
    actions_.push(std::move(datagram));
  }
}

bool Output::is_validated(const ClientSession& session) const {
  return !session.peer || validation.is_validated(session.peer->endpoint.address);
}

bool Output::may_send(const ClientSession& session, std::size_t octets) const {
  return !session.peer ||
         validation.may_send(session.peer->endpoint.address, octets + overhead(session, octets));
}

bool Output::fits(const ClientSession& session, std::size_t octets) const {
  return octets + overhead(session, octets) <= limits::max_datagram_octets;
}

/// Returns the octets to add for a forwarder's header, the 3-octet Length and a DTLS record. The
/// record counts with the part of a datagram that it does not use.
std::size_t Output::overhead(const ClientSession& session, std::size_t octets) {
  const bool is_forwarded = session.peer && !session.peer->node_id.empty();
  const std::size_t header = is_forwarded ? 3 + session.peer->node_id.size() : 0;
  const std::size_t long_length = octets > 255 ? 2 : 0;
  constexpr std::size_t of_record = limits::max_datagram_octets - limits::max_dtls_record_octets +
                                    limits::max_dtls_overhead_octets;
  const bool is_in_record = session.peer && !session.peer->identity.empty();
  return header + long_length + (is_in_record ? of_record : 0);
}

void Output::send_multicast(const Packet& packet, std::uint32_t interface) {
  count(Count::datagrams_out);
  actions_.push(SendMulticast{encode(packet), interface});
}

}  // namespace slamgw::mqttsn
