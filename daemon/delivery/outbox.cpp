// SPDX-License-Identifier: Apache-2.0
#include "daemon/delivery/outbox.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "daemon/core/spare_buffers.hpp"

namespace slamgw {

void Outbox::submit(BrokerMessage message, Receipt receipt, TimePoint now) {
  Item& item = add(std::move(message), receipt, now);
  if (!has_memory_for(item)) return refuse(item, now);
  drop_older_withheld(item, now);
  if (turn_of(item, now) == Turn::rest) {
    make_dead_letter(item, Refusal(refused_.reason(item.message.topic)), 0, now);
  } else {
    place(item, now);
  }
  proceed(now);
}

Outbox::Item& Outbox::add(BrokerMessage message, Receipt receipt, TimePoint now) {
  Item item;
  item.row = next_row_++;
  item.message = std::move(message);
  item.receipt = receipt;
  item.submitted = now;
  ++unsaved_;
  unsaved_bytes_ += item.cost();
  return queue_.add(std::move(item));
}

/// `unsaved_bytes_` includes `item`. Below half of the limit every flow fits, so the flow is not
/// looked up.
bool Outbox::has_memory_for(const Item& item) const {
  if (2 * unsaved_bytes_ <= max_queued_bytes) return true;
  const std::size_t flow_bytes = queue_.bytes_in_flow(item.message.topic) + item.cost();
  return unsaved_bytes_ + flow_bytes <= max_queued_bytes;
}

void Outbox::place(Item& item, TimePoint now) {
  queue_.enqueue(item);
  const Duration patience =
      item.is_unacknowledged() ? Duration{max_unacknowledged_age} : Duration{broker_patience};
  age_check_ = earlier(age_check_, now + patience);
  if (!item.is_unacknowledged()) store_if_needed(item, now);
}

/// Stores the message unless it can wait for the broker. Refuses, and so removes, a message that
/// cannot wait while the store has no room. `is_overdue`: the broker is too slow for it.
void Outbox::store_if_needed(Item& item, TimePoint now, bool is_overdue) {
  if (!item.is_unsaved() || !backlog_.can_keep()) return;
  const bool may_wait_for_broker =
      item.sequence != 0 || (is_up_ && !is_stalled_ && !backlog_.is_ahead_of(item));
  if (may_wait_for_broker && !is_overdue) return;
  if (!backlog_.keep(item) && !may_wait_for_broker) refuse(item, now);
}

void Outbox::store_all(TimePoint now, bool is_overdue) {
  if (!backlog_.can_keep()) return;
  queue_.for_each([&](Item& item) {
    // A broker that answers may be slow for one robot: the others' messages do not queue behind its
    // backlog.
    const bool is_late = is_stalled_ || now - item.submitted >= broker_patience;
    store_if_needed(item, now, is_overdue && is_late);
  });
}

/// Removes the message from memory and from the disk.
void Outbox::remove(Item& item, TimePoint now) {
  backlog_.forget(item, now);
  if (!item.is_durable()) {
    --unsaved_;
    unsaved_bytes_ -= item.cost();
  }
  queue_.erase(item);
}

/// Removes a message that needs no acknowledgement, and counts it as dropped.
void Outbox::drop(Item& item, const char* why, TimePoint now) {
  trace(StepKind::refused, item, why);
  ++statistics_.dropped;
  remove(item, now);
}

/// Returns true, and drops the message, when it is of QoS 0 and has waited too long.
bool Outbox::drop_if_too_old(Item& item, TimePoint now) {
  if (!item.is_unacknowledged() || now - item.submitted < max_unacknowledged_age) return false;
  drop(item, "it has waited for the broker for 10 s", now);
  return true;
}

void Outbox::refuse(Item& item, TimePoint now) {
  log_refusal(item, now);
  if (!item.receipt.is_owed()) return drop(item, "there is no room for it", now);
  ++statistics_.refused;
  actions_.push(FireReceipt{item.receipt, ReceiptOutcome::refused});
  remove(item, now);
}

void Outbox::log_refusal(const Item& item, TimePoint now) {
  const auto warn = [this](std::string text) {
    notify(Notice{Severity::warning, std::move(text), {}});
  };
  if (backlog_.is_full()) {
    const auto count = full_throttle_.on_event(now);
    if (!count) return;
    const SlotSums::Sum largest = backlog_.largest_share();
    warn(
        fmt::format("the store is full ({} bytes, store.max_bytes {}; {} bytes of {}): {} new "
                    "messages are not acknowledged; robots keep them",
                    backlog_.taken(), store_max_bytes_, largest.value, largest.name, *count));
  } else if (turn_of(item, now) == Turn::rest) {
    if (const auto count = refused_throttle_.on_event(now))
      warn(
          fmt::format("{} new messages are not acknowledged: the broker refuses their topics, and "
                      "there is no more room for dead letters",
                      *count));
  } else if (const auto count = memory_throttle_.on_event(now)) {
    warn(fmt::format("{} messages refused: {} MiB wait in memory for the broker", *count,
                     (unsaved_bytes_ - item.cost()) >> 20));
  }
}

void Outbox::on_link_up(std::uint16_t receive_maximum, TimePoint now) {
  is_up_ = true;
  window_.on_link_up(receive_maximum, now);
  refused_.on_link_up(now);
  check_ages(now);
  proceed(now);
}

void Outbox::on_link_down(TimePoint now) {
  if (!is_up_) return;
  find_cause_of_loss(now);
  end_link(now);
}

void Outbox::end_link(TimePoint now) {
  if (!is_up_) return;
  is_up_ = is_stalled_ = false;
  trial_.reset();
  const PublishWindow::Items lost = window_.take_all();
  for (auto item = lost.rbegin(); item != lost.rend(); ++item) {
    if ((*item)->is_unacknowledged()) {
      drop(**item, "the connection to the broker was lost", now);
    } else {
      queue_.enqueue(**item, FairQueue::NewFlow::first);
    }
  }
  refused_.on_link_down(now);
  store_all(now);
  check_ages(now);
  proceed(now);
}

void Outbox::proceed(TimePoint now) {
  if (is_up_ && refused_.is_wake_due(now)) release_set_aside(now);
  while (publish_next(now)) {
  }
  if (auto write = backlog_.next_write(queue_, now)) actions_.push(std::move(*write));
  if (!is_up_) return;
  if (auto load = backlog_.next_load(queue_)) actions_.push(*load);
  while (!is_stopping_) {
    auto retry = refused_.next_to_ask(backlog_, now);
    if (!retry) break;
    actions_.push(std::move(*retry));
  }
}

bool Outbox::publish_next(TimePoint now) {
  if (!is_up_ || backlog_.state() == Backlog::State::opening) return false;
  if (trial_ && trial_->sequence == 0 && window_.empty()) trial_.reset();
  if (trial_ && (trial_->sequence != 0 || now < trial_->until)) return false;
  Item* const next = next_in_turn(now);
  if (!next) return false;
  if (drop_if_too_old(*next, now)) return true;
  if (backlog_.is_ahead_of(*next)) {
    queue_.set_aside(*next);
    store_if_needed(*next, now);
    return true;
  }
  if (!window_.has_room_for(*next)) return false;
  refuse_with_its_flow(*next, now);
  const Turn turn = turn_of(*next, now);
  if (turn == Turn::alone && !window_.empty()) return wait_to_be_alone(*next, now);
  queue_.take_front();
  if (turn == Turn::rest) {
    make_dead_letter(*next, Refusal(refused_.reason(next->message.topic)), 0, now);
    return true;
  }
  next->is_trial = turn == Turn::alone;
  if (next->is_trial) trial_ = {next_sequence_, now + trial_patience};
  if (turn != Turn::open && next->is_unacknowledged()) {
    next->is_probe = true;
    next->message.qos = Qos::at_least_once;
  }
  publish(*next, now);
  return true;
}

/// Returns the item whose turn it is. Passes over flows that have their share of the window, and
/// flows whose first message would overtake one that is under way, or waits for the answer to one.
/// There are few of them, because the window is small.
Outbox::Item* Outbox::next_in_turn(TimePoint now) {
  for (std::size_t passed = 0; passed < queue_.flows(); ++passed, queue_.pass_turn()) {
    Item* const next = queue_.front();
    if (window_.has_share_for(*next) && !window_.would_be_overtaken_by(*next) &&
        !awaits_try(*next, now))
      return next;
  }
  return nullptr;
}

/// Returns true for a former dead letter while its topic is tried. If the broker takes the try, the
/// letters follow in their order.
bool Outbox::awaits_try(const Item& item, TimePoint now) const {
  if (!item.is_durable() || turn_of(item, now) != Turn::rest) return false;
  const std::string& topic = item.message.topic;
  const auto is_of_topic = [&](const Item* other) { return other->message.topic == topic; };
  return refused_.is_asked_for(topic) || std::ranges::any_of(window_.items(), is_of_topic);
}

/// Queues messages set aside that no longer wait for an earlier message, or for their topic.
void Outbox::release_set_aside(TimePoint now) {
  queue_.for_each_aside([&](Item& item) {
    if (!backlog_.is_ahead_of(item) && turn_of(item, now) != Turn::rest) queue_.enqueue(item);
  });
}

/// Counts the topic of `next` as refused, if a try is likely to cost all robots the connection.
void Outbox::refuse_with_its_flow(const Item& next, TimePoint now) {
  const Refusal* const reason = refused_.refusal_of_flow(next.message.topic);
  if (!reason || next.is_unacknowledged() || turn_of(next, now) != Turn::open) return;
  if (refused_.refuse(next.message.topic, *reason, now))
    notify(refusal_notices_.on_refused_topic(next.message.topic, *reason));
}

/// Waits for the answers to everything under way, for a bounded time. After that an accused topic
/// is no longer accused, and a refused one rests. Returns true when the turn of `next` has changed.
bool Outbox::wait_to_be_alone(const Item& next, TimePoint now) {
  if (!trial_) trial_ = {0, now + trial_patience};
  if (now < trial_->until) return false;
  trial_.reset();
  refused_.on_not_tried(next.message.topic, RefusedTopics::longest_pause, now);
  return true;
}

RefusedTopics::Turn Outbox::turn_of(const Item& item, TimePoint now) const {
  if (refused_.empty()) return Turn::open;
  return refused_.turn_of(item.message.topic, item.row, backlog_.can_keep(), now);
}

/// Makes a dead letter of a message, or else refuses, drops or withholds it.
void Outbox::make_dead_letter(Item& item, const Refusal& refusal, std::uint32_t tries,
                              TimePoint now) {
  if (item.is_unacknowledged()) return drop(item, "the broker refuses its topic", now);
  const bool will_be_tried = is_retried(refusal.code, tries);
  if (is_own_retained(item) && will_be_tried) return withhold(item, now);
  const std::string topic = item.message.topic;
  const std::size_t bytes = item.message.payload.size();
  if (is_own_retained(item)) {  // sent again later, it would replace a newer one
    notify(RefusalNotices::on_undelivered(Fate::own_retained, topic, bytes, refusal));
    return drop(item, "the broker refuses it", now);
  }
  if (backlog_.bury(item, refusal, tries, now)) {
    item.is_dead = true;
    item.is_durable() ? queue_.erase(item) : queue_.withdraw(item);
    ++statistics_.dead_letters;
    if (will_be_tried) return refused_.on_dead_letter(topic);
    return notify(RefusalNotices::on_undelivered(Fate::dead_letter, topic, bytes, refusal));
  }
  if (item.message.provenance && !item.receipt.is_owed()) {  // a will: its robot may be gone
    if (!will_be_tried) refused_.refuse(topic, refusal, now);
    return withhold(item, now);
  }
  if (!will_be_tried)
    notify(RefusalNotices::on_undelivered(Fate::not_acknowledged, topic, bytes, refusal));
  refuse(item, now);
}

/// Keeps a message in memory until its topic is accepted: a will for which the store has no room,
/// or the newest of the gateway's own retained messages of the topic.
void Outbox::withhold(Item& item, TimePoint now) {
  const auto makes_void = [&](const auto& known) { return is_replaced_by(item, known.second); };
  if (std::ranges::any_of(queue_.items(), makes_void)) return remove(item, now);
  drop_older_withheld(item, now);
  queue_.set_aside(item);
}

/// Returns true for two retained messages of the gateway itself on one topic: the newer replaces
/// the older.
bool Outbox::is_replaced_by(const Item& older, const Item& newer) {
  return older.row < newer.row && is_own_retained(older) && is_own_retained(newer) &&
         older.message.topic == newer.message.topic;
}

void Outbox::drop_older_withheld(const Item& item, TimePoint now) {
  if (!is_own_retained(item)) return;
  queue_.for_each_aside([&](Item& other) {
    if (is_replaced_by(other, item)) remove(other, now);
  });
}

std::vector<RefusedTopic> Outbox::list_refused(std::size_t most) const {
  std::vector<RefusedTopic> listed = refused_.list(most);
  if (listed.empty()) return listed;
  for (const Item* item : queue_.aside()) {
    const auto its = std::ranges::find(listed, item->message.topic, &RefusedTopic::topic);
    if (its != listed.end()) ++its->waiting;
  }
  return listed;
}

/// Finds the message or the topics for which the broker may have closed the connection.
void Outbox::find_cause_of_loss(TimePoint now) {
  if (refused_.on_loss_after_refusal(now)) return;
  if (trial_ && trial_->sequence != 0)
    return on_lost_alone(*window_.take(trial_->sequence, now),
                         "the connection is lost when messages of this topic are sent",
                         "the connection was lost each time the message was sent alone", now);
  if (!find_forgotten(now)) refused_.on_loss(window_.items(), now);
}

/// Finds each topic that the broker does not answer. Returns false when there is none.
bool Outbox::find_forgotten(TimePoint now) {
  std::set<std::string> found;
  for (Item* const item : PublishWindow::Items(window_.items())) {
    if (!window_.is_forgotten(*item, forgotten_after, now)) continue;
    if (!found.insert(item->message.topic).second) continue;
    on_lost_alone(*window_.take(item->sequence, now),
                  "the broker does not answer messages of this topic",
                  "the broker did not answer the message each time it was sent", now);
  }
  return !found.empty();
}

/// `why_at_fault`: when the message itself is at fault, not its topic alone.
void Outbox::on_lost_alone(Item& item, const char* why, const char* why_at_fault, TimePoint now) {
  const std::string topic = item.message.topic;
  const bool is_at_fault = refused_.on_lost_alone(topic, {0, why}, now);
  const Refusal refusal{0, is_at_fault ? why_at_fault : why};
  if (item.is_unacknowledged()) {
    notify(refusal_notices_.on_unacknowledged(item.message, refusal));
    return drop(item, "the connection is lost when it is sent", now);
  }
  if (refused_.tries(topic) == 1) notify(refusal_notices_.on_refused_topic(topic, refusal));
  make_dead_letter(item, refusal, is_at_fault ? losses_at_fault : 1, now);
}

void Outbox::publish(Item& item, TimePoint now) {
  drop_older_withheld(item, now);
  item.sequence = next_sequence_++;
  actions_.push(PublishAtBroker{item.sequence, item.is_trial});
  refused_.on_published(item.message.topic);
  window_.add(item, now);
}

void Outbox::on_published(std::uint64_t sequence, TimePoint now) {
  window_.on_answered(sequence);
  Item* const item = window_.take(sequence, now);
  if (!item) return;  // an answer from before a reconnect
  if (!item->is_unacknowledged()) is_stalled_ = false;
  ++statistics_.published;
  trace(StepKind::published, *item);
  if (item->receipt.is_owed()) actions_.push(FireReceipt{item->receipt, ReceiptOutcome::safe});
  if (!item->is_unacknowledged() || item->is_probe) {
    note_answer(sequence);
    if (refused_.on_accepted(item->message.topic, now))
      notify(refusal_notices_.on_accepted(item->message.topic));
  } else {
    refused_.on_written(sequence, SpareBuffers<std::string>::copy(item->message.topic));
  }
  remove(*item, now);
  proceed(now);
}

void Outbox::note_answer(std::uint64_t sequence) {
  refused_.on_answered(sequence);
  if (trial_ && trial_->sequence == sequence) trial_.reset();
}

void Outbox::on_publish_refused(std::uint64_t sequence, const Refusal& refusal, TimePoint now) {
  // A message that can never be sent may have been refused by this host's client, not the broker.
  if (!refusal.is_permanent()) window_.on_answered(sequence);
  Item* const item = window_.take(sequence, now);
  if (!item) return;  // an answer from before a reconnect
  const std::string topic = item->message.topic;
  note_answer(sequence);
  const bool is_news = refused_.on_refused(topic, refusal, now);
  if (is_news && !item->is_unacknowledged())
    notify(refusal_notices_.on_refused_topic(topic, refusal));
  if (item->is_unacknowledged()) {
    notify(refusal_notices_.on_unacknowledged(item->message, refusal));
  } else {
    is_stalled_ = false;
    trace(StepKind::refused, *item, "the broker: " + refusal.why);
  }
  make_dead_letter(*item, refusal, refusal.is_permanent() ? 1 : refused_.tries(topic), now);
  proceed(now);
}

void Outbox::notify(std::optional<Notice> notice) {
  if (notice) actions_.push(std::move(*notice));
}

void Outbox::on_deadline(TimePoint now) {
  if (backlog_.on_deadline(now)) {
    age_check_ = now;
    store_all(now);
  }
  if (age_check_ && now >= *age_check_) check_ages(now);
  if (trial_ && trial_->sequence != 0 && now >= trial_->until) trial_.reset();
  if (stop_check_ && now >= *stop_check_) {
    stop_check_.reset();
    save_all(now);
  }
  proceed(now);
  if (trial_ && now >= trial_->until) trial_.reset();
}

std::optional<TimePoint> Outbox::deadline() const {
  const auto trial = trial_ ? std::optional(trial_->until) : std::nullopt;
  const auto retry = is_up_ && !is_stopping_ ? refused_.deadline() : std::nullopt;
  return earlier(earlier(age_check_, retry),
                 earlier(earlier(stop_check_, trial), backlog_.deadline()));
}

// The store: when messages are stored, and what the store's answers mean for receipts and order.

void Outbox::on_store_event(StoreEvent event, TimePoint now) {
  std::visit([&](auto& what) { handle(what, now); }, event);
  proceed(now);
}

void Outbox::handle(StoreOpened& opened, TimePoint now) {
  if (opened.count > 0) {
    const auto age = std::chrono::duration_cast<std::chrono::seconds>(opened.oldest_age);
    actions_.push(Notice{Severity::notice,
                         fmt::format("{} undelivered messages are in the store, the oldest {} s "
                                     "old",
                                     opened.count, age.count()),
                         {}});
  }
  store_trouble_.on_opened({});
  refused_.on_store_opened(std::exchange(opened.dead_topics, {}), now);
  // The messages in memory come after those of the store.
  queue_.renumber(opened.last_row);
  next_row_ += opened.last_row;
  StoreWriteFailed read_only{std::move(opened.why_read_only)};
  backlog_.on_opened(std::move(opened), now);
  if (!read_only.why.empty()) handle(read_only, now);
  age_check_ = now;
  store_all(now);
}

void Outbox::handle(StoreAbsent& absent, TimePoint) {
  store_trouble_.on_opened(std::move(absent.why));
  backlog_.on_absent();
}

void Outbox::handle(StoreWritten&, TimePoint now) {
  for (const std::uint64_t row : backlog_.on_written(now))
    if (Item* const item = queue_.find(row)) on_durable(*item);
  if (backlog_.can_keep()) notify(store_trouble_.on_worked(Way::write));  // else it has only erased
}

/// Fires the receipt. The message stays in memory only while it is under way.
void Outbox::on_durable(Item& item) {
  trace(StepKind::stored, item);
  const Receipt owed = std::exchange(item.receipt, no_receipt);
  if (owed.is_owed()) actions_.push(FireReceipt{owed, ReceiptOutcome::safe});
  queue_.withdraw(item);
  --unsaved_;
  unsaved_bytes_ -= item.cost();
  item.disk = Item::Disk::durable;
  if (item.sequence == 0) leave_memory(item);
}

void Outbox::leave_memory(Item& item) {
  if (item.is_dead) {
    backlog_.release(item);
  } else {
    backlog_.on_left_memory(item.row, item.message.topic);
  }
  queue_.erase(item);
}

void Outbox::handle(StoreWriteFailed& failed, TimePoint now) {
  backlog_.on_write_failed(queue_, now);
  refused_.on_write_failed();
  notify(store_trouble_.on_failed(Way::write, failed.why, now));
}

void Outbox::handle(StoreLoaded& loaded, TimePoint now) {
  notify(store_trouble_.on_worked(Way::read));
  if (is_stopping_) return;
  backlog_.on_loaded(loaded, queue_, now);
  for (StoredMessage& stored : loaded.messages) {
    Item item;
    item.row = stored.row;
    item.message = std::move(stored.message);
    item.submitted = now - stored.age;
    item.disk = Item::Disk::durable;
    queue_.enqueue(queue_.add(std::move(item)));
  }
  release_set_aside(now);
  if (!loaded.damaged.empty()) refused_.on_rows_lost(now);
  refused_.on_page_read(now);
}

void Outbox::handle(StoreLoadFailed& failed, TimePoint now) {
  backlog_.on_load_failed(now);
  notify(store_trouble_.on_failed(Way::read, failed.why, now));
}

void Outbox::handle(DeadLettersRevived& revived, TimePoint now) {
  backlog_.on_revived(revived);
  if (!revived.why_failed.empty()) {
    notify(store_trouble_.on_failed(Way::write, revived.why_failed, now));
  } else if (backlog_.can_keep()) {  // else a failed write is tried again
    notify(store_trouble_.on_worked(Way::write));
  }
  if (!revived.retried_topic.empty()) return refused_.on_revived(revived, now);
  for (const FormerLetter& message : revived.messages) refused_.on_resent(message, now);
}

void Outbox::trace(StepKind kind, const Item& item, std::string why) {
  if (!is_traced_ || !item.message.provenance) return;
  actions_.push(MessageStep{.kind = kind,
                            .mesh = item.message.provenance->mesh,
                            .topic = item.message.topic,
                            .qos = item.message.qos,
                            .bytes = item.message.payload.size(),
                            .receipt = item.receipt,
                            .why = std::move(why),
                            .since = item.submitted});
}

/// Drops QoS 0 that has waited too long. Stores unsaved messages for which the broker is too slow,
/// or all of them when it acknowledges none; while the broker is away, they are stored anyway. A
/// store that cannot keep messages is checked again once it can. Visits the whole queue once a
/// second at most.
void Outbox::check_ages(TimePoint now) {
  const bool can_save = is_up_ && backlog_.can_keep();
  bool is_overdue = false;
  std::optional<TimePoint> next;
  queue_.for_each([&](Item& item) {
    if (item.is_unacknowledged() && item.sequence == 0) {
      if (drop_if_too_old(item, now)) return;
      next = earlier(next, item.submitted + max_unacknowledged_age);
    } else if (item.is_unsaved() && can_save) {
      is_overdue = is_overdue || now - item.submitted >= broker_patience;
      next = earlier(next, std::max(item.submitted, now - broker_patience) + broker_patience);
    }
  });
  if (is_overdue) save_all(now);
  age_check_.reset();
  if (next) age_check_ = std::max(*next, now + std::chrono::seconds{1});
}

void Outbox::save_all(TimePoint now) {
  if (!backlog_.can_keep()) return;
  is_stalled_ = is_stopping_ || window_.is_stalled(broker_patience, now);
  store_all(now, true);
}

void Outbox::on_stop(TimePoint now) {
  is_stopping_ = true;
  stop_check_ = now + stop_patience;
  backlog_.on_stop();
  queue_.for_each([&](Item& item) {
    if (item.is_durable() && item.sequence == 0) leave_memory(item);
  });
  proceed(now);
}

bool Outbox::is_settled() const {
  if (!window_.empty() || (is_up_ && queue_.front())) return false;
  if (backlog_.state() == Backlog::State::opening) return !queue_.front();
  return backlog_.is_settled() || !backlog_.can_keep();
}

}  // namespace slamgw
