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
  if (!has_memory_for(entry) || is_kept_out(entry)) {
    refuse(entry, now);
    return;
  }
  place(std::move(entry), now);
  proceed(now);
}

/// Messages on held topics leave room for the others.
bool Outbox::is_kept_out(const Entry& entry) const {
  const HeldTopics& held = held_topics();
  if (entry.is_unacknowledged() || !held.has(entry.message.topic)) return false;
  return backlog_.can_keep() ? backlog_.is_half_full()
                             : held.unstored_bytes() > max_queued_bytes / held_share;
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
  entry.is_from_backlog = entry.is_retry = false;
  const bool is_behind = backlog_.is_ahead_of(entry.message.topic);
  if (entry.is_unacknowledged()) {
    if (held_topics().has(entry.message.topic)) {
      entry.is_probe = is_up_ && held_topics().wants_probe(entry.message.topic);
      return entry.is_probe ? backlog_.queue_behind(std::move(entry))
                            : drop(entry, "the broker refuses its topic");
    }
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
                        is_kept_out(entry), queued_bytes_, backlog_.largest_share()}));
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
  suspects_.on_link_up();
  backlog_.held().on_link_up(now);
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
  backlog_.held().on_link_down();
  place_all_again(std::move(returned), now, false, std::move(moved));
  expire_unacknowledged(now);
  proceed(now);
}

void Outbox::proceed(TimePoint now) {
  while (publish_next(now)) {
  }
  if (auto write = backlog_.next_write(now)) actions_.push(std::move(*write));
  if (is_up_) {
    if (auto load = backlog_.next_load()) actions_.push(*load);
  }
}

bool Outbox::publish_next(TimePoint now) {
  if (!is_up_ || backlog_.state() == Backlog::State::opening) return false;
  if (trial_) return false;
  const Entry* const retry = is_stopping_ ? nullptr : backlog_.next_held(now);
  if (retry && held_topics().is_next_suspect()) return publish_suspect(now);
  if (retry && in_flight_.has_room_for_retry(*retry, held_topics().is_cautious())) {
    publish(backlog_.take_next_held(), now);
    return true;
  }
  const Entry* const stored = is_stopping_ ? nullptr : backlog_.next();
  const bool is_stored_ready = stored && in_flight_.has_room_for(*stored);
  const bool is_fresh_ready = !waiting_.empty() && in_flight_.has_room_for(waiting_.front());
  if (!is_stored_ready && !is_fresh_ready) return false;
  const bool takes_stored = is_stored_ready && (!is_fresh_ready || in_flight_.is_backlogs_turn());
  if (hold_doubted(takes_stored ? *stored : waiting_.front(), now)) return true;
  publish(takes_stored ? backlog_.take_next() : waiting_.pop(), now);
  return true;
}

/// Treats a doubted topic as refused, because asking the broker would cost all robots the
/// connection.
bool Outbox::hold_doubted(const Entry& next, TimePoint now) {
  const Refusal* const reason = doubted_.reason(next.message.topic);
  if (!reason || next.is_unacknowledged() || held_topics().has(next.message.topic)) return false;
  const std::string topic = next.message.topic;
  hold(topic, *reason, now);
  return true;
}

/// Publishes a suspect's message alone: first everything under way must be answered, then the
/// others wait for this answer. Both waits are bounded.
bool Outbox::publish_suspect(TimePoint now) {
  if (!in_flight_.empty()) {
    if (!trial_waits_until_) trial_waits_until_ = now + HeldTopics::trial_patience;
    if (now < *trial_waits_until_) return false;
    trial_waits_until_.reset();
    backlog_.held().put_off_next(now);
    return true;
  }
  trial_waits_until_.reset();
  Entry entry = backlog_.take_next_held();
  if (entry.is_probe && now - entry.submitted >= max_unacknowledged_age) {
    drop(entry, "it has waited for the broker for 10 s");
    backlog_.held().on_answered(entry.message.topic, HeldTopics::Answer::neither);
    return true;
  }
  trial_ = {next_sequence_, now + HeldTopics::trial_patience};
  publish(std::move(entry), now);
  return true;
}

