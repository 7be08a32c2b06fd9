// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/repeat_filter.hpp"

#include <algorithm>
#include <iterator>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {
namespace {

constexpr std::uint64_t fnv_offset = 0xcbf29ce484222325U;
constexpr std::uint64_t fnv_prime = 0x100000001b3U;

std::uint64_t mix(std::uint64_t hash, std::uint8_t octet) { return (hash ^ octet) * fnv_prime; }

std::uint64_t mix(std::uint64_t hash, ByteView octets) {
  for (const std::uint8_t octet : octets) hash = mix(hash, octet);
  return hash;
}

std::uint64_t never_0(std::uint64_t hash) { return hash == 0 ? 1 : hash; }

bool is_open(const RepeatFilter::Entry& entry) {
  return entry.receipt_id != 0 || entry.awaits_pubrel;
}

bool is_safe_exchange(const RepeatFilter::Entry& entry) {
  return entry.receipt_id == 0 && entry.awaits_pubrel;
}

void end_exchange(RepeatFilter::Entry& exchange, TimePoint now) {
  exchange.awaits_pubrel = false;
  exchange.since = now;
}

}  // namespace

std::uint64_t fingerprint(const Publish& publish) {
  std::uint64_t hash = mix(fnv_offset, static_cast<std::uint8_t>(publish.topic_id_type));
  hash = mix(hash, static_cast<std::uint8_t>(publish.qos));
  hash = mix(hash, static_cast<std::uint8_t>(publish.retain));
  hash = mix(hash, static_cast<std::uint8_t>(publish.topic_id >> 8));
  hash = mix(hash, static_cast<std::uint8_t>(publish.topic_id & 0xff));
  return never_0(mix(hash, publish.payload));
}

std::uint64_t fingerprint(ByteView bytes) { return never_0(mix(fnv_offset, bytes)); }

/// Searches the two arrays of the buffer, because its iterators take four times as long.
template <class Predicate>
RepeatFilter::Entry* RepeatFilter::newest(Predicate is_wanted) {
  for (const auto& [begin, size] : {entries_.array_two(), entries_.array_one()}) {
    for (Entry* each = begin + size; each != begin;)
      if (is_wanted(*--each)) return each;
  }
  return nullptr;
}

/// The last entry stays: it shows whether the next message has its MsgId.
const RepeatFilter::Entry* RepeatFilter::find(const Publish& publish, std::uint64_t fingerprint,
                                              TimePoint now) {
  const auto is_over = [&](const Entry& entry) {
    return !is_open(entry) && now - entry.since > limits::repeat_window;
  };
  while (entries_.size() > 1 && is_over(entries_.front())) entries_.pop_front();
  if (entries_.size() > 1 && entries_.front().awaits_pubrel) {  // perhaps for ever
    const auto last = std::prev(entries_.end());
    entries_.erase(std::remove_if(entries_.begin(), last, is_over), last);
  }
  sets_dup_ |= publish.dup;
  Entry* known = newest([&](const Entry& entry) {
    return entry.msg_id == publish.msg_id && entry.fingerprint == fingerprint && !is_over(entry);
  });
  if (!known || !is_repeat(*known, publish, now)) return nullptr;
  if (!is_open(*known) && !publish.dup) ++known->repeats;
  return known;
}

/// Whether a message that equals `known`, and comes within its window, repeats it.
bool RepeatFilter::is_repeat(const Entry& known, const Publish& publish, TimePoint now) const {
  if (is_open(known) || publish.dup) return true;
  if (reuses_ids_ || known.repeats >= limits::max_client_repeats) return false;
  const bool may_lack_puback = publish.qos == WireQos::one && !sets_dup_ &&
                               now - known.since >= limits::shortest_client_retry;
  return counts_ids() || may_lack_puback;
}

bool RepeatFilter::counts_ids() const { return counted_ids_ >= limits::min_counted_ids; }

void RepeatFilter::set_counts_ids() { counted_ids_ = limits::min_counted_ids; }

void RepeatFilter::on_request(std::uint16_t msg_id) {
  constexpr int longest_step = 2;      // one request may be lost
  constexpr int furthest_behind = 16;  // late copies do not count
  const auto step = static_cast<std::int16_t>(msg_id - last_msg_id_);
  if (step > 0 && step <= longest_step && counted_ids_ < limits::min_counted_ids) ++counted_ids_;
  if (step > 0 || step < -furthest_behind) last_msg_id_ = msg_id;
}

void RepeatFilter::add(const Entry& entry) {
  if (entry.awaits_pubrel) make_room_for(entry);
  const bool is_reused = newest([&](const Entry& old) { return old.msg_id == entry.msg_id; });
  if (is_reused && reuses_ids_) counted_ids_ = 0;  // one alone may be a copy made by the network
  reuses_ids_ = is_reused;
  on_request(entry.msg_id);
  if (entries_.full()) {
    static_assert(limits::max_open_receipts + limits::max_inbound_qos2 < limits::max_repeats);
    const auto oldest = std::find_if_not(entries_.begin(), entries_.end(), is_open);
    if (oldest != entries_.end()) entries_.rerase(oldest);
  }
  entries_.push_back(entry);
}

/// If the MsgId is that of another open exchange, its message differs: the client has given up the
/// former message. One of too many exchanges is safe, because each other has an open receipt.
void RepeatFilter::make_room_for(const Entry& exchange) {
  static_assert(limits::max_open_receipts <= limits::max_inbound_qos2);
  const auto former = std::find_if(entries_.begin(), entries_.end(), [&](const Entry& other) {
    return other.awaits_pubrel && other.msg_id == exchange.msg_id;
  });
  if (former != entries_.end()) entries_.erase(former);
  const auto open = std::ranges::count(entries_, true, &Entry::awaits_pubrel);
  if (static_cast<std::size_t>(open) < limits::max_inbound_qos2) return;
  const auto oldest = std::find_if(entries_.begin(), entries_.end(), is_safe_exchange);
  if (oldest != entries_.end()) end_exchange(*oldest, exchange.since);
}

bool RepeatFilter::on_pubrel(std::uint16_t msg_id, TimePoint now) {
  Entry* open =
      newest([&](const Entry& entry) { return is_safe_exchange(entry) && entry.msg_id == msg_id; });
  if (open) end_exchange(*open, now);
  return open;
}

void RepeatFilter::clear() { *this = {}; }

const RepeatFilter::Entry* RepeatFilter::on_safe(std::uint64_t receipt_id, TimePoint now) {
  Entry* known = newest([&](const Entry& entry) { return entry.receipt_id == receipt_id; });
  if (!known) return nullptr;
  known->receipt_id = 0;
  known->since = now;
  return known;
}

std::optional<RepeatFilter::Entry> RepeatFilter::on_refused(std::uint64_t receipt_id) {
  const auto known = std::find_if(entries_.begin(), entries_.end(), [&](const Entry& entry) {
    return entry.receipt_id == receipt_id;
  });
  if (known == entries_.end()) return std::nullopt;
  const Entry refused = *known;
  entries_.erase(known);
  return refused;
}

}  // namespace slamgw::mqttsn
