// SPDX-License-Identifier: Apache-2.0
// The index of the store: how much is on disk, which rows of it were read, and what is written and
// read next. One write is under way at a time, so that everything which comes meanwhile shares the
// next commit. Pure; part of the outbox, which has the messages.
//
//   keep() -> asked -> (WriteToStore) -> writing -> (StoreWritten) -> durable
//   durable -> on_left_memory() -> unread -> (LoadFromStore, StoreLoaded) -> durable, in memory
//   durable -> forget() or bury() -> (WriteToStore) -> gone
//
// Reading goes by rising row and passes over rows that are in memory or to be erased. It begins
// again at a lower row when that one leaves memory.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <string_view>
#include <vector>

#include "daemon/core/protocol_machine.hpp"
#include "daemon/delivery/fair_queue.hpp"
#include "daemon/delivery/message_store.hpp"

namespace slamgw {

class Backlog {
 public:
  using Item = OutboxItem;
  /// One page read back from the store; a new one is asked for when half of it has gone.
  static constexpr std::size_t page_messages = 256;
  static constexpr std::size_t page_bytes = 1u << 20;
  /// One transaction.
  static constexpr std::size_t write_messages = 4096;
  static constexpr std::size_t write_bytes = 1u << 20;
  /// Delivered rows are deleted when so many have come together or the first is so old; what was
  /// not deleted at a crash is published twice.
  static constexpr std::size_t forget_batch = 256;
  static constexpr std::chrono::milliseconds forget_delay{500};
  /// Delivered and refused rows that a failing store could not delete; beyond it no more are read.
  static constexpr std::size_t max_unforgotten = 65536;
  /// Part of `store.max_bytes` that dead letters may take, so that they leave room for messages.
  static constexpr std::uint64_t dead_letter_share = 4;
  /// The last part of the store is for robots that have stored less than twice what is still free,
  /// so that one that floods leaves room for the others.
  static constexpr std::uint64_t share_reserve = 4;
  static constexpr std::chrono::seconds first_retry{1};
  static constexpr std::chrono::seconds longest_retry{60};

  enum class State : std::uint8_t { opening, absent, working, failing };

  explicit Backlog(std::uint64_t max_bytes) : max_bytes_(max_bytes) {}
  Backlog(const Backlog&) = delete;
  Backlog& operator=(const Backlog&) = delete;

  State state() const { return state_; }
  bool can_keep() const { return state_ == State::working; }
  /// Of requests (message_store.hpp).
  std::uint64_t generation() const { return generation_; }
  /// An earlier message of its topic may be on disk and unread, so this one has to wait.
  bool is_ahead_of(const Item& item) const {
    return item.row > cursor_ && unread_topics_.has(item.message.topic);
  }
  bool has_unread(std::string_view topic) const { return unread_topics_.has(topic); }

  /// Has an unsaved message stored. False, and nothing changed, when the store is full.
  bool keep(Item& item);
  /// It leaves memory for good: the broker has it, or it is dropped.
  void forget(const Item& item, TimePoint now);
  /// Makes a dead letter of it, which is stored first where it is not yet. False, and nothing
  /// changed, when it is not stored and there is no store or no room for one more.
  bool bury(Item& item, const Refusal& refusal, std::uint32_t tries, TimePoint now);
  /// It does not count among the messages any more.
  void release(const Item& item);
  /// All dead letters were given to the store.
  bool has_written_dead_letters() const;
  /// A durable message that has not reached the broker is on disk only from now on.
  void on_left_memory(std::uint64_t row, std::string_view topic);

