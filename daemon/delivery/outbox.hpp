// SPDX-License-Identifier: Apache-2.0
// The messages that wait for the broker, in order, and the receipts that fire when the broker or
// the disk has them. Pure: the application performs the actions. The Outbox decides which message
// is published when, and which is stored; the Backlog knows what is in the store.
//
// A message of QoS 1 or 2 goes straight to the broker while the broker is connected and quick. It
// goes to the store while the broker is away or slow, and while an older message of its topic is in
// the store. So the order per topic holds, and fresh messages of other topics pass a backlog.
// Robots take turns: a robot that floods delays only its own messages.
//
// A message has its row from the start, whether or not it is stored. In memory it is one item of
// the FairQueue until it is removed: a lost link or a failed write changes its state, not its
// place. A stored message that cannot be published now is only a row on disk.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "daemon/core/log_throttle.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/protocol_machine.hpp"
#include "daemon/delivery/backlog.hpp"
#include "daemon/delivery/delivery_notices.hpp"
#include "daemon/delivery/fair_queue.hpp"
#include "daemon/delivery/message_store.hpp"
#include "daemon/delivery/publish_window.hpp"
#include "daemon/delivery/refused_topics.hpp"

namespace slamgw {

/// The message stays in the outbox; Outbox::under_way() returns it.
struct PublishAtBroker {
  std::uint64_t sequence = 0;
  bool is_trial = false;  ///< the broker may close the connection for the message's topic
};

using OutboxAction = std::variant<PublishAtBroker, FireReceipt, WriteToStore, LoadFromStore,
                                  RetryDeadLetters, MessageStep, Notice>;

class Outbox {
 public:
  /// Limit of messages that are only in memory. Beyond it, messages with a receipt are refused and
  /// others dropped. 64 MiB hold minutes of a thousand robots and are little on a Pi. One flow
  /// (FairQueue) may hold as much as is still free: half of the limit when it is alone, else less.
  static constexpr std::size_t max_queued_bytes = 64u << 20;
  /// docs/topics.md, promise 5: QoS 0 is never queued behind an outage for longer.
  static constexpr std::chrono::seconds max_unacknowledged_age{10};
  /// A broker that has not acknowledged a message for this time is slow: messages that are only in
  /// memory go to the store, so that robots need not wait for the broker.
  static constexpr std::chrono::seconds broker_patience{2};
  /// Before a message is published alone, the outbox waits at most this long for the answers to
  /// messages under way. Then all other messages wait at most this long for its answer.
  static constexpr std::chrono::seconds trial_patience{5};
  /// A message that was skipped for this time is at fault when the connection ends: the broker has
  /// answered later ones. Less than Upstream waits before it ends such a connection.
  static constexpr std::chrono::seconds forgotten_after{30};
  /// Time given to the broker at shutdown; the remaining messages then go to the store.
  static constexpr std::chrono::seconds stop_patience{1};

  struct Statistics {
    std::uint64_t published = 0;     ///< QoS 1 and 2: acknowledged by the broker; QoS 0: written
    std::uint64_t dropped = 0;       ///< QoS 0: too old, refused, no room, link lost; own retained
    std::uint64_t refused = 0;       ///< not acknowledged: no room, or the broker refuses them
    std::uint64_t dead_letters = 0;  ///< how often a message became a dead letter
    std::uint64_t lost = 0;          ///< upper bound of stored messages that were lost to damage
  };

  /// `window`: QoS 1 and 2 messages under way at once (`broker.max_inflight`); `store_max_bytes`:
  /// `store.max_bytes`. Nothing is published before the first StoreOpened or StoreAbsent.
  Outbox(std::size_t window, std::uint64_t store_max_bytes)
      : store_max_bytes_(store_max_bytes), backlog_(store_max_bytes), window_(window) {}

  /// Takes a message over. `receipt` fires at most once: when the broker or the disk has the
  /// message, or when it is refused.
  void submit(BrokerMessage message, Receipt receipt, TimePoint now);
  /// `receive_maximum` is the broker's (MQTT 5 flow control); one slot of it stays free.
  void on_link_up(std::uint16_t receive_maximum, TimePoint now);
  /// Queues the messages under way again, in order, for the next connection; QoS 0 is dropped. A
  /// message that was under way alone becomes a dead letter, because the broker closes the
  /// connection for it; so does the first message of each topic that the broker does not answer.
  /// After the second time it is not tried again.
  void on_link_down(TimePoint now);
  /// Call when the gateway has ended a good connection: the messages under way are queued again,
  /// and none of them is at fault.
  void on_link_left(TimePoint now) { end_link(now); }
  /// Call when the broker becomes silent or answers again. QoS 0 waits during the silence.
  void on_silence(bool is_silent, TimePoint now) {
    window_.on_silence(is_silent);
    proceed(now);
  }
  void on_published(std::uint64_t sequence, TimePoint now);
  /// Call when the broker has answered with a reason code of 0x80 or above. The message becomes a
  /// dead letter. If another message of its topic may be refused as well, the topic rests for a
  /// while.
  void on_publish_refused(std::uint64_t sequence, const Refusal& refusal, TimePoint now);
  void on_store_event(StoreEvent event, TimePoint now);
  /// Prepares the daemon's shutdown. The backlog stays on disk; messages that are only in memory go
  /// to the broker or the store. The shell runs on until is_settled(), or as long as it can wait.
  void on_stop(TimePoint now);

  /// Call when an operator begins or ends to follow messages. While `is_on`, each message of a
  /// robot makes MessageSteps.
  void on_trace(bool is_on) { is_traced_ = is_on; }