/// The link is lost: what may the broker have closed the connection for?
void Outbox::find_cause_of_loss(TimePoint now) {
  const std::optional<Trial> trial = std::exchange(trial_, std::nullopt);
  trial_waits_until_.reset();
  if (const auto* refused = suspects_.explanation(now)) {
    if (!refused->refusal.is_permanent()) doubted_.add(refused->topic, refused->refusal);
    return backlog_.held().on_loss_after_refusal(now);
  }
  if (trial) return on_lost_alone(*in_flight_.take(trial->sequence, now), now);
  for (const std::string& topic : suspects_.on_loss(in_flight_.entries(), now)) {
    if (backlog_.held().suspect(topic, now)) hold_back(topic, now);
  }
}

void Outbox::on_lost_alone(Entry entry, TimePoint now) {
  const std::string topic = entry.message.topic;
  const bool is_convicted = backlog_.held().on_lost_alone(topic, answers_, now);
  const std::uint32_t tries = held_topics().tries(topic);
  if (entry.is_unacknowledged()) {
    notify(refusal_notices_.on_unacknowledged(entry.message,
                                              {0, "the connection is lost when one is sent"}, now));
    return drop(entry, "the connection is lost when it is sent");
  }
  if (tries == 1)
    notify(refusal_notices_.on_held(topic, {0, "the connection is lost when they are sent"}, now));
  if (!is_convicted) return give_back(std::move(entry), now);
  set_aside(std::move(entry), {0, "the connection was lost each time when it was sent alone"},
            tries, now);
}

void Outbox::publish(Entry entry, TimePoint now) {
  entry.sequence = next_sequence_++;
  if (entry.is_probe) entry.message.qos = Qos::at_least_once;
  actions_.push(PublishAtBroker{entry.sequence, trial_.has_value()});
  backlog_.held().on_published(entry.message.topic);
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
  const auto answer = is_answer ? HeldTopics::Answer::accepted : HeldTopics::Answer::neither;
  if (is_answer) doubted_.on_accepted(entry->message.topic);
  if (backlog_.held().on_answered(entry->message.topic, answer))
    notify(refusal_notices_.on_accepted(entry->message.topic, now));
  if (held_topics().empty()) doubted_.clear();
  if (!is_answer) suspects_.on_written(sequence, std::move(entry->message.topic));
  entry->give_back_buffers();
  place_released(now);
  proceed(now);
}

void Outbox::note_answer(std::uint64_t sequence) {
  ++answers_;
  suspects_.on_answered(sequence);
  if (trial_ && trial_->sequence == sequence) trial_.reset();
}

