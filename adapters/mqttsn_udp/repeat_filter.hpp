// SPDX-License-Identifier: Apache-2.0
// Recognises the repetition of a QoS 1 message (and of a QoS 2 message that is complete) by client,
// MsgId, topic and payload within a window, whether DUP is set or not (R76): common clients repeat
// without DUP, some count MsgIds badly, and robots send steps that must not count twice. MsgId
// alone is never enough.
#pragma once

#include <cstdint>
#include <deque>

#include "adapters/mqttsn_udp/packet.hpp"
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
  void clear() { entries_.clear(); }
  /// Oldest first; some may be older than the window.
  const std::deque<Entry>& entries() const { return entries_; }

 private:
  std::deque<Entry>::iterator find_receipt(std::uint64_t receipt_id);

  std::deque<Entry> entries_;  // oldest first
};

}  // namespace slamgw::mqttsn
