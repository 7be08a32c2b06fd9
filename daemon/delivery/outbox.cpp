// SPDX-License-Identifier: Apache-2.0
#include "daemon/delivery/outbox.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>
#include <utility>

namespace slamgw {

void Outbox::submit(BrokerMessage message, Receipt receipt, TimePoint now) {
  Entry entry;
  entry.order = next_order_++;
  entry.message = std::move(message);
  entry.receipt = receipt;
  entry.submitted = now;
  queued_bytes_ += entry.cost();
  if (!has_memory_for(entry)) return refuse(entry, now);
  drop_older_withheld(entry);
  if (turn_of(entry, now) == RefusedTopics::Turn::rest) {
    turn_away(std::move(entry), now);
  } else {
    place(std::move(entry), now);
  }
  proceed(now);
}

/// `queued_bytes_` includes `entry`. Below half of the bound every flow fits, so the flow is not
/// looked up.
bool Outbox::has_memory_for(const Entry& entry) const {
  if (2 * queued_bytes_ <= max_queued_bytes) return true;
  const std::size_t flow_bytes = waiting_.bytes_in_flow(entry.message.topic) + entry.cost();
  return queued_bytes_ + flow_bytes <= max_queued_bytes;
}

/// Decides where a message that is only in memory waits. `is_overdue`: the broker is too slow for
/// it.
void Outbox::place(Entry entry, TimePoint now, bool is_overdue) {
  entry.is_from_backlog = false;
  const bool is_behind = backlog_.is_ahead_of(entry.message.topic);
  if (entry.is_unacknowledged()) {
    if (!expiry_check_) expiry_check_ = entry.submitted + max_unacknowledged_age;
  } else if (backlog_.can_keep() && (!is_up_ || is_stalled_ || is_behind || is_overdue)) {
    save_in_flight(entry.message.topic);
    if (backlog_.keep(entry)) return;
    const bool may_wait_for_broker = is_up_ && !is_stalled_ && !is_behind;
    if (!may_wait_for_broker) {
      refuse(entry, now);
      return;
    }
  }
  if (!entry.is_unacknowledged() && !overdue_check_) overdue_check_ = now + broker_patience;
  if (is_behind) {
    backlog_.queue_behind(std::move(entry));
  } else {
    waiting_.push(std::move(entry));
  }
}

/// Places every message that waits in memory again, in the order of submission, after the link or
/// the store has changed. QoS 0 messages that waited only for the window keep doing so, unless an
/// earlier message of their topic has just moved to the store or back to it (`moved`).
void Outbox::place_all_again(Entries returned, TimePoint now, bool is_overdue, Slots moved) {
  Entries behind = backlog_.take_behind();
  std::move(behind.begin(), behind.end(), std::back_inserter(returned));
  std::stable_sort(returned.begin(), returned.end(),
                   [](const Entry& a, const Entry& b) { return a.order < b.order; });
  Entries fresh = waiting_.take_all();
  while (!fresh.empty() || !returned.empty()) {
    const bool is_fresh =
        returned.empty() || (!fresh.empty() && fresh.front().order < returned.front().order);
    Entries& source = is_fresh ? fresh : returned;
    Entry entry = std::move(source.front());
    source.pop_front();
    const std::size_t slot = TopicCounts::slot(entry.message.topic);
    if (is_fresh && entry.is_unacknowledged() && !moved.contains(slot)) {
      waiting_.push(std::move(entry));
      continue;
    }
    const std::size_t waiting_before = waiting_.size();
    place(std::move(entry), now, is_overdue);
    if (waiting_.size() == waiting_before) moved.insert(slot);
  }
}

/// QoS 0 that is too old, or whose topic the broker does not take.
void Outbox::drop(const Entry& entry, const char* why) {
  trace(DeliveryStep::Kind::refused, entry, why);
  ++statistics_.dropped;
  queued_bytes_ -= entry.cost();
}

void Outbox::refuse(const Entry& entry, TimePoint now) {
  queued_bytes_ -= entry.cost();
  if (const auto count = full_throttle_.on_event(now))
    actions_.push(
        no_room_notice({*count, backlog_.is_full() ? backlog_.bytes() : 0, store_max_bytes_,
                        turn_of(entry, now) == RefusedTopics::Turn::rest, queued_bytes_,
                        backlog_.largest_share()}));
  if (!entry.receipt.is_owed()) {
    ++statistics_.dropped;
    return trace(DeliveryStep::Kind::refused, entry, "there is no room for it");
  }
  ++statistics_.refused;
  actions_.push(FireReceipt{entry.receipt, ReceiptOutcome::refused});
}

void Outbox::on_link_up(std::uint16_t receive_maximum, TimePoint now) {
  is_up_ = true;
  in_flight_.on_link_up(receive_maximum, now);
  loss_causes_.on_link_up();
  overdue_check_ = now + broker_patience;
  expire_unacknowledged(now);
  proceed(now);
}

void Outbox::on_link_down(TimePoint now) {
  if (!is_up_) return;
  is_up_ = is_stalled_ = false;
  find_cause_of_loss(now);
  Entries returned;
  Slots moved;
  for (Entry& entry : in_flight_.take_all()) {
    if (entry.row != 0) moved.insert(TopicCounts::slot(entry.message.topic));
    if (entry.is_unacknowledged()) {
      drop(entry, "the connection to the broker was lost");
    } else if (entry.is_stored) {
      backlog_.give_back(std::move(entry));
    } else if (entry.is_being_copied()) {
      backlog_.adopt(std::move(entry));
    } else {
      returned.push_back(std::move(entry));
    }
  }
  // QoS 0 behind the store would be sent before what waits in memory again.
  Slots unsaved;
  for (const Entry& entry : returned) unsaved.insert(TopicCounts::slot(entry.message.topic));
  backlog_.drop_behind([&](const Entry& entry) {
    const bool is_lost =
        entry.is_unacknowledged() && unsaved.contains(TopicCounts::slot(entry.message.topic));
    if (is_lost) drop(entry, "the connection to the broker was lost");
    return is_lost;
  });
  refused_.on_link_down(now);
  place_all_again(std::move(returned), now, false, std::move(moved));
  expire_unacknowledged(now);
  proceed(now);
}

void Outbox::proceed(TimePoint now) {
  if (is_up_) requeue_withheld(now);
  while (publish_next(now)) {
  }
  if (auto write = backlog_.next_write(now)) actions_.push(std::move(*write));
  if (!is_up_) return;
  if (auto load = backlog_.next_load()) actions_.push(*load);
  if (!is_stopping_) ask_for_dead_letters(now);
}

bool Outbox::publish_next(TimePoint now) {
  if (!is_up_ || backlog_.state() == Backlog::State::opening || trial_) return false;
  if (in_flight_.empty()) trial_waits_until_.reset();
  if (trial_waits_until_ && now < *trial_waits_until_) return false;
  const Entry* const stored = is_stopping_ ? nullptr : backlog_.next();
  const bool is_stored_ready = stored && in_flight_.has_room_for(*stored);
  const bool is_fresh_ready = !waiting_.empty() && in_flight_.has_room_for(waiting_.front());
  if (!is_stored_ready && !is_fresh_ready) return false;
  const bool takes_stored = is_stored_ready && (!is_fresh_ready || in_flight_.is_backlogs_turn());
  const Entry& next = takes_stored ? *stored : waiting_.front();
  refuse_with_its_flow(next, now);
  const Turn turn = turn_of(next, now);
  if (turn == Turn::alone && !in_flight_.empty()) return wait_to_be_alone(next, now);
  Entry entry = takes_stored ? backlog_.take_next() : waiting_.pop();
  if (turn == Turn::rest) {
    turn_away(std::move(entry), now);
    return true;
  }
  if (turn == Turn::alone) trial_ = {next_sequence_, now + trial_patience};
  if (turn != Turn::open && entry.is_unacknowledged()) {
    entry.is_probe = true;
    entry.message.qos = Qos::at_least_once;
  }
  publish(std::move(entry), now);
  return true;
}

/// Counts its topic as refused where asking the broker would cost all robots the connection.
void Outbox::refuse_with_its_flow(const Entry& next, TimePoint now) {
  const Refusal* const reason = refused_flows_.reason(next.message.topic);
  if (!reason || next.is_unacknowledged() || turn_of(next, now) != Turn::open) return;
  if (refused_.on_refused(next.message.topic, *reason, now))
    notify(refusal_notices_.on_refused_topic(next.message.topic, *reason, now));
}

/// Waits for the answers to everything under way, for a bounded time. After that an accused topic
/// is no longer accused, and a refused one rests. Returns true when the turn of `next` has changed.
bool Outbox::wait_to_be_alone(const Entry& next, TimePoint now) {
  if (!trial_waits_until_) trial_waits_until_ = now + trial_patience;
  if (now < *trial_waits_until_) return false;
  trial_waits_until_.reset();
  refused_.on_not_tried(next.message.topic, RefusedTopics::longest_pause, now);
  return true;
}

RefusedTopics::Turn Outbox::turn_of(const Entry& entry, TimePoint now) const {
  if (refused_.empty()) return Turn::open;
  return refused_.turn_of(entry.message.topic, entry.row, backlog_.can_keep(), now);
}

/// Makes a dead letter of a message whose topic rests.
void Outbox::turn_away(Entry entry, TimePoint now) {
  const Refusal refusal = refused_.reason(entry.message.topic);
  make_dead_letter(std::move(entry), refusal, 0, now);
}

/// Withholds the gateway's own retained messages instead: a later one of the topic replaces them.
void Outbox::make_dead_letter(Entry entry, const Refusal& refusal, std::uint32_t tries,
                              TimePoint now) {
  if (entry.is_unacknowledged()) return drop(entry, "the broker refuses its topic");
  const bool will_be_tried = is_retried(refusal.code, tries);
  const bool is_own = !entry.message.provenance;
  if (is_own && entry.message.retain && will_be_tried) return withhold(std::move(entry), now);
  const std::string topic = entry.message.topic;
  const std::size_t bytes = entry.message.payload.size();
  if (backlog_.make_dead_letter(entry, refusal, tries)) {
    ++statistics_.dead_letters;
    if (will_be_tried) return refused_.on_dead_letter(topic);
    return notify(refusal_notices_.on_dead_letter(topic, bytes, refusal, now));
  }
  if (!is_own && !entry.receipt.is_owed()) {  // it was acknowledged
    if (!will_be_tried) refused_.on_refused(topic, refusal, now);
    return withhold(std::move(entry), now);
  }
  if (!will_be_tried) notify(refusal_notices_.on_dropped(topic, bytes, refusal, now));
  refuse(entry, now);
}

void Outbox::withhold(Entry entry, TimePoint now) {
  if (entry.is_stored) queued_bytes_ += entry.cost();
  if (entry.row != 0) backlog_.forget(entry, now);
  entry.row = 0;
  entry.is_stored = false;
  const auto makes_void = [&entry](const Entry& other) {
    return !entry.message.provenance && other.message.topic == entry.message.topic &&
           other.order > entry.order;
  };
  if (std::ranges::any_of(withheld_, makes_void)) {
    queued_bytes_ -= entry.cost();
    return;
  }
  drop_older_withheld(entry);
  withheld_.push_back(std::move(entry));
}

/// A retained message of the gateway itself makes the earlier ones of its topic void.
void Outbox::drop_older_withheld(const Entry& entry) {
  if (withheld_.empty() || entry.message.provenance || !entry.message.retain) return;
  std::erase_if(withheld_, [&](const Entry& other) {
    const bool is_void = other.message.topic == entry.message.topic && !other.message.provenance;
    if (is_void) queued_bytes_ -= other.cost();
    return is_void;
  });
}

/// Requeues the withheld messages whose topics may be tried now.
void Outbox::requeue_withheld(TimePoint now) {
  if (withheld_.empty() || !refused_.is_wake_due(now)) return;
  for (Entry& entry : std::exchange(withheld_, {})) {
    if (turn_of(entry, now) == Turn::rest) {
      withheld_.push_back(std::move(entry));
    } else {
      place(std::move(entry), now);
    }
  }
}

/// Asks only when all dead letters were given to the store, which answers requests in order.
void Outbox::ask_for_dead_letters(TimePoint now) {
  const bool can_ask = backlog_.can_keep() && backlog_.has_written_dead_letters();
  while (const auto topic = refused_.next_to_ask(can_ask, now))
    actions_.push(RetryDeadLetters{backlog_.generation(), *topic, 1});
  if (!can_ask) return;
  std::erase_if(accepted_, [&](const Accepted& one) { return refused_.has(one.topic); });
  for (Accepted& one : accepted_) {
    if (one.is_asked || backlog_.is_ahead_of(one.topic)) continue;  // the last page is not sent yet
    one.is_asked = true;
    actions_.push(RetryDeadLetters{backlog_.generation(), one.topic, resend_page});
  }
}

/// The link is lost: what may the broker have closed the connection for?
void Outbox::find_cause_of_loss(TimePoint now) {
  const std::optional<Trial> trial = std::exchange(trial_, std::nullopt);
  trial_waits_until_.reset();
  if (const auto* refused = loss_causes_.explanation(now)) {
    if (!refused->refusal.is_permanent()) refused_flows_.add(refused->topic, refused->refusal);
    return refused_.on_loss_after_refusal(now);
  }
  if (trial) return on_lost_alone(*in_flight_.take(trial->sequence, now), now);
  for (const std::string& topic : loss_causes_.on_loss(in_flight_.entries(), now))
    refused_.accuse(topic, now);
}

void Outbox::on_lost_alone(Entry entry, TimePoint now) {
  const std::string& topic = entry.message.topic;
  const bool is_convicted = refused_.on_lost_alone(topic, answers_, now);
  const Refusal refusal{0, is_convicted ? "the connection was lost each time when it was sent alone"
                                        : "the connection is lost when they are sent"};
  if (entry.is_unacknowledged()) {
    notify(refusal_notices_.on_unacknowledged(entry.message, refusal, now));
    return drop(entry, "the connection is lost when it is sent");
  }
  if (refused_.tries(topic) == 1) notify(refusal_notices_.on_refused_topic(topic, refusal, now));
  make_dead_letter(std::move(entry), refusal, is_convicted ? losses_that_convict : 1, now);
}

void Outbox::publish(Entry entry, TimePoint now) {
  entry.sequence = next_sequence_++;
  actions_.push(PublishAtBroker{entry.sequence, trial_.has_value()});
  refused_.on_published(entry.message.topic);
  in_flight_.add(std::move(entry), now);
}

void Outbox::on_published(std::uint64_t sequence, TimePoint now) {
  std::optional<Entry> entry = in_flight_.take(sequence, now);
  if (!entry) return;  // from before a reconnect
  const bool is_answer = !entry->is_unacknowledged() || entry->is_probe;
  if (is_answer) note_answer(sequence);
  if (!entry->is_stored) queued_bytes_ -= entry->cost();
  if (!entry->is_unacknowledged()) is_stalled_ = false;
  ++statistics_.published;
  trace(DeliveryStep::Kind::published, *entry);
  if (entry->receipt.is_owed()) actions_.push(FireReceipt{entry->receipt, ReceiptOutcome::safe});
  if (entry->row != 0) backlog_.forget(*entry, now);
  if (is_answer) {
    on_accepted(entry->message.topic, now);
  } else {
    loss_causes_.on_written(sequence, std::move(entry->message.topic));
  }
  entry->give_back_buffers();
  proceed(now);
}

void Outbox::on_accepted(const std::string& topic, TimePoint now) {
  refused_flows_.on_accepted(topic);
  if (refused_.empty()) return;
  if (refused_.on_accepted(topic, now)) {
    notify(refusal_notices_.on_accepted(topic, now));
    if (std::ranges::find(accepted_, topic, &Accepted::topic) == accepted_.end())
      accepted_.push_back({topic});
  }
  if (refused_.empty()) refused_flows_.clear();
}

void Outbox::note_answer(std::uint64_t sequence) {
  ++answers_;
  loss_causes_.on_answered(sequence);
  if (trial_ && trial_->sequence == sequence) trial_.reset();
}

void Outbox::on_publish_refused(std::uint64_t sequence, const Refusal& refusal, TimePoint now) {
  std::optional<Entry> entry = in_flight_.take(sequence, now);
  if (!entry) return;  // from before a reconnect
  const std::string topic = entry->message.topic;
  note_answer(sequence);
  loss_causes_.on_refused({topic, refusal, now});
  const bool is_topics_fault = !refusal.is_permanent();
  if (!is_topics_fault) {
    refused_.on_not_tried(topic, {}, now);
  } else if (refused_.on_refused(topic, refusal, now) && !entry->is_unacknowledged()) {
    notify(refusal_notices_.on_refused_topic(topic, refusal, now));
  }
  if (entry->is_unacknowledged()) {
    notify(refusal_notices_.on_unacknowledged(entry->message, refusal, now));
  } else {
    is_stalled_ = false;
    trace(DeliveryStep::Kind::refused, *entry, "the broker: " + refusal.why);
  }
  make_dead_letter(std::move(*entry), refusal, is_topics_fault ? refused_.tries(topic) : 1, now);
  proceed(now);
}

/// Stores copies of the messages of `topic` that are in flight, before a later message gets its
/// row. If they have to wait again, their rows are then in the order of publishing.
void Outbox::save_in_flight(std::string_view topic) {
  if (!backlog_.can_keep()) return;
  for (Entry& entry : in_flight_.entries()) {
    const bool is_unsaved = !entry.is_unacknowledged() && entry.row == 0;
    if (is_unsaved && entry.message.topic == topic && !backlog_.keep_copy(entry)) return;
  }
}

void Outbox::notify(std::optional<Notice> notice) {
  if (notice) actions_.push(std::move(*notice));
}

void Outbox::on_deadline(TimePoint now) {
  if (expiry_check_ && now >= *expiry_check_) expire_unacknowledged(now);
  if (backlog_.on_deadline(now)) {
    overdue_check_ = now;
    place_all_again({}, now);
  }
  if (overdue_check_ && now >= *overdue_check_) check_overdue(now);
  if (trial_ && now >= trial_->until) trial_.reset();
  const bool has_waited_to_be_alone = trial_waits_until_ && now >= *trial_waits_until_;
  if (stop_check_ && now >= *stop_check_) {
    stop_check_.reset();
    save_all(now);
  }
  proceed(now);
  if (has_waited_to_be_alone) trial_waits_until_.reset();
}

std::optional<TimePoint> Outbox::deadline() const {
  const auto trial = trial_ ? std::optional(trial_->until) : trial_waits_until_;
  const auto retry = is_up_ && !is_stopping_ ? refused_.deadline() : std::nullopt;
  return earlier(earlier(earlier(expiry_check_, overdue_check_), retry),
                 earlier(earlier(stop_check_, trial), backlog_.deadline()));
}

void Outbox::expire_unacknowledged(TimePoint now) {
  std::optional<TimePoint> oldest_left;
  const auto is_too_old = [&](const Entry& entry) {
    if (!entry.is_unacknowledged()) return false;
    if (now - entry.submitted >= max_unacknowledged_age) {
      drop(entry, "it has waited for the broker for 10 s");
      return true;
    }
    oldest_left = std::min(oldest_left.value_or(entry.submitted), entry.submitted);
    return false;
  };
  waiting_.erase_if(is_too_old);
  backlog_.drop_behind(is_too_old);
  // At most one pass over the whole queue each second.
  expiry_check_.reset();
  if (oldest_left)
    expiry_check_ = std::max(*oldest_left + max_unacknowledged_age, now + std::chrono::seconds{1});
}

// The store: when messages go there, and what its answers mean for receipts and order.

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
  store_trouble_.reset();
  refused_.on_store_changed(std::exchange(opened.dead_topics, {}), now);
  start_over(backlog_.on_opened(std::move(opened), now), now);
}

