// SPDX-License-Identifier: Apache-2.0
// Recognises the repetition of a QoS 1 message (and of a QoS 2 message that is complete) by client,
// MsgId, topic and payload within a window, whether DUP is set or not (R76): common clients repeat
// without DUP, some count MsgIds badly, and robots send steps that must not count twice. MsgId
// alone is never enough.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "adapters/mqttsn_udp/protocol/packet.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::mqttsn {

/// FNV-1a over topic id, its type, QoS, retain and the payload; not over DUP and MsgId. Never 0.
std::uint64_t fingerprint(const Publish& publish);
std::uint64_t fingerprint(ByteView bytes);

class RepeatFilter {
 public:
  struct Entry {
    std::uint64_t fingerprint = 0;
    TimePoint came{};
    std::uint64_t receipt_id = 0;  ///< 0: acknowledged
    std::uint16_t topic_id = 0;
    std::uint16_t msg_id = 0;
  };

  /// The message that this one repeats, or nothing; forgets what is older than the window.
  const Entry* find(std::uint16_t msg_id, std::uint64_t fingerprint, TimePoint now);
  void add(const Entry& entry);
  /// The entry that waited for this receipt, which it does no longer.
  std::optional<Entry> on_safe(std::uint64_t receipt_id);
  /// Forgets it: its repetition is a new message.
  std::optional<Entry> on_refused(std::uint64_t receipt_id);
  void clear();
  /// Oldest first; some may be older than the window.
  std::span<const Entry> entries() const { return std::span(entries_).subspan(gone_); }

 private:
  std::size_t size() const { return entries_.size() - gone_; }
  void pop_front();
  void erase(std::size_t begin, std::size_t end);
  /// entries_.rend() when there is none.
  std::vector<Entry>::reverse_iterator find_receipt(std::uint64_t receipt_id);

  // No std::deque: an empty one has 576 octets, for each of thousands of clients.
  std::vector<Entry> entries_;          // oldest first
  std::vector<std::uint16_t> msg_ids_;  // of entries_: what is looked through for each message
  std::size_t gone_ = 0;                // at the front of both, not yet removed
};

}  // namespace slamgw::mqttsn
