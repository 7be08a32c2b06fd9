// SPDX-License-Identifier: Apache-2.0
// One message on its way to the broker, as the outbox and the backlog hand it to each other.
#pragma once

#include <cstdint>
#include <deque>
#include <utility>

#include "daemon/core/messages.hpp"
#include "daemon/core/recycling_allocator.hpp"
#include "daemon/core/spare_buffers.hpp"
#include "daemon/delivery/message_store.hpp"

namespace slamgw {

struct OutboxEntry {
  /// What one message in memory costs besides topic and payload.
  static constexpr std::size_t overhead_bytes = 160;

  std::uint64_t order = 0;     ///< rises as messages are submitted; 0: read from the store
  std::uint64_t sequence = 0;  ///< of its present publication
  BrokerMessage message;
  Receipt receipt = no_receipt;
  TimePoint submitted{};
  std::uint64_t row = 0;          ///< in the store; 0: not handed to it
  std::uint64_t dead_letter = 0;  ///< its number there until it is stored; 0: it is none
  bool is_stored = false;         ///< `row` is durable
  bool is_retry = false;          ///< of a held topic
  /// QoS 0 of a suspect (HeldTopics), which is published at QoS 1: else there would be no answer.
  bool is_probe = false;
  bool is_from_backlog = false;  ///< it takes the turns of the backlog

  /// QoS 0, also while it is under way as a probe.
  bool is_unacknowledged() const { return is_probe || message.qos == Qos::at_most_once; }
  /// Under way to the broker and to the disk at once.
  bool is_being_copied() const { return row != 0 && !is_stored; }
  std::size_t cost() const {
    return message.topic.size() + message.payload.size() + overhead_bytes;
  }
  /// It is done with: the next messages have its memory.
  void give_back_buffers() {
    SpareBuffers<std::string>::give_back(std::move(message.topic));
    SpareBuffers<Bytes>::give_back(std::move(message.payload));
  }
};

using OutboxEntries = std::deque<OutboxEntry, RecyclingAllocator<OutboxEntry>>;

inline OutboxEntry entry_from_store(StoredMessage stored, TimePoint now) {
  OutboxEntry entry;
  entry.message = std::move(stored.message);
  entry.submitted = now - stored.age;
  entry.row = stored.row;
  entry.is_stored = entry.is_from_backlog = true;
  return entry;
}

}  // namespace slamgw
