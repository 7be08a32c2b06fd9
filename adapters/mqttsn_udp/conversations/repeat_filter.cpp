// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/repeat_filter.hpp"

#include <algorithm>

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
    return entry.receipt_id == 0 && now - entry.since > limits::repeat_window;
  };
  while (entries_.size() > 1 && is_over(entries_.front())) entries_.pop_front();
  sets_dup_ |= publish.dup;
  Entry* known = newest([&](const Entry& entry) {
    return entry.msg_id == publish.msg_id && entry.fingerprint == fingerprint && !is_over(entry);
  });
  if (!known || !is_repeat(*known, publish, now)) return nullptr;
  if (known->receipt_id == 0 && !publish.dup) ++known->repeats;
  return known;
}

/// Whether a message that equals `known`, and comes within its window, repeats it.
bool RepeatFilter::is_repeat(const Entry& known, const Publish& publish, TimePoint now) const {
  if (known.receipt_id != 0 || publish.dup) return true;
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
  const bool is_reused = newest([&](const Entry& old) { return old.msg_id == entry.msg_id; });
  if (is_reused && reuses_ids_) counted_ids_ = 0;  // one alone may be a copy made by the network
  reuses_ids_ = is_reused;
  on_request(entry.msg_id);
  if (entries_.full()) {
    static_assert(limits::max_open_receipts < limits::max_repeats);
    const auto is_acknowledged = [](const Entry& other) { return other.receipt_id == 0; };
    const auto oldest = std::find_if(entries_.begin(), entries_.end(), is_acknowledged);
    if (oldest != entries_.end()) entries_.rerase(oldest);
  }
  entries_.push_back(entry);
}

void RepeatFilter::clear() { *this = {}; }

bool RepeatFilter::on_safe(std::uint64_t receipt_id, TimePoint now) {
  Entry* known = newest([&](const Entry& entry) { return entry.receipt_id == receipt_id; });
  if (!known) return false;
  known->receipt_id = 0;
  known->since = now;
  return true;
}

bool RepeatFilter::on_refused(std::uint64_t receipt_id) {
  const auto known = std::find_if(entries_.begin(), entries_.end(), [&](const Entry& entry) {
    return entry.receipt_id == receipt_id;
  });
  if (known == entries_.end()) return false;
  entries_.erase(known);
  return true;
}

}  // namespace slamgw::mqttsn