  void on_opened(StoreOpened opened, TimePoint now);
  void on_absent(TimePoint now);
  /// The rows that are durable now; some may not be in memory any more.
  std::vector<std::uint64_t> on_written();
  /// Nothing that was to be written is on disk. What was to be a dead letter is queued again.
  void on_write_failed(FairQueue& queue, TimePoint now);
  /// Leaves in `loaded` what is to be taken into memory. Returns how many messages the store should
  /// have had and does not have.
  std::size_t on_loaded(StoreLoaded& loaded, FairQueue& queue, TimePoint now);
  void on_load_failed(TimePoint now);
  void on_dead_letters(DeadLetterCounts dead_letters) { dead_letters_ = dead_letters; }
  /// They have their old rows.
  void on_revived(const DeadLettersRevived& revived);
  /// Delete at once what is delivered, load no more. A failing store is tried once more: what it
  /// does not delete comes again.
  void on_stop();

  std::optional<WriteToStore> next_write(FairQueue& queue, TimePoint now);
  std::optional<LoadFromStore> next_load(const FairQueue& queue);
  std::optional<TimePoint> deadline() const;
  /// True when a failing store is to be tried again.
  bool on_deadline(TimePoint now);

  /// Rows that are stored or being stored, and what they count against `store.max_bytes`.
  std::size_t rows() const { return rows_; }
  std::uint64_t bytes() const { return bytes_; }
  /// A message had to be refused, and there is no more room since.
  bool is_full() const { return is_full_ || is_share_full_; }
  /// Only robots that have stored little find room.
  bool is_nearly_full() const { return free() <= max_bytes_ / share_reserve; }
  StoreShares::Share largest_share() const { return shares_.largest(); }
  const DeadLetterCounts& dead_letters() const { return dead_letters_; }
  std::uint64_t stored_total() const { return stored_total_; }
  /// When the oldest of them was stored (to within the page that was read last).
  std::optional<TimePoint> oldest() const { return rows_ ? oldest_ : std::nullopt; }
  bool is_settled() const { return to_write_.empty() && !is_writing_ && erasures_.empty(); }

 private:
  /// Rows on disk that are to be erased, or (with a letter) to become dead letters.
  using Erasures = std::map<std::uint64_t, std::optional<NewDeadLetter>>;

  std::uint64_t taken() const { return bytes_ + dead_letters_.bytes; }
  std::uint64_t free() const { return max_bytes_ - std::min(max_bytes_, taken()); }
  bool has_room_for(std::string_view topic, std::uint64_t cost);
  void note_room();
  void try_again();
  void take_to_write(WriteToStore& write, FairQueue& queue);
  void take_erasures(WriteToStore& write, FairQueue& queue);
  void abandon(Item& item, FairQueue& queue);
  void on_read(std::size_t rows);

  State state_ = State::opening;
  std::uint64_t generation_ = 0;  // of requests
  std::uint64_t max_bytes_;
  std::uint64_t bytes_ = 0;
  std::size_t rows_ = 0;
  StoreShares shares_;          // of bytes_, and of what damage has taken since
  bool is_full_ = false;        // for all
  bool is_share_full_ = false;  // for a robot that has stored much
  std::uint64_t stored_total_ = 0;
  std::optional<TimePoint> oldest_;

  std::deque<std::uint64_t> to_write_;  // asked; some may have left memory since
  std::vector<std::uint64_t> writing_;  // in the write that is under way
  Erasures erasures_;
  Erasures erasing_;  // in the write that is under way
  DeadLetterCounts dead_letters_;
  std::optional<TimePoint> erasure_due_;

  std::uint64_t cursor_ = 0;   // no row up to this one is unread
  std::size_t unread_ = 0;     // rows that are on disk only
  TopicCounts unread_topics_;  // too high for topics of damaged rows, until all is read
  std::uint64_t loading_after_ = 0;

  bool is_writing_ = false;
  bool is_loading_ = false;
  bool is_stopping_ = false;
  bool is_probe_due_ = false;  // an empty write shows whether a failing store works again
  std::optional<TimePoint> write_retry_;
  std::optional<TimePoint> load_retry_;
  std::chrono::seconds retry_wait_ = first_retry;
};

}  // namespace slamgw