void Outbox::handle(StoreAbsent& absent, TimePoint now) {
  store_trouble_.reset(std::move(absent.why));
  refused_.on_store_changed({}, now);
  start_over(backlog_.on_absent(now), now);
}

/// `in_memory` and what is in flight are not in this store, even if an earlier one had them.
void Outbox::start_over(Entries in_memory, TimePoint now) {
  for (Entry& entry : in_flight_.entries()) {
    if (entry.is_stored) queued_bytes_ += entry.cost();
    entry.is_stored = entry.is_from_backlog = false;
    entry.row = 0;
  }
  in_flight_.forget_backlog();
  accepted_.clear();
  std::ranges::move(std::exchange(withheld_, {}), std::back_inserter(in_memory));
  for (Entry& entry : in_memory) {
    if (entry.is_stored) {
      queued_bytes_ += entry.cost();
      entry.order = 0;  // older than all that waits in memory
    }
    entry.is_stored = entry.is_from_backlog = false;
    entry.row = 0;
  }
  // What waits now came after all that this store holds.
  Entries waited = waiting_.take_all();
  std::move(waited.begin(), waited.end(), std::back_inserter(in_memory));
  overdue_check_ = now;
  place_all_again(std::move(in_memory), now);
}

void Outbox::handle(StoreWritten&, TimePoint) {
  Backlog::Written written = backlog_.on_written();
  for (Entry& entry : written.entries) make_safe(entry);
  for (Entry& entry : in_flight_.entries()) {
    if (!entry.is_being_copied() || entry.row > written.up_to_row) continue;
    entry.is_stored = true;
    make_safe(entry);
  }
  for (Accepted& one : accepted_)
    if (std::exchange(one.has_failed, false)) one.is_asked = false;
  notify(store_trouble_.on_written());
}

