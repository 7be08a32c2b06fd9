// SPDX-License-Identifier: Apache-2.0
// The messages that were handed to the broker and are not answered yet. Decides how many may be at
// once, and whether the backlog or a fresh message is next. Pure; part of the outbox.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <string_view>
#include <utility>

#include "daemon/core/messages.hpp"
#include "daemon/core/recycling_allocator.hpp"
#include "daemon/core/spare_buffers.hpp"
#include "daemon/delivery/message_store.hpp"

namespace slamgw {

/// One message on its way to the broker, as the outbox and the backlog hand it to each other.
struct OutboxEntry {
  /// What one message in memory costs besides topic and payload.
  static constexpr std::size_t overhead_bytes = 160;

  std::uint64_t order = 0;     ///< rises as messages are submitted; 0: read from the store
  std::uint64_t sequence = 0;  ///< of its present publication
  BrokerMessage message;
  Receipt receipt = no_receipt;
  TimePoint submitted{};
  std::uint64_t row = 0;   ///< in the store; 0: not handed to it
  bool is_stored = false;  ///< `row` is durable
  /// QoS 0 of a topic that is tried, which is published at QoS 1: else there would be no answer.
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

class PublishWindow {
 public:
  /// QoS 0 that is handed to the client and not yet written. There robots take no turns any more,
  /// so it is no more than what keeps the client busy. When it is reached, the next follow together
  /// as soon as half of it is written: each handing over wakes a thread.
  static constexpr std::size_t max_unacknowledged = 32;

  /// `size`: QoS 1 and 2 messages under way at once.
  explicit PublishWindow(std::size_t size) : size_(size) {}

  /// `receive_maximum` is the broker's; one slot is left free for MQTT 5 flow control.
  void on_link_up(std::uint16_t receive_maximum, TimePoint now);

  /// The broker is silent (UpstreamListener::on_silence), or no longer: QoS 0 waits meanwhile,
  /// where it grows too old and is dropped. A new connection ends it.
  void on_silence(bool is_silent) { is_silent_ = is_silent; }

  bool has_room_for(const OutboxEntry& entry) const;
  /// While both could go, each has half of the window.
  bool is_backlogs_turn() const;
  /// `entry.sequence` rises from call to call.
  void add(OutboxEntry entry, TimePoint now);
  /// Null, or nothing: it was handed over before a reconnect.
  const OutboxEntry* find(std::uint64_t sequence);
  std::optional<OutboxEntry> take(std::uint64_t sequence, TimePoint now);
  OutboxEntries take_all();
  /// By rising sequence. A caller that changes is_from_backlog calls forget_backlog().
  OutboxEntries& entries() { return entries_; }
  const OutboxEntries& entries() const { return entries_; }
  /// None of them is from the backlog any more.
  void forget_backlog() { from_backlog_ = 0; }

  bool empty() const { return entries_.empty(); }
  /// The broker owes an acknowledgement and has given none for `patience`.
  bool is_stalled(Duration patience, TimePoint now) const {
    return acknowledged_ > 0 && now - progress_ >= patience;
  }

 private:
  OutboxEntries::iterator position_of(std::uint64_t sequence);

  std::size_t size_;
  std::size_t effective_size_ = 0;
  OutboxEntries entries_;
  std::size_t acknowledged_ = 0;  // QoS 1 and 2
  std::size_t from_backlog_ = 0;
  std::size_t unacknowledged_ = 0;         // QoS 0
  bool is_unacknowledged_paused_ = false;  // until half of it is written
  bool is_silent_ = false;
  bool was_backlog_last_ = false;
  TimePoint progress_{};  // the last acknowledgement, or when there was nothing to acknowledge
};

}  // namespace slamgw
