// SPDX-License-Identifier: Apache-2.0
// The index of the store: how much is on disk, which rows of it were read, and what is written and
// read next. One write is under way at a time, so that all requests during it share the next
// commit. Pure; part of the outbox, which owns the messages.
//
//   keep() -> asked -> (WriteToStore) -> writing -> (StoreWritten) -> durable
//   durable -> on_left_memory() -> unread -> (LoadFromStore, StoreLoaded) -> durable, in memory
//   durable -> forget() or bury() -> (WriteToStore) -> gone
//
// Rows are read in rising order; rows in memory or to be erased are skipped. Reading restarts at a
// lower row when that row leaves memory.
#pragma once

#include <algorithm>
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
  /// Limits of one page read from the store. The next page is requested once at most half a page
  /// is queued.
  static constexpr std::size_t page_messages = 256;
  static constexpr std::size_t page_bytes = 1u << 20;
  /// Limits of one transaction.
  static constexpr std::size_t write_messages = 4096;
  static constexpr std::size_t write_bytes = 1u << 20;
  /// Delivered rows are deleted once there are this many or the first is this old. Rows that were
  /// not deleted before a crash are published twice.
  static constexpr std::size_t forget_batch = 256;
  static constexpr std::chrono::milliseconds forget_delay{500};
  /// Limit of delivered and refused rows that a failing store could not delete; at the limit no
  /// more rows are read.
  static constexpr std::size_t max_unforgotten = 65536;
  /// Part of `store.max_bytes` that dead letters may take, so that they leave room for messages.
  static constexpr std::uint64_t dead_letter_share = 4;
  /// The last part of the store, and of the dead letters' part, is for robots that have stored less
  /// than twice what is still free there. So a robot that floods leaves room for the others.
  static constexpr std::uint64_t share_reserve = 4;
  static constexpr std::chrono::seconds first_retry{1};
  static constexpr std::chrono::seconds longest_retry{60};

  enum class State : std::uint8_t { opening, absent, working, failing };

  explicit Backlog(std::uint64_t max_bytes) : max_bytes_(max_bytes) {}
  Backlog(const Backlog&) = delete;
  Backlog& operator=(const Backlog&) = delete;

  State state() const { return state_; }
  bool can_keep() const { return state_ == State::working; }
  /// Returns true when rows can be read and erased; so also while nothing can be kept.
  bool is_open() const { return can_keep() || state_ == State::failing; }
  /// Returns true when an earlier message of its topic may be on disk and unread, so that `item`
  /// has to wait.
  bool is_ahead_of(const Item& item) const {
    return item.row > cursor_ && unread_topics_.of(item.message.topic) > 0;
  }
  bool has_unread(std::string_view topic) const { return unread_topics_.of(topic) > 0; }

  /// Queues an unsaved message for the next write. Returns false, and leaves the message as it is,
  /// when the store is full.
  bool keep(Item& item);
  /// Call when a message leaves memory for good, because the broker has it or it is dropped. Its
  /// row is deleted with a later write.
  void forget(const Item& item, TimePoint now);
  /// Makes a dead letter of `item`, and stores it first if it is not stored yet. Returns false, and
  /// leaves it as it is, when it is not stored and there is no store or no room for it.
  bool bury(Item& item, const Refusal& refusal, std::uint32_t tries, TimePoint now);
  /// Stops counting `item` among the stored messages. Its flow keeps its share.
  void release(const Item& item);
  /// Returns true when all dead letters were given to the store.
  bool has_written_dead_letters() const;
  /// Call when a durable message that has not reached the broker leaves memory: from now on it is
  /// only on disk.
  void on_left_memory(std::uint64_t row, std::string_view topic);

  void on_opened(StoreOpened opened, TimePoint now);
  void on_absent() { state_ = State::absent; }
  /// Returns the rows that are now durable; some may have left memory. A failing store that could
  /// erase is tried again soon.
  std::vector<std::uint64_t> on_written(TimePoint now);
  /// Makes all messages that wait for a write unsaved again. Queues those that were to become dead
  /// letters. Erasures are written alone from now on, until the store is tried again.
  void on_write_failed(FairQueue& queue, TimePoint now);
  /// Removes from `loaded` the rows in memory or to be erased; the caller takes the others into
  /// memory.
  void on_loaded(StoreLoaded& loaded, FairQueue& queue, TimePoint now);
  void on_load_failed(TimePoint now);
  void on_dead_letters(const DeadLettersChanged& changed);
  /// Counts revived letters as unread messages. They keep their old rows.
  void on_revived(const DeadLettersRevived& revived);
  /// Deletes delivered rows at once and loads no more. Tries a failing store once more, because
  /// rows that it does not delete are published twice.
  void on_stop();

  std::optional<WriteToStore> next_write(FairQueue& queue, TimePoint now);
  std::optional<LoadFromStore> next_load(const FairQueue& queue);
  std::optional<TimePoint> deadline() const;
  /// Returns true when a failing store is tried again now.
  bool on_deadline(TimePoint now);

  /// Rows that are stored or being stored, and what they count against `store.max_bytes`.
  std::size_t rows() const { return rows_; }
  std::uint64_t bytes() const { return bytes_; }
  /// Returns true from the first refused message until there is room again.
  bool is_full() const { return is_full_ || is_share_full_; }
  /// Returns true when only robots that have stored little find room.
  bool is_nearly_full() const { return free() <= max_bytes_ / share_reserve; }
  /// The same for new messages on topics that the broker refuses.
  bool has_little_room_for_letters() const {
    return free_for_letters() <= room_for_letters() / share_reserve;
  }
  /// Bytes of messages and dead letters.
  std::uint64_t taken() const { return bytes_ + dead_letters_.bytes; }
  SlotSums::Sum largest_share() const { return shares_.largest(); }
  const DeadLetterCounts& dead_letters() const { return dead_letters_; }
  std::uint64_t stored_total() const { return stored_total_; }
  /// Returns when the oldest row was stored, exact to the page that was read last.
  std::optional<TimePoint> oldest() const { return rows_ ? oldest_ : std::nullopt; }
  bool is_settled() const { return to_write_.empty() && !is_writing_ && erasures_.empty(); }

 private:
  /// Rows on disk that are to be erased, or (with a letter) to become dead letters.
  using Erasures = std::map<std::uint64_t, std::optional<NewDeadLetter>>;

  std::uint64_t free() const { return max_bytes_ - std::min(max_bytes_, taken()); }
  std::uint64_t room_for_letters() const { return max_bytes_ / dead_letter_share; }
  std::uint64_t free_for_letters() const {
    return room_for_letters() - std::min(room_for_letters(), dead_letters_.bytes);
  }
  bool has_share_left(std::string_view topic, std::uint64_t free) const {
    return shares_.of(flow_of(topic)) < 2 * free;
  }
  bool has_room_for(std::string_view topic, std::uint64_t cost);
  void note_room();
  void try_again();
  void take_to_write(WriteToStore& write, FairQueue& queue);
  void take_erasures(WriteToStore& write, FairQueue& queue);
  void abandon(Item& item, FairQueue& queue);

  State state_ = State::opening;
  std::uint64_t max_bytes_;
  std::uint64_t bytes_ = 0;
  std::size_t rows_ = 0;
  SlotSums shares_;             // by flow, of taken(), and of rows that were lost to damage since
  bool is_full_ = false;        // for all robots
  bool is_share_full_ = false;  // for a robot that has stored much
  std::uint64_t stored_total_ = 0;
  std::optional<TimePoint> oldest_;

  std::deque<std::uint64_t> to_write_;  // rows for the next write; some may have left memory
  std::vector<std::uint64_t> writing_;  // in the write that is under way
  Erasures erasures_;
  Erasures erasing_;  // in the write that is under way
  DeadLetterCounts dead_letters_;
  std::optional<TimePoint> erasure_due_;

  std::uint64_t cursor_ = 0;  // no row up to this one is unread
  std::size_t unread_ = 0;    // rows that are on disk only
  SlotSums unread_topics_;    // too high for topics of damaged rows, until all is read
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
