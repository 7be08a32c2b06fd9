// SPDX-License-Identifier: Apache-2.0
#include "daemon/upstream/outbox.hpp"

#include <algorithm>
#include <utility>

namespace slamgw {

std::size_t Outbox::Entry::cost() const {
  return message.topic.size() + message.payload.size() + message_overhead_bytes;
}

void Outbox::submit(BrokerMessage message, Receipt receipt, TimePoint now) {
  Entry entry{next_sequence_++, std::move(message), receipt, now};
  if (queued_bytes_ + entry.cost() > max_queued_bytes) {
    refuse(entry);
    return;
  }
  queued_bytes_ += entry.cost();
  if (!is_up_) keep(entry);
  if (!is_up_ && entry.is_unacknowledged() && !expiry_check_) {
    expiry_check_ = now + max_unacknowledged_age;
  }
  waiting_.push_back(std::move(entry));
  publish_waiting();
}

void Outbox::refuse(const Entry& entry) {
  if (!entry.receipt.is_owed()) {
    ++statistics_.dropped;
    return;
  }
  ++statistics_.refused;
  actions_.push(FireReceipt{entry.receipt, ReceiptOutcome::refused});
}

void Outbox::keep(Entry& entry) {
  if (entry.is_unacknowledged() || entry.is_kept) return;
  entry.is_kept = true;
  actions_.push(KeepInStore{entry.sequence, entry.message});
}

void Outbox::on_link_up(std::uint16_t receive_maximum, TimePoint now) {
  is_up_ = true;
  const std::size_t broker_window = receive_maximum > 1 ? receive_maximum - 1u : 1u;
  effective_window_ = std::min(window_, broker_window);
  expire_unacknowledged(now);
  publish_waiting();
}

void Outbox::on_link_down(TimePoint now) {
  is_up_ = false;
  acknowledged_in_flight_ = 0;
  unacknowledged_in_flight_ = 0;
  for (auto entry = in_flight_.rbegin(); entry != in_flight_.rend(); ++entry) {
    if (entry->is_unacknowledged()) {
      ++statistics_.dropped;
      queued_bytes_ -= entry->cost();
    } else {
      waiting_.push_front(std::move(*entry));
    }
  }
  in_flight_.clear();
  for (Entry& entry : waiting_) keep(entry);
  expire_unacknowledged(now);
}

std::size_t& Outbox::in_flight_of(const Entry& entry) {
  return entry.is_unacknowledged() ? unacknowledged_in_flight_ : acknowledged_in_flight_;
}

void Outbox::publish_waiting() {
  while (is_up_ && !waiting_.empty()) {
    Entry& first = waiting_.front();
    const std::size_t room =
        first.is_unacknowledged() ? max_unacknowledged_in_flight : effective_window_;
    if (in_flight_of(first) >= room) return;
    ++in_flight_of(first);
    actions_.push(PublishAtBroker{first.sequence, first.message});
    in_flight_.push_back(std::move(first));
    waiting_.pop_front();
  }
}

void Outbox::on_published(std::uint64_t sequence, TimePoint) {
  finish(sequence, ReceiptOutcome::safe);
}

void Outbox::on_publish_refused(std::uint64_t sequence, TimePoint) {
  finish(sequence, ReceiptOutcome::refused);
}

void Outbox::finish(std::uint64_t sequence, ReceiptOutcome outcome) {
  const auto entry = std::find_if(in_flight_.begin(), in_flight_.end(),
                                  [&](const Entry& e) { return e.sequence == sequence; });
  if (entry == in_flight_.end()) return;  // from before a reconnect
  --in_flight_of(*entry);
  queued_bytes_ -= entry->cost();
  ++(outcome == ReceiptOutcome::safe ? statistics_.published : statistics_.refused);
  if (entry->receipt.is_owed()) actions_.push(FireReceipt{entry->receipt, outcome});
  if (entry->is_kept) actions_.push(ForgetInStore{sequence});
  in_flight_.erase(entry);
  publish_waiting();
}

void Outbox::on_stored(std::uint64_t sequence) {
  for (std::deque<Entry>* queue : {&waiting_, &in_flight_}) {
    const auto entry =
        std::lower_bound(queue->begin(), queue->end(), sequence,
                         [](const Entry& e, std::uint64_t wanted) { return e.sequence < wanted; });
    if (entry == queue->end() || entry->sequence != sequence) continue;
    const Receipt receipt = std::exchange(entry->receipt, Receipt{});
    if (receipt.is_owed()) actions_.push(FireReceipt{receipt, ReceiptOutcome::safe});
  }
}

void Outbox::on_deadline(TimePoint now) {
  if (expiry_check_ && now >= *expiry_check_) expire_unacknowledged(now);
}

void Outbox::expire_unacknowledged(TimePoint now) {
  std::optional<TimePoint> oldest_left;
  std::erase_if(waiting_, [&](const Entry& entry) {
    if (!entry.is_unacknowledged()) return false;
    const bool is_too_old = now - entry.submitted >= max_unacknowledged_age;
    if (is_too_old) {
      ++statistics_.dropped;
      queued_bytes_ -= entry.cost();
    } else if (!oldest_left) {
      oldest_left = entry.submitted;
    }
    return is_too_old;
  });
  // At most one look at the whole queue each second, however closely the messages followed each
  // other.
  expiry_check_.reset();
  if (oldest_left && !is_up_) {
    expiry_check_ = std::max(*oldest_left + max_unacknowledged_age, now + std::chrono::seconds{1});
  }
}

}  // namespace slamgw
