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

/// The last entry stays: it shows whether the next message has its MsgId.
const RepeatFilter::Entry* RepeatFilter::find(const Publish& publish, std::uint64_t fingerprint,
                                              TimePoint now) {
  while (size() > 1 && now - entries_[gone_].since > limits::repeat_window &&
         entries_[gone_].receipt_id == 0) {
    pop_front();
  }
  const auto is_same = [&](const Entry& entry) {
    const bool is_fresh = entry.receipt_id != 0 || now - entry.since <= limits::repeat_window;
    return entry.fingerprint == fingerprint && is_fresh;
  };
  sets_dup_ |= publish.dup;
  Entry* newest = nullptr;
  auto from = msg_ids_.begin() + static_cast<std::ptrdiff_t>(gone_);
  while ((from = std::find(from, msg_ids_.end(), publish.msg_id)) != msg_ids_.end()) {
    Entry& entry = entries_[static_cast<std::size_t>(from++ - msg_ids_.begin())];
    if (is_same(entry)) newest = &entry;
  }
  if (!newest || !is_repeat(*newest, publish, now)) return nullptr;
  if (newest->receipt_id == 0 && !publish.dup) ++newest->repeats;
  return newest;
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
  const auto begin = msg_ids_.begin() + static_cast<std::ptrdiff_t>(gone_);
  const bool is_reused = std::find(begin, msg_ids_.end(), entry.msg_id) != msg_ids_.end();
  if (is_reused && reuses_ids_) counted_ids_ = 0;  // one alone may be a copy made by the network
  reuses_ids_ = is_reused;
  on_request(entry.msg_id);
  if (size() >= limits::max_repeats) pop_front();
  entries_.push_back(entry);
  msg_ids_.push_back(entry.msg_id);
}

void RepeatFilter::clear() { *this = {}; }

/// Removes entries in halves, so that each entry is moved a bounded number of times.
void RepeatFilter::pop_front() {
  ++gone_;
  if (2 * gone_ < entries_.size()) return;
  erase(0, gone_);
  gone_ = 0;
}

void RepeatFilter::erase(std::size_t begin, std::size_t end) {
  const auto of = [](auto& all, std::size_t at) {
    return all.begin() + static_cast<std::ptrdiff_t>(at);
  };
  entries_.erase(of(entries_, begin), of(entries_, end));
  msg_ids_.erase(of(msg_ids_, begin), of(msg_ids_, end));
  // A client that goes on as before needs this memory again.
  if (4 * entries_.size() > entries_.capacity()) return;
  entries_.shrink_to_fit();
  msg_ids_.shrink_to_fit();
}

bool RepeatFilter::on_safe(std::uint64_t receipt_id, TimePoint now) {
  const auto found = find_receipt(receipt_id);
  if (found == entries_.rend()) return false;
  found->receipt_id = 0;
  found->since = now;
  return true;
}

std::optional<RepeatFilter::Entry> RepeatFilter::on_refused(std::uint64_t receipt_id) {
  const auto found = find_receipt(receipt_id);
  if (found == entries_.rend()) return std::nullopt;
  const Entry entry = *found;
  const auto at = static_cast<std::size_t>(&*found - entries_.data());
  erase(at, at + 1);
  if (at < gone_) --gone_;
  return entry;
}

std::vector<RepeatFilter::Entry>::reverse_iterator RepeatFilter::find_receipt(
    std::uint64_t receipt_id) {
  return std::find_if(entries_.rbegin(), entries_.rend(),
                      [&](const Entry& entry) { return entry.receipt_id == receipt_id; });
}

}  // namespace slamgw::mqttsn
