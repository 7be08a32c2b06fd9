// SPDX-License-Identifier: Apache-2.0
// The outbox's dealings with the store: when messages go there, and what its answers mean for
// receipts and order. Publishing is in outbox.cpp.
#include <fmt/format.h>

#include <algorithm>
#include <iterator>
#include <utility>

#include "daemon/delivery/outbox.hpp"

namespace slamgw {

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
  write_trouble_.clear();
  read_trouble_.clear();
  begin_anew(backlog_.on_opened(std::move(opened), now), now);
}

void Outbox::handle(StoreAbsent& absent, TimePoint now) {
  write_trouble_ = std::move(absent.why);
  read_trouble_.clear();
  begin_anew(backlog_.on_absent(now), now);
}

/// `in_memory` and what is in flight are not in this store, whatever they were in before.
void Outbox::begin_anew(Entries in_memory, TimePoint now) {
  for (Entry& entry : in_flight_) {
    if (entry.is_stored) queued_bytes_ += entry.cost();
    entry.is_stored = entry.is_from_backlog = false;
    entry.row = 0;
  }
  backlog_in_flight_ = 0;
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
  for (Entry& entry : in_flight_) {
    if (!entry.is_being_copied() || entry.row > written.up_to_row) continue;
    entry.is_stored = true;
    make_safe(entry);
  }
  end_store_trouble(write_trouble_);
}

void Outbox::make_safe(Entry& entry) {
  queued_bytes_ -= entry.cost();
  if (entry.dead_letter != 0) resending_.erase(entry.dead_letter);
  const Receipt receipt = std::exchange(entry.receipt, Receipt{});
  if (receipt.is_owed()) actions_.push(FireReceipt{receipt, ReceiptOutcome::safe});
}

void Outbox::handle(StoreWriteFailed& failed, TimePoint now) {
  Entries unsaved = backlog_.on_write_failed(now);
  for (Entry& entry : in_flight_) {
    if (entry.is_being_copied()) backlog_.abandon_copy(entry);
  }
  drop_dead_letters(unsaved);
  report_store_failure(write_trouble_, "written: " + failed.why, now);
  place_all_again(std::move(unsaved), now);
}

void Outbox::handle(StoreLoaded& loaded, TimePoint now) {
  end_store_trouble(read_trouble_);
  const std::size_t missing = backlog_.on_loaded(std::move(loaded), now);
  if (missing == 0) return;
  actions_.push(Notice{Severity::error,
                       fmt::format("{} messages that were stored are no longer in the store: "
                                   "somebody else has changed its file",
                                   missing),
                       {}});
  place_all_again({}, now);
}

void Outbox::handle(StoreLoadFailed& failed, TimePoint now) {
  backlog_.on_load_failed(now);
  report_store_failure(read_trouble_, "read: " + failed.why, now);
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
    if (!backlog_.can_keep() || !backlog_.keep(entry)) return;  // it stays a dead letter
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

void Outbox::report_store_failure(std::string& trouble, const std::string& why, TimePoint now) {
  ++statistics_.store_failures;
  trouble = "it cannot be " + why;
  if (!failure_burst_.on_event(now)) return;
  actions_.push(Notice{Severity::error,
                       fmt::format("the store cannot be {}; until it can, messages wait in memory "
                                   "and robots for the broker's acknowledgement",
                                   why),
                       {}});
}

void Outbox::end_store_trouble(std::string& trouble) {
  if (trouble.empty()) return;
  trouble.clear();
  failure_burst_ = Burst(failure_interval);  // the next failure is news
  if (store_trouble().empty()) {
    actions_.push(Notice{Severity::notice, "the store works again", {}});
  }
}

/// The oldest QoS 1 or 2 message that is neither with the broker nor with the store.
std::optional<TimePoint> Outbox::oldest_unsaved() const {
  std::optional<TimePoint> oldest;
  const auto look_at = [&](const Entry& entry) {
    if (!entry.is_unacknowledged() && entry.row == 0) oldest = earlier(oldest, entry.submitted);
  };
  std::for_each(in_flight_.begin(), in_flight_.end(), look_at);
  waiting_.for_each(look_at);
  return oldest;
}

void Outbox::check_overdue(TimePoint now) {
  overdue_check_.reset();
  // While the broker is away everything goes to the store anyway; a store that cannot keep is
  // looked at again when it can.
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
  is_stalled_ = is_stopping_ || (acknowledged_in_flight_ > 0 && now - progress_ >= broker_patience);
  for (Entry& entry : in_flight_) {
    const bool is_unsaved = !entry.is_unacknowledged() && entry.row == 0;
    if (is_unsaved && !backlog_.keep_copy(entry)) break;  // full
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

}  // namespace slamgw