  std::optional<OutboxAction> next_action() { return actions_.pop(); }
  /// Returns the message of a PublishAtBroker, valid until the next input. Returns null when the
  /// message is answered, or its connection is lost.
  const BrokerMessage* under_way(std::uint64_t sequence) {
    const Item* const item = window_.find(sequence);
    return item ? &item->message : nullptr;
  }
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);

  /// Number and size of the messages that are only in memory.
  std::size_t unsaved() const { return unsaved_; }
  std::size_t queued_bytes() const { return unsaved_bytes_; }
  /// Returns true when no message is under way to the broker or the disk, and none could be.
  bool is_settled() const;
  const Statistics& statistics() const { return statistics_; }
  const Backlog& backlog() const { return backlog_; }
  /// Topics that the broker refuses at present.
  const RefusedTopics& refused_topics() const { return refused_; }
  /// Returns the first `most` of them. Their messages that wait in memory count, too.
  std::vector<RefusedTopic> list_refused(std::size_t most) const;
  /// Returns why the store cannot be written or read; empty while it can.
  const std::string& store_trouble() const { return store_trouble_.why(); }
  /// Number of writes and reads that failed.
  std::uint64_t store_failures() const { return store_trouble_.failures(); }

 private:
  using Item = OutboxItem;
  using Turn = RefusedTopics::Turn;
  using Fate = RefusalNotices::Fate;
  using Way = StoreTrouble::Way;

  void handle(StoreOpened& opened, TimePoint now);
  void handle(StoreAbsent& absent, TimePoint now);
  void handle(StoreWritten&, TimePoint now);
  void handle(StoreWriteFailed& failed, TimePoint now);
  void handle(StoreLoaded& loaded, TimePoint now);
  void handle(StoreLoadFailed& failed, TimePoint now);
  void handle(MessagesLost& lost, TimePoint) {
    statistics_.lost += lost.count;
    actions_.push(Notice{Severity::error, std::move(lost.text), {}});
  }
  void handle(DeadLettersChanged& changed, TimePoint) {
    backlog_.on_dead_letters(changed);
    for (const FormerLetter& letter : changed.discarded) refused_.on_taken_away(letter);
  }
  void handle(DeadLettersRevived& revived, TimePoint now);
  void handle(Notice& notice, TimePoint) { actions_.push(std::move(notice)); }
  void trace(StepKind kind, const Item& item, std::string why = {});

  Item& add(BrokerMessage message, Receipt receipt, TimePoint now);
  void place(Item& item, TimePoint now);
  void remove(Item& item, TimePoint now);
  void refuse(Item& item, TimePoint now);
  void log_refusal(const Item& item, TimePoint now);
  void drop(Item& item, const char* why, TimePoint now);
  bool drop_if_too_old(Item& item, TimePoint now);
  void on_durable(Item& item);
  void leave_memory(Item& item);
  void store_all(TimePoint now, bool is_overdue = false);
  void store_if_needed(Item& item, TimePoint now, bool is_overdue = false);
  void check_ages(TimePoint now);
  void save_all(TimePoint now);
  void release_set_aside(TimePoint now);

  void proceed(TimePoint now);
  bool publish_next(TimePoint now);
  Item* next_in_turn(TimePoint now);
  bool awaits_try(const Item& item, TimePoint now) const;
  void refuse_with_its_flow(const Item& next, TimePoint now);
  bool wait_to_be_alone(const Item& next, TimePoint now);
  bool has_memory_for(const Item& item) const;
  void publish(Item& item, TimePoint now);
  void note_answer(std::uint64_t sequence);
  void end_link(TimePoint now);
  void find_cause_of_loss(TimePoint now);
  bool find_forgotten(TimePoint now);
  void on_lost_alone(Item& item, const char* why, const char* why_at_fault, TimePoint now);
  Turn turn_of(const Item& item, TimePoint now) const;
  void make_dead_letter(Item& item, const Refusal& refusal, std::uint32_t tries, TimePoint now);
  void withhold(Item& item, TimePoint now);
  static bool is_own_retained(const Item& item) {
    return !item.message.provenance && item.message.retain;
  }
  static bool is_replaced_by(const Item& older, const Item& newer);
  void drop_older_withheld(const Item& item, TimePoint now);
  void notify(std::optional<Notice> notice);

  std::uint64_t store_max_bytes_;
  bool is_up_ = false;
  bool is_stalled_ = false;  // the broker acknowledges nothing: all new messages are stored
  bool is_stopping_ = false;
  bool is_traced_ = false;
  std::uint64_t next_row_ = 1;
  std::uint64_t next_sequence_ = 1;

  Backlog backlog_;
  FairQueue queue_;
  PublishWindow window_;
  std::size_t unsaved_ = 0;  // messages that are only in memory
  std::size_t unsaved_bytes_ = 0;

  RefusedTopics refused_;
  /// A message that is sent alone. It waits until then for the answers to messages under way; then
  /// the others wait for its answer.
  struct Trial {
    std::uint64_t sequence = 0;  // 0: it is not under way yet
    TimePoint until{};
  };
  std::optional<Trial> trial_;

  std::optional<TimePoint> age_check_;  // while a message is only in memory
  std::optional<TimePoint> stop_check_;
  Statistics statistics_;
  RefusalNotices refusal_notices_;
  LogThrottle full_throttle_;  // one for each reason, so that a line counts no other's messages
  LogThrottle refused_throttle_;
  LogThrottle memory_throttle_;
  StoreTrouble store_trouble_;
  ActionQueue<OutboxAction> actions_;
};

}  // namespace slamgw