void Outbox::make_safe(Entry& entry) {
  trace(DeliveryStep::Kind::stored, entry);
  queued_bytes_ -= entry.cost();
  const Receipt owed = std::exchange(entry.receipt, no_receipt);
  if (owed.is_owed()) actions_.push(FireReceipt{owed, ReceiptOutcome::safe});
}

void Outbox::handle(StoreWriteFailed& failed, TimePoint now) {
  Entries unsaved = backlog_.on_write_failed(now);
  for (Entry& entry : in_flight_.entries())
    if (entry.is_being_copied()) backlog_.abandon_copy(entry);
  notify(store_trouble_.on_write_failed(failed.why, now));
  place_all_again(std::move(unsaved), now);
}

void Outbox::handle(StoreLoaded& loaded, TimePoint now) {
  notify(store_trouble_.on_loaded());
  if (!loaded.damaged.empty()) refused_.on_rows_lost(now);
  const std::size_t missing = backlog_.on_loaded(std::move(loaded), now);
  if (missing == 0) return;
  refused_.on_rows_lost(now);
  actions_.push(Notice{Severity::error,
                       fmt::format("{} messages that were stored are no longer in the store: "
                                   "its file was damaged, or another program has changed it",
                                   missing),
                       {}});
  place_all_again({}, now);
}

