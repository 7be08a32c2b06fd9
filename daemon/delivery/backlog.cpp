// SPDX-License-Identifier: Apache-2.0
#include "daemon/delivery/backlog.hpp"

#include <algorithm>
#include <cassert>
#include <utility>

namespace slamgw {

bool Backlog::keep(Item& item) {
  const std::uint64_t cost = stored_cost(item.message);
  note_room();
  if (!has_room_for(item.message.topic, cost)) return false;
  bytes_ += cost;
  shares_.add_named(flow_of(item.message.topic), cost);
  if (rows_++ == 0) oldest_ = item.submitted;
  item.disk = Item::Disk::asked;
  to_write_.push_back(item.row);
  return true;
}

bool Backlog::has_room_for(std::string_view topic, std::uint64_t cost) {
  // A full store stays closed until a sixteenth of it is free. Otherwise small messages would
  // enter ahead of a large one that was refused.
  if (is_full_ || cost > max_bytes_ || taken() > max_bytes_ - cost) {
    is_full_ = true;
    return false;
  }
  // The message's size does not count, so that a robot's small messages do not pass its large ones.
  if (is_nearly_full() && !has_share_left(topic, free())) {
    is_share_full_ = true;
    return false;
  }
  return true;
}

void Backlog::release(const Item& item) {
  // Clamped: rows that were lost to damage were not counted exactly.
  bytes_ -= std::min(bytes_, stored_cost(item.message));
  rows_ -= rows_ > 0 ? 1 : 0;
  if (rows_ == 0 && dead_letters_.count == 0) shares_ = {};
  note_room();
}

void Backlog::note_room() {
  if (free() >= max_bytes_ / 16) is_full_ = false;
  if (!is_nearly_full()) is_share_full_ = false;
}

void Backlog::forget(const Item& item, TimePoint now) {
  if (item.disk == Item::Disk::none) return;
  shares_.remove(flow_of(item.message.topic), stored_cost(item.message));
  release(item);
  if (item.disk == Item::Disk::asked) return;
  erasures_.try_emplace(item.row);
  if (!erasure_due_) erasure_due_ = now + forget_delay;
}

bool Backlog::bury(Item& item, const Refusal& refusal, std::uint32_t tries, TimePoint now) {
  const std::uint64_t cost = stored_cost(item.message);
  if (item.disk == Item::Disk::none) {
    const std::uint64_t free = free_for_letters();
    const bool has_room = cost <= free && (!has_little_room_for_letters() ||
                                           has_share_left(item.message.topic, free));
    if (!can_keep() || !has_room || !keep(item)) return false;
  }
  erasures_[item.row] = {item.row, refusal.why, refusal.code, tries, cost, item.message.topic};
  if (can_keep()) erasure_due_ = now;
  dead_letters_.bytes += cost;  // the store counts exactly, but later
  ++dead_letters_.count;
  if (item.is_durable()) release(item);
  return true;
}

bool Backlog::has_written_dead_letters() const {
  return std::ranges::none_of(erasures_,
                              [](const auto& erasure) { return erasure.second.has_value(); });
}

void Backlog::on_left_memory(std::uint64_t row, std::string_view topic) {
  cursor_ = unread_ == 0 ? row - 1 : std::min(cursor_, row - 1);
  ++unread_;
  unread_topics_.add(topic, 1);
}

void Backlog::on_opened(StoreOpened opened, TimePoint now) {
  state_ = State::working;
  bytes_ = opened.bytes;
  rows_ = unread_ = opened.count;
  oldest_ = now - opened.oldest_age;
  unread_topics_ = std::move(opened.topics);
  shares_ = std::move(opened.shares);
  dead_letters_ = opened.dead_letters;
}

std::optional<WriteToStore> Backlog::next_write(FairQueue& queue, TimePoint now) {
  if (!is_open() || is_writing_) return std::nullopt;
  WriteToStore write;
  take_to_write(write, queue);
  const bool is_batch = can_keep() && (erasures_.size() >= forget_batch || is_stopping_);
  const bool is_erasure_due =
      !erasures_.empty() && (is_batch || (erasure_due_ && now >= *erasure_due_));
  if (write.keep.empty() && !is_erasure_due && !is_probe_due_) return std::nullopt;
  take_erasures(write, queue);
  if (!can_keep() && write.forget.empty()) return std::nullopt;
  is_probe_due_ = false;
  is_writing_ = true;
  return write;
}

void Backlog::take_to_write(WriteToStore& write, FairQueue& queue) {
  std::size_t bytes = 0;
  while (!to_write_.empty() && write.keep.size() < write_messages && bytes < write_bytes) {
    Item* const item = queue.find(to_write_.front());
    to_write_.pop_front();
    if (!item) continue;
    bytes += item->cost();
    item->disk = Item::Disk::writing;
    write.keep.push_back({item->row, item->message, {}});
    writing_.push_back(item->row);
  }
}

/// Moves all erasures into `write`, except dead letters whose message is stored by a later write,
/// and all dead letters while the store is failing: they need room, and erasures make room.
void Backlog::take_erasures(WriteToStore& write, FairQueue& queue) {
  for (auto next = erasures_.begin(); next != erasures_.end();) {
    const auto erasure = next++;
    const auto& [row, letter] = *erasure;
    const Item* const item = letter ? queue.find(row) : nullptr;
    if (letter && (!can_keep() || (item && item->disk == Item::Disk::asked))) continue;
    if (letter) {
      write.dead_letters.push_back(*letter);
    } else {
      write.forget.push_back(row);
    }
    erasing_.insert(erasures_.extract(erasure));
  }
  erasure_due_.reset();
}

std::vector<std::uint64_t> Backlog::on_written(TimePoint now) {
  stored_total_ += writing_.size();
  erasing_.clear();
  is_writing_ = false;
  retry_wait_ = first_retry;
  if (write_retry_) write_retry_ = std::min(*write_retry_, now + first_retry);
  return std::exchange(writing_, {});
}

void Backlog::on_write_failed(FairQueue& queue, TimePoint now) {
  erasures_.merge(erasing_);
  erasing_.clear();
  to_write_.insert(to_write_.end(), writing_.begin(), writing_.end());
  writing_.clear();
  for (const std::uint64_t row : std::exchange(to_write_, {}))
    if (Item* const item = queue.find(row)) abandon(*item, queue);
  is_writing_ = false;
  // Erasures alone follow at once: a full disk has room for nothing else.
  erasure_due_.reset();
  if (!erasures_.empty()) erasure_due_ = can_keep() ? now : now + retry_wait_;
  if (std::exchange(state_, State::failing) == State::failing) return;
  write_retry_ = now + retry_wait_;
  retry_wait_ = std::min(2 * retry_wait_, longest_retry);
}

void Backlog::abandon(Item& item, FairQueue& queue) {
  shares_.remove(flow_of(item.message.topic), stored_cost(item.message));
  release(item);
  item.disk = Item::Disk::none;
  if (!std::exchange(item.is_dead, false)) return;
  erasures_.erase(item.row);
  dead_letters_.count -= std::min<std::size_t>(dead_letters_.count, 1);
  dead_letters_.bytes -= std::min(dead_letters_.bytes, stored_cost(item.message));
  queue.enqueue(item);
}

std::optional<LoadFromStore> Backlog::next_load(const FairQueue& queue) {
  if (!is_open() || is_loading_ || load_retry_ || is_stopping_ || unread_ == 0) return std::nullopt;
  if (queue.durable_queued() > page_messages / 2 || erasures_.size() >= max_unforgotten)
    return std::nullopt;
  is_loading_ = true;
  loading_after_ = cursor_;
  return LoadFromStore{cursor_, page_messages, page_bytes};
}

void Backlog::on_loaded(StoreLoaded& loaded, FairQueue& queue, TimePoint now) {
  is_loading_ = false;
  if (!loaded.messages.empty()) oldest_ = now - loaded.messages.front().age;
  std::uint64_t last = cursor_;
  const auto is_passed_over = [&](std::uint64_t row) {
    last = std::max(last, row);
    return queue.find(row) || erasures_.contains(row) || erasing_.contains(row);
  };
  std::erase_if(loaded.messages, [&](const StoredMessage& stored) {
    const bool is_known = is_passed_over(stored.row);
    if (!is_known) unread_topics_.remove(stored.message.topic, 1);
    return is_known;
  });
  const auto lost = static_cast<std::size_t>(
      std::ranges::count_if(loaded.damaged, [&](auto row) { return !is_passed_over(row); }));
  rows_ -= std::min(rows_, lost);
  bytes_ = rows_ == 0 ? 0 : bytes_ - std::min(bytes_, loaded.damaged_bytes);
  // Events come in the order of the requests, so the rows on disk only are known exactly.
  assert(loaded.messages.size() + lost <= unread_);
  unread_ -= loaded.messages.size() + lost;
  if (unread_ == 0) unread_topics_ = {};
  if (cursor_ == loading_after_) cursor_ = last;
}

void Backlog::on_revived(const DeadLettersRevived& revived) {
  for (const FormerLetter& message : revived.messages) {
    on_left_memory(message.row, message.topic);
    ++rows_;
    bytes_ += message.bytes;
  }
}

/// Adds the letters that the store has not written yet, because it does not count them.
void Backlog::on_dead_letters(const DeadLettersChanged& changed) {
  dead_letters_ = changed.dead_letters;
  for (const Erasures* unwritten : {&erasures_, &erasing_}) {
    for (const auto& [row, letter] : *unwritten) {
      if (!letter) continue;
      ++dead_letters_.count;
      dead_letters_.bytes += letter->bytes;
    }
  }
  for (const FormerLetter& letter : changed.discarded)
    shares_.remove(flow_of(letter.topic), letter.bytes);
}

void Backlog::on_load_failed(TimePoint now) {
  is_loading_ = false;
  load_retry_ = now + first_retry;
}

std::optional<TimePoint> Backlog::deadline() const {
  const auto erasure = is_open() && !is_writing_ ? erasure_due_ : std::nullopt;
  return earlier(earlier(write_retry_, load_retry_), erasure);
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

}  // namespace slamgw