void Outbox::on_publish_refused(std::uint64_t sequence, const Refusal& refusal, TimePoint now) {
  const Entry* const refused = in_flight_.find(sequence);
  if (!refused) return;  // from before a reconnect
  const std::string topic = refused->message.topic;
  const bool is_topics_fault = !refusal.is_permanent();
  if (is_topics_fault) save_in_flight(topic);
  Entry entry = std::move(*in_flight_.take(sequence, now));
  note_answer(sequence);
  suspects_.on_refused({topic, refusal, now});
  if (entry.is_unacknowledged()) {
    notify(refusal_notices_.on_unacknowledged(entry.message, refusal, now));
    backlog_.held().on_answered(topic, HeldTopics::Answer::neither);
    drop(entry, "the broker refuses it");
    return proceed(now);
  }
  is_stalled_ = false;
  trace(DeliveryStep::Kind::refused, entry, "the broker: " + refusal.why);
  backlog_.held().on_answered(
      topic, is_topics_fault ? HeldTopics::Answer::refused : HeldTopics::Answer::neither);
  if (is_topics_fault) hold(topic, refusal, now);
  if (!is_topics_fault) {
    set_aside(std::move(entry), refusal, 1, now);
  } else if (is_hopeless(entry, now)) {
    set_aside(std::move(entry), refusal, held_topics().tries(topic), now);
  } else {
    give_back(std::move(entry), now);
  }
  place_released(now);
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

void Outbox::hold(const std::string& topic, const Refusal& refusal, TimePoint now) {
  HeldTopics& held = backlog_.held();
  const bool is_new = !held.has(topic);
  if (held.hold(topic, refusal, in_flight_.count(topic), now))
    notify(refusal_notices_.on_held(topic, refusal, now));
  if (is_new) hold_back(topic, now);
}

/// Moves the waiting messages of a newly held topic to HeldTopics.
void Outbox::hold_back(const std::string& topic, TimePoint now) {
  for (Entry& entry : backlog_.hold_back(topic)) place(std::move(entry), now);
  for (Entry& entry : waiting_.take(topic)) place(std::move(entry), now);
}

bool Outbox::is_hopeless(const Entry& entry, TimePoint now) const {
  return now - entry.submitted >= hopeless_age &&
         held_topics().tries(entry.message.topic) >= hopeless_tries;
}

/// It was not delivered and waits again.
void Outbox::give_back(Entry entry, TimePoint now) {
  if (entry.is_stored) {
    backlog_.give_back(std::move(entry));
  } else if (entry.is_being_copied()) {
    backlog_.adopt(std::move(entry));
  } else {
    place(std::move(entry), now);
  }
}

/// Where it cannot become a dead letter, it is not acknowledged; one that was is kept.
void Outbox::set_aside(Entry entry, const Refusal& refusal, std::uint32_t tries, TimePoint now) {
  const BrokerMessage message = entry.message;
  const Receipt receipt = entry.receipt;
  if (backlog_.set_aside(entry, refusal, tries)) {
    ++statistics_.set_aside;
    notify(refusal_notices_.on_set_aside(message, refusal, now));
  } else if (entry.row == 0 && receipt.is_owed()) {
    queued_bytes_ -= entry.cost();
    ++statistics_.refused;
    actions_.push(FireReceipt{receipt, ReceiptOutcome::refused});
    notify(refusal_notices_.on_dropped(message, refusal, now));
  } else {
    if (refusal.code != 0) hold(message.topic, refusal, now);
    give_back(std::move(entry), now);
  }
}

void Outbox::place_released(TimePoint now) {
  while (auto entry = backlog_.held().take_released()) place(std::move(*entry), now);
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
  if (stop_check_ && now >= *stop_check_) {
    stop_check_.reset();
    save_all(now);
  }
  proceed(now);
}

std::optional<TimePoint> Outbox::deadline() const {
  const auto trial = trial_ ? std::optional(trial_->until) : trial_waits_until_;
  return earlier(earlier(expiry_check_, overdue_check_),
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
  start_over(backlog_.on_opened(std::move(opened), now), now);
}

void Outbox::handle(StoreAbsent& absent, TimePoint now) {
  store_trouble_.reset(std::move(absent.why));
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
  drop_dead_letters(in_memory);
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
  notify(store_trouble_.on_written());
}

void Outbox::make_safe(Entry& entry) {
  trace(DeliveryStep::Kind::stored, entry);
  queued_bytes_ -= entry.cost();
  if (entry.dead_letter != 0) resending_.erase(entry.dead_letter);
  const Receipt owed = std::exchange(entry.receipt, no_receipt);
  if (owed.is_owed()) actions_.push(FireReceipt{owed, ReceiptOutcome::safe});
}

void Outbox::handle(StoreWriteFailed& failed, TimePoint now) {
  Entries unsaved = backlog_.on_write_failed(now);
  for (Entry& entry : in_flight_.entries())
    if (entry.is_being_copied()) backlog_.abandon_copy(entry);
  drop_dead_letters(unsaved);
  notify(store_trouble_.on_write_failed(failed.why, now));
  place_all_again(std::move(unsaved), now);
}

void Outbox::handle(StoreLoaded& loaded, TimePoint now) {
  notify(store_trouble_.on_loaded());
  const std::size_t missing = backlog_.on_loaded(std::move(loaded), now);
  if (missing == 0) return;
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

void Outbox::handle(ResendDeadLetters& resend, TimePoint now) {
  for (DeadLetter& letter : resend.letters) {
    if (resending_.contains(letter.id)) continue;  // ordered twice
    Entry entry;
    entry.order = next_order_++;
    entry.dead_letter = letter.id;
    entry.message = std::move(letter.message);
    entry.submitted = now;
    const std::size_t cost = entry.cost();
    if (!backlog_.can_keep() || !backlog_.keep(entry)) continue;  // it stays a dead letter
    queued_bytes_ += cost;
    resending_.insert(letter.id);
  }
}

/// Dead letters that were to be sent again and that the store did not keep are dead letters still.
void Outbox::drop_dead_letters(Entries& unsaved) {
  std::erase_if(unsaved, [this](const Entry& entry) {
    if (entry.dead_letter == 0 || entry.is_stored) return false;
    queued_bytes_ -= entry.cost();
    resending_.erase(entry.dead_letter);
    return true;
  });
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
  std::size_t count = waiting_.size() + backlog_.behind() + backlog_.unsaved();
  for (const Entry& entry : in_flight_.entries()) count += entry.is_stored ? 0 : 1;
  return count;
}

}  // namespace slamgw
