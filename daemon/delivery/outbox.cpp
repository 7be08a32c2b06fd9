// SPDX-License-Identifier: Apache-2.0
// Publishing: where each message waits, the window, acknowledgements. The dealings with the store
// are in outbox_store.cpp.
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
  if (!has_memory_for(entry)) {
    refuse(entry, now);
    return;
  }
  place(std::move(entry), now);
  proceed(now);
}

/// `entry` counts as queued already. No flow has more than all of them together, so below the half
/// none is looked for.
bool Outbox::has_memory_for(const Entry& entry) const {
  if (2 * queued_bytes_ <= max_queued_bytes) return true;
  const std::size_t flow_bytes = waiting_.bytes_in_flow(entry.message.topic) + entry.cost();
  return queued_bytes_ + flow_bytes <= max_queued_bytes;
}

/// Decides where a message that is only in memory waits. `is_overdue`: the broker is too slow for
/// it.
void Outbox::place(Entry entry, TimePoint now, bool is_overdue) {
  const bool is_behind = backlog_.is_ahead_of(entry.message.topic);
  if (entry.is_unacknowledged()) {
    if (!expiry_check_) expiry_check_ = entry.submitted + max_unacknowledged_age;
  } else if (backlog_.can_keep() && (!is_up_ || is_stalled_ || is_behind || is_overdue)) {
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

/// The circumstances have changed: everything that waits in memory finds its place anew, in the
/// order of submission. QoS 0 that waited for nothing still does, unless something that came before
/// it on its topic has just gone to the store, or back to it (`moved`).
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

void Outbox::refuse(const Entry& entry, TimePoint now) {
  queued_bytes_ -= entry.cost();
  if (const auto count = full_burst_.on_event(now); count && backlog_.is_full()) {
    actions_.push(Notice{
        Severity::warning,
        fmt::format("the store is full ({} bytes, store.max_bytes {}): {} new messages are not "
                    "acknowledged; robots keep them",
                    backlog_.bytes(), store_max_bytes_, *count),
        {}});
  } else if (count) {
    actions_.push(Notice{Severity::warning,
                         fmt::format("{} messages refused: {} MiB wait in memory for the broker",
                                     *count, queued_bytes_ >> 20),
                         {}});
  }
  if (!entry.receipt.is_owed()) {
    ++statistics_.dropped;
    return;
  }
  ++statistics_.refused;
  actions_.push(FireReceipt{entry.receipt, ReceiptOutcome::refused});
}

void Outbox::on_link_up(std::uint16_t receive_maximum, TimePoint now) {
  is_up_ = true;
  const std::size_t broker_window = receive_maximum > 1 ? receive_maximum - 1u : 1u;
  effective_window_ = std::min(window_, broker_window);
  progress_ = now;
  overdue_check_ = now + broker_patience;
  expire_unacknowledged(now);
  proceed(now);
}

void Outbox::on_link_down(TimePoint now) {
  if (!is_up_) return;
  is_up_ = is_stalled_ = false;
  acknowledged_in_flight_ = backlog_in_flight_ = unacknowledged_in_flight_ = 0;
  is_unacknowledged_paused_ = false;
  Entries returned;
  Slots moved;
  for (Entry& entry : in_flight_) {
    if (entry.row != 0) moved.insert(TopicCounts::slot(entry.message.topic));
    if (entry.is_unacknowledged()) {
      ++statistics_.dropped;
      queued_bytes_ -= entry.cost();
    } else if (entry.is_stored) {
      backlog_.give_back(std::move(entry));
    } else if (entry.is_being_copied()) {
      backlog_.adopt(std::move(entry));
    } else {
      returned.push_back(std::move(entry));
    }
  }
  in_flight_.clear();
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
  const Entry* const stored = is_stopping_ ? nullptr : backlog_.next();
  const bool is_stored_ready = stored && has_room_for(*stored);
  const bool is_fresh_ready = !waiting_.empty() && has_room_for(waiting_.front());
  if (!is_stored_ready && !is_fresh_ready) return false;
  was_backlog_last_ = is_stored_ready && (!is_fresh_ready || is_backlogs_turn());
  if (was_backlog_last_) {
    publish(backlog_.take_next(), now);
  } else {
    publish(waiting_.pop(), now);
  }
  return true;
}

bool Outbox::has_room_for(const Entry& entry) const {
  return entry.is_unacknowledged() ? !is_unacknowledged_paused_
                                   : acknowledged_in_flight_ < effective_window_;
}

/// While both could go, each has half of the window.
bool Outbox::is_backlogs_turn() const {
  const std::size_t fresh_in_flight = acknowledged_in_flight_ - backlog_in_flight_;
  if (backlog_in_flight_ != fresh_in_flight) return backlog_in_flight_ < fresh_in_flight;
  return !was_backlog_last_;
}

void Outbox::publish(Entry entry, TimePoint now) {
  entry.sequence = next_sequence_++;
  if (entry.is_unacknowledged()) {
    is_unacknowledged_paused_ = ++unacknowledged_in_flight_ == max_unacknowledged_in_flight;
  } else if (acknowledged_in_flight_++ == 0) {
    progress_ = now;
  }
  if (entry.is_from_backlog) ++backlog_in_flight_;
  actions_.push(PublishAtBroker{entry.sequence, entry.message});
  in_flight_.push_back(std::move(entry));
}

void Outbox::on_published(std::uint64_t sequence, TimePoint now) {
  finish(sequence, ReceiptOutcome::safe, now);
}

void Outbox::on_publish_refused(std::uint64_t sequence, TimePoint now) {
  finish(sequence, ReceiptOutcome::refused, now);
}

void Outbox::finish(std::uint64_t sequence, ReceiptOutcome outcome, TimePoint now) {
  const auto entry =
      std::lower_bound(in_flight_.begin(), in_flight_.end(), sequence,
                       [](const Entry& e, std::uint64_t wanted) { return e.sequence < wanted; });
  if (entry == in_flight_.end() || entry->sequence != sequence) return;  // before a reconnect
  count_out(*entry);
  if (!entry->is_unacknowledged()) {
    progress_ = now;
    is_stalled_ = false;
  }
  ++(outcome == ReceiptOutcome::safe ? statistics_.published : statistics_.refused);
  if (entry->receipt.is_owed()) actions_.push(FireReceipt{entry->receipt, outcome});
  if (entry->row != 0) backlog_.forget(*entry, now);
  in_flight_.erase(entry);
  proceed(now);
}

void Outbox::count_out(const Entry& entry) {
  if (!entry.is_stored) queued_bytes_ -= entry.cost();
  if (entry.is_unacknowledged()) {
    if (--unacknowledged_in_flight_ <= max_unacknowledged_in_flight / 2)
      is_unacknowledged_paused_ = false;
    return;
  }
  --acknowledged_in_flight_;
  if (entry.is_from_backlog) --backlog_in_flight_;
}

void Outbox::on_deadline(TimePoint now) {
  if (expiry_check_ && now >= *expiry_check_) expire_unacknowledged(now);
  if (backlog_.on_deadline(now)) {
    overdue_check_ = now;
    place_all_again({}, now);
  }
  if (overdue_check_ && now >= *overdue_check_) check_overdue(now);
  if (stop_check_ && now >= *stop_check_) {
    stop_check_.reset();
    save_all(now);
  }
  proceed(now);
}

std::optional<TimePoint> Outbox::deadline() const {
  return earlier(earlier(expiry_check_, overdue_check_), earlier(stop_check_, backlog_.deadline()));
}

void Outbox::expire_unacknowledged(TimePoint now) {
  std::optional<TimePoint> oldest_left;
  const auto is_too_old = [&](const Entry& entry) {
    if (!entry.is_unacknowledged()) return false;
    if (now - entry.submitted >= max_unacknowledged_age) {
      ++statistics_.dropped;
      queued_bytes_ -= entry.cost();
      return true;
    }
    oldest_left = std::min(oldest_left.value_or(entry.submitted), entry.submitted);
    return false;
  };
  waiting_.erase_if(is_too_old);
  backlog_.drop_behind(is_too_old);
  // At most one look at the whole queue each second, however closely the messages followed each
  // other.
  expiry_check_.reset();
  if (oldest_left) {
    expiry_check_ = std::max(*oldest_left + max_unacknowledged_age, now + std::chrono::seconds{1});
  }
}

std::size_t Outbox::unsaved() const {
  std::size_t count = waiting_.size() + backlog_.behind() + backlog_.unsaved();
  for (const Entry& entry : in_flight_) count += entry.is_stored ? 0 : 1;
  return count;
}

std::size_t Outbox::depth() const {
  std::size_t count = waiting_.size() + backlog_.behind() + backlog_.rows();
  for (const Entry& entry : in_flight_) count += entry.row != 0 ? 0 : 1;
  return count;
}

}  // namespace slamgw