void Outbox::handle(StoreLoadFailed& failed, TimePoint now) {
  backlog_.on_load_failed(now);
  notify(store_trouble_.on_load_failed(failed.why, now));
}

void Outbox::handle(DeadLettersRevived& revived, TimePoint now) {
  backlog_.on_revived(revived, in_flight_.entries());
  const std::string& topic = revived.retried_topic;
  if (topic.empty()) return;
  const auto accepted = std::ranges::find(accepted_, topic, &Accepted::topic);
  if (revived.has_failed) {
    refused_.on_not_tried(topic, RefusedTopics::first_pause, now);
    if (accepted != accepted_.end()) accepted->has_failed = true;
    return;
  }
  const bool is_none = revived.messages.empty();
  refused_.on_letter(topic, is_none ? 0 : revived.messages.front().row, now);
  if (accepted == accepted_.end()) return;
  accepted->is_asked = false;
  if (is_none) accepted_.erase(accepted);
}

void Outbox::trace(DeliveryStep::Kind kind, const Entry& entry, std::string why) {
  if (!is_traced_ || !entry.message.provenance) return;
  actions_.push(DeliveryStep{kind, entry.message.topic, entry.message.qos,
                             entry.message.payload.size(), entry.message.provenance->mesh,
                             entry.receipt, entry.submitted, std::move(why)});
}

