// SPDX-License-Identifier: Apache-2.0
#include "daemon/delivery/backlog.hpp"

#include <algorithm>
#include <cassert>
#include <iterator>
#include <utility>

namespace slamgw {
namespace {

std::uint64_t cost_of(const OutboxEntry& entry) {
  return stored_cost(entry.message.topic.size(), entry.message.payload.size());
}

}  // namespace

bool Backlog::reserve(OutboxEntry& entry) {
  const std::uint64_t cost = cost_of(entry);
  note_room();
  if (!has_room_for(entry.message.topic, cost)) return false;
  bytes_ += cost;
  shares_.add(entry.message.topic, cost);
  if (rows_++ == 0) oldest_ = entry.submitted;
  entry.row = ++last_row_;
  return true;
}

bool Backlog::has_room_for(std::string_view topic, std::uint64_t cost) {
  // A full store stays closed until a sixteenth of it is free. Otherwise small messages would
  // enter ahead of a large one that was refused.
  if (is_full_ || cost > max_bytes_ || taken() > max_bytes_ - cost) {
    is_full_ = true;
    return false;
  }
  // Whatever the size of the message: small ones of a robot do not pass its large ones.
  if (is_nearly_full() && shares_.bytes_of(topic) >= 2 * free()) {
    is_share_full_ = true;
    return false;
  }
  return true;
}

void Backlog::release(const OutboxEntry& entry) {
  // Bounded: what damage has taken from the store was not counted by the octet.
  bytes_ -= std::min(bytes_, cost_of(entry));
  rows_ -= rows_ > 0 ? 1 : 0;
  shares_.remove(entry.message.topic, cost_of(entry));
  if (rows_ == 0) shares_ = {};
  note_room();
}

void Backlog::note_room() {
  if (free() >= max_bytes_ / 16) is_full_ = false;
  if (!is_nearly_full()) is_share_full_ = false;
}

bool Backlog::keep(OutboxEntry& entry) {
  if (!reserve(entry)) return false;
  topics_.add(entry.message.topic);
  saving_.push_back({std::move(entry), Purpose::keep});
  return true;
}

bool Backlog::keep_copy(OutboxEntry& in_flight) {
  if (!reserve(in_flight)) return false;
  ahead_.insert(in_flight.row);
  saving_.push_back({in_flight, Purpose::copy});
  return true;
}

std::deque<Backlog::Saving>::iterator Backlog::find(std::deque<Saving>& queue, std::uint64_t row) {
  const auto found = std::lower_bound(
      queue.begin(), queue.end(), row,
      [](const Saving& saving, std::uint64_t wanted) { return saving.entry.row < wanted; });
  return found != queue.end() && found->entry.row == row ? found : queue.end();
}

Backlog::Saving* Backlog::find_saving(std::uint64_t row) {
  for (std::deque<Saving>* queue : {&writing_, &saving_}) {
    if (const auto found = find(*queue, row); found != queue->end()) return &*found;
  }
  return nullptr;
}

void Backlog::adopt(OutboxEntry being_copied) {
  Saving* const copy = find_saving(being_copied.row);
  assert(copy);
  ahead_.erase(being_copied.row);
  topics_.add(being_copied.message.topic);
  *copy = {std::move(being_copied), Purpose::keep};
}

void Backlog::insert_ready(OutboxEntry entry) {
  const auto after =
      std::upper_bound(ready_.begin(), ready_.end(), entry.row,
                       [](std::uint64_t row, const OutboxEntry& other) { return row < other.row; });
  ready_.insert(after, std::move(entry));
}

void Backlog::give_back(OutboxEntry stored) {
  topics_.add(stored.message.topic);
  stored.is_from_backlog = true;
  insert_ready(std::move(stored));
}

void Backlog::abandon_copy(OutboxEntry& in_flight) {
  release(in_flight);
  ahead_.erase(in_flight.row);
  in_flight.row = 0;
}

void Backlog::forget(const OutboxEntry& entry, TimePoint now) {
  release(entry);
  if (const auto unwritten = find(saving_, entry.row); unwritten != saving_.end()) {
    ahead_.erase(entry.row);
    saving_.erase(unwritten);
    return;
  }
  forgets_.push_back(entry.row);
  if (!forget_due_) forget_due_ = now + forget_delay;
}

bool Backlog::make_dead_letter(OutboxEntry& entry, const Refusal& refusal, std::uint32_t tries) {
  const std::uint64_t cost = cost_of(entry);
  if (entry.row == 0) {
    const bool has_room = dead_letters_.bytes + cost <= max_bytes_ / dead_letter_share;
    if (!can_keep() || !has_room || !reserve(entry)) return false;
  }
  new_dead_letters_.push_back({entry.row, refusal.why, refusal.code, tries});
  dead_letters_.bytes += cost;  // the store counts exactly, but later
  ++dead_letters_.count;
  if (entry.is_stored) {
    release(entry);
  } else if (Saving* const copy = find_saving(entry.row)) {
    *copy = {std::move(entry), Purpose::dead_letter};
  } else {
    saving_.push_back({std::move(entry), Purpose::dead_letter});
  }
  return true;
}

void Backlog::queue_behind(OutboxEntry entry) {
  topics_.add(entry.message.topic);
  behind_.push_back({std::move(entry), last_row_});
}

OutboxEntries Backlog::take_behind() {
  return take_behind_from(std::ranges::find_if(
      behind_, [](const Behind& waiting) { return !waiting.entry.is_unacknowledged(); }));
}

OutboxEntries Backlog::take_behind_from(std::deque<Behind>::iterator first) {
  OutboxEntries taken;
  for (auto behind = first; behind != behind_.end(); ++behind) {
    topics_.remove(behind->entry.message.topic);
    taken.push_back(std::move(behind->entry));
  }
  behind_.erase(first, behind_.end());
  return taken;
}

bool Backlog::is_behinds_turn() const {
  if (behind_.empty()) return false;
  const std::uint64_t after = behind_.front().after_row;
  const auto is_passed = [after](const std::deque<Saving>& queue) {
    return queue.empty() || queue.front().entry.row > after;
  };
  if (!is_passed(writing_) || !is_passed(saving_)) return false;
  if (!ready_.empty()) return ready_.front().row > after;
  return unloaded_ == 0 || cursor_ >= after;
}

const OutboxEntry* Backlog::next() const {
  if (is_behinds_turn()) return &behind_.front().entry;
  return ready_.empty() ? nullptr : &ready_.front();
}

OutboxEntry Backlog::take_next() {
  OutboxEntry next;
  if (is_behinds_turn()) {
    next = std::move(behind_.front().entry);
    behind_.pop_front();
    next.is_from_backlog = true;
  } else {
    next = std::move(ready_.front());
    ready_.pop_front();
  }
  topics_.remove(next.message.topic);
  return next;
}

OutboxEntries Backlog::on_opened(StoreOpened opened, TimePoint now) {
  OutboxEntries in_memory = std::exchange(ready_, {});
  for (std::deque<Saving>* queue : {&writing_, &saving_}) {
    for (Saving& saving : *queue) {
      if (!saving.is_copy()) in_memory.push_back(std::move(saving.entry));
    }
    queue->clear();
  }
  for (Behind& behind : behind_) in_memory.push_back(std::move(behind.entry));
  behind_.clear();
  state_ = State::working;
  ++generation_;
  bytes_ = opened.bytes;
  rows_ = opened.count;
  oldest_ = now - opened.oldest_age;
  last_row_ = opened.last_row;
  topics_ = std::move(opened.topics);
  shares_ = std::move(opened.shares);
  cursor_ = 0;
  unloaded_ = opened.count;
  ahead_.clear();
  forgets_.clear();
  forgetting_.clear();
  new_dead_letters_.clear();
  writing_dead_letters_.clear();
  dead_letters_ = opened.dead_letters;
  forget_due_.reset();
  is_writing_ = is_loading_ = is_load_void_ = is_probe_due_ = is_topic_count_wrong_ = false;
  write_retry_.reset();
  load_retry_.reset();
  retry_wait_ = first_retry;
  return in_memory;
}

OutboxEntries Backlog::on_absent(TimePoint now) {
  OutboxEntries in_memory = on_opened({}, now);
  state_ = State::absent;
  return in_memory;
}

std::optional<WriteToStore> Backlog::next_write(TimePoint now) {
  if (state_ != State::working || is_writing_) return std::nullopt;
  const bool is_forget_due = forgets_.size() >= forget_batch ||
                             (!forgets_.empty() && is_stopping_) ||
                             (forget_due_ && now >= *forget_due_);
  if (saving_.empty() && new_dead_letters_.empty() && !is_forget_due && !is_probe_due_)
    return std::nullopt;
  is_probe_due_ = false;
  WriteToStore write;
  write.generation = generation_;
  std::size_t bytes = 0;
  while (!saving_.empty() && write.keep.size() < write_messages && bytes < write_bytes) {
    const OutboxEntry& entry = saving_.front().entry;
    bytes += entry.cost();
    write.keep.push_back({entry.row, entry.message, {}});
    writing_.push_back(std::move(saving_.front()));
    saving_.pop_front();
  }
  take_dead_letters(write);
  forgetting_ = std::exchange(forgets_, {});
  write.forget = forgetting_;
  forget_due_.reset();
  is_writing_ = true;
  return write;
}

/// Those whose message is on disk with this write at the latest.
void Backlog::take_dead_letters(WriteToStore& write) {
  const auto is_due = [this](const NewDeadLetter& letter) {
    return saving_.empty() || letter.row < saving_.front().entry.row;
  };
  const auto later =
      std::stable_partition(new_dead_letters_.begin(), new_dead_letters_.end(), is_due);
  writing_dead_letters_.assign(new_dead_letters_.begin(), later);
  new_dead_letters_.erase(new_dead_letters_.begin(), later);
  write.dead_letters = writing_dead_letters_;
}

Backlog::Written Backlog::on_written() {
  Written written;
  if (!writing_.empty()) written.up_to_row = writing_.back().entry.row;
  stored_total_ += writing_.size();
  for (Saving& saving : writing_) {
    if (saving.is_copy()) continue;
    if (saving.purpose == Purpose::keep) {
      ++unloaded_;
    } else {
      release(saving.entry);
    }
    written.entries.push_back(std::move(saving.entry));
  }
  writing_.clear();
  forgetting_.clear();
  writing_dead_letters_.clear();
  is_writing_ = false;
  retry_wait_ = first_retry;
  return written;
}

OutboxEntries Backlog::on_write_failed(TimePoint now) {
  // Requeues entries that wait for rows that will never be written.
  std::deque<Saving>& first_queue = writing_.empty() ? saving_ : writing_;
  const std::uint64_t first_row =
      first_queue.empty() ? last_row_ + 1 : first_queue.front().entry.row;
  OutboxEntries unsaved = take_behind_from(
      std::lower_bound(behind_.begin(), behind_.end(), first_row,
                       [](const Behind& b, std::uint64_t row) { return b.after_row < row; }));
  for (std::deque<Saving>* queue : {&writing_, &saving_}) {
    for (Saving& saving : *queue) {
      if (saving.is_copy()) continue;  // the outbox abandons it where it is in flight
      release(saving.entry);
      if (saving.purpose == Purpose::keep) topics_.remove(saving.entry.message.topic);
      saving.entry.row = 0;
      unsaved.push_back(std::move(saving.entry));
    }
    queue->clear();
  }
  forgets_.insert(forgets_.begin(), forgetting_.begin(), forgetting_.end());
  forgetting_.clear();
  new_dead_letters_.insert(new_dead_letters_.begin(), writing_dead_letters_.begin(),
                           writing_dead_letters_.end());
  writing_dead_letters_.clear();
  std::erase_if(new_dead_letters_,
                [&](const NewDeadLetter& letter) { return letter.row >= first_row; });
  if (!forgets_.empty()) forget_due_ = now;
  is_writing_ = false;
  state_ = State::failing;
  write_retry_ = now + retry_wait_;
  retry_wait_ = std::min(2 * retry_wait_, longest_retry);
  return unsaved;
}

std::optional<LoadFromStore> Backlog::next_load() {
  const bool is_open = state_ == State::working || state_ == State::failing;
  if (!is_open || is_loading_ || load_retry_ || is_stopping_) return std::nullopt;
  if (unloaded_ == 0) {
    skip_what_is_in_memory();
    return std::nullopt;
  }
  const std::size_t unforgotten = forgets_.size() + new_dead_letters_.size();
  if (ready_.size() > page_messages / 2 || unforgotten >= max_unforgotten) return std::nullopt;
  is_loading_ = true;
  return LoadFromStore{generation_, cursor_, page_messages, page_bytes};
}

/// Nothing above the cursor is to be read, so it need not be passed over one by one later.
void Backlog::skip_what_is_in_memory() {
  if (!saving_.empty() || !writing_.empty()) return;
  cursor_ = last_row_;
  ahead_.clear();
}

std::size_t Backlog::on_loaded(StoreLoaded loaded, TimePoint now) {
  is_loading_ = false;
  if (std::exchange(is_load_void_, false)) {
    const std::uint64_t cursor = cursor_;
    pass_over_damaged(loaded);
    cursor_ = cursor;
    return 0;
  }
  if (loaded.messages.empty() && loaded.damaged.empty()) {
    const std::size_t missing = std::exchange(unloaded_, 0);
    rows_ -= std::min(rows_, missing);
    if (rows_ == 0) bytes_ = 0;
    if (missing > 0) count_topics_again();
    return missing;
  }
  if (!loaded.messages.empty()) oldest_ = now - loaded.messages.front().age;
  for (StoredMessage& stored : loaded.messages) {
    cursor_ = stored.row;
    if (ahead_.erase(stored.row) > 0) continue;
    if (unloaded_ > 0) --unloaded_;
    insert_ready(entry_from_store(std::move(stored), now));
  }
  pass_over_damaged(loaded);
  ahead_.erase(ahead_.begin(), ahead_.upper_bound(cursor_));
  return 0;
}

/// Their topics are unknown, so the topics are counted again as soon as everything else is in
/// memory.
void Backlog::pass_over_damaged(const StoreLoaded& loaded) {
  for (const std::uint64_t row : loaded.damaged) {
    cursor_ = std::max(cursor_, row);
    if (ahead_.erase(row) > 0) continue;
    if (unloaded_ > 0) --unloaded_;
    if (rows_ > 0) --rows_;
    is_topic_count_wrong_ = true;
  }
  bytes_ = rows_ == 0 ? 0 : bytes_ - std::min(bytes_, loaded.damaged_bytes);
  if (unloaded_ == 0 && std::exchange(is_topic_count_wrong_, false)) count_topics_again();
}

void Backlog::count_topics_again() {
  topics_ = TopicCounts{};
  for (const OutboxEntry& entry : ready_) topics_.add(entry.message.topic);
  for (const Behind& behind : behind_) topics_.add(behind.entry.message.topic);
  for (const std::deque<Saving>* queue : {&writing_, &saving_}) {
    for (const Saving& saving : *queue) {
      if (saving.purpose == Purpose::keep) topics_.add(saving.entry.message.topic);
    }
  }
}

void Backlog::on_revived(const DeadLettersRevived& revived, const OutboxEntries& in_flight) {
  std::uint64_t first = UINT64_MAX;
  for (const RevivedMessage& message : revived.messages) {
    first = std::min(first, message.row);
    ++rows_;
    ++unloaded_;
    bytes_ += message.bytes;
    topics_.add(message.topic);
    shares_.add(message.topic, message.bytes);
    dead_letters_.count -= std::min<std::size_t>(dead_letters_.count, 1);
    dead_letters_.bytes -= std::min(dead_letters_.bytes, message.bytes);
  }
  if (first <= cursor_) {
    if (!ready_.empty()) first = std::min(first, ready_.front().row);
    for (const OutboxEntry& entry : in_flight)
      if (entry.row != 0) ahead_.insert(entry.row);
    for (const auto* rows : {&forgets_, &forgetting_}) ahead_.insert(rows->begin(), rows->end());
    for (const auto* letters : {&new_dead_letters_, &writing_dead_letters_})
      for (const NewDeadLetter& letter : *letters) ahead_.insert(letter.row);
    for (const OutboxEntry& entry : std::exchange(ready_, {})) {
      ahead_.erase(entry.row);
      ++unloaded_;
    }
    cursor_ = first - 1;
    is_load_void_ = is_loading_;
  }
  for (const RevivedMessage& message : revived.messages) ahead_.erase(message.row);
}

void Backlog::on_load_failed(TimePoint now) {
  is_loading_ = is_load_void_ = false;
  load_retry_ = now + first_retry;
}

std::optional<TimePoint> Backlog::deadline() const {
  const auto forget = can_keep() && !is_writing_ ? forget_due_ : std::nullopt;
  return earlier(earlier(write_retry_, load_retry_), forget);
}

bool Backlog::on_deadline(TimePoint now) {
  if (load_retry_ && now >= *load_retry_) load_retry_.reset();
  if (!write_retry_ || now < *write_retry_) return false;
  try_again();
  return true;
}

void Backlog::on_stop() {
  is_stopping_ = true;
  if (state_ == State::failing) try_again();
}

void Backlog::try_again() {
  write_retry_.reset();
  state_ = State::working;
  is_probe_due_ = true;
}

std::size_t Backlog::unsaved() const {
  const auto count = [](const std::deque<Saving>& queue) {
    return std::count_if(queue.begin(), queue.end(), [](const Saving& s) { return !s.is_copy(); });
  };
  return static_cast<std::size_t>(count(saving_) + count(writing_));
}

}  // namespace slamgw