/// The oldest QoS 1 or 2 message that is neither with the broker nor with the store.
std::optional<TimePoint> Outbox::oldest_unsaved() const {
  std::optional<TimePoint> oldest;
  const auto consider = [&](const Entry& entry) {
    if (!entry.is_unacknowledged() && entry.row == 0) oldest = earlier(oldest, entry.submitted);
  };
  for (const Entry& entry : in_flight_.entries()) consider(entry);
  waiting_.for_each(consider);
  return oldest;
}

void Outbox::check_overdue(TimePoint now) {
  overdue_check_.reset();
  // While the broker is away everything goes to the store anyway; a store that cannot keep is
  // checked again when it can.
  if (!is_up_ || !backlog_.can_keep()) return;
  const auto oldest = oldest_unsaved();
  if (oldest && now - *oldest < broker_patience) {
    overdue_check_ = *oldest + broker_patience;
  } else if (oldest) {
    save_all(now);
    if (oldest_unsaved()) overdue_check_ = now + broker_patience;  // the store is full
  }
}

void Outbox::save_all(TimePoint now) {
  if (!backlog_.can_keep()) return;
  is_stalled_ = is_stopping_ || in_flight_.is_stalled(broker_patience, now);
  for (Entry& entry : in_flight_.entries()) {
    const bool is_unsaved = !entry.is_unacknowledged() && entry.row == 0;
    if (is_unsaved) backlog_.keep_copy(entry);  // as far as there is room
  }
  place_all_again({}, now, true);
}

void Outbox::on_stop(TimePoint now) {
  is_stopping_ = true;
  stop_check_ = now + stop_patience;
  backlog_.on_stop();
  proceed(now);
}

bool Outbox::is_settled() const {
  if (!in_flight_.empty() || (is_up_ && !waiting_.empty())) return false;
  if (backlog_.state() == Backlog::State::opening) return waiting_.empty();
  return backlog_.is_settled() || !backlog_.can_keep();
}

std::size_t Outbox::unsaved() const {
  std::size_t count = waiting_.size() + withheld_.size() + backlog_.behind() + backlog_.unsaved();
  for (const Entry& entry : in_flight_.entries()) count += entry.is_stored ? 0 : 1;
  return count;
}

}  // namespace slamgw
