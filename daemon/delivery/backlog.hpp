// SPDX-License-Identifier: Apache-2.0
// What the store holds and is about to hold, and the page of it that is in memory. Decides what is
// written and loaded next: one write under way at a time, so that everything which comes meanwhile
// shares the next commit. Pure; part of the outbox, which publishes.
//
//   keep() -> saving -> (WriteToStore) -> writing -> (StoreWritten) -> on disk
//   on disk -> (LoadFromStore, StoreLoaded) -> ready -> take_next() -> in flight -> forget()
//
// What may not go to the store (QoS 0) or cannot (it fails) waits behind it in memory and has its
// turn when every row before it was taken. In flight messages may be copied to the store as well
// (keep_copy). Their rows may lie ahead of what was read; reading passes over them.
#pragma once

#include <algorithm>
#include <deque>
#include <optional>
#include <set>
#include <vector>

#include "daemon/core/protocol_machine.hpp"
#include "daemon/delivery/message_store.hpp"
#include "daemon/delivery/publish_window.hpp"

namespace slamgw {

class Backlog {
 public:
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

  struct Written {
    OutboxEntries entries;        ///< safe now, and no longer in memory here
    std::uint64_t up_to_row = 0;  ///< copies up to this row are safe too
  };

  explicit Backlog(std::uint64_t max_bytes) : max_bytes_(max_bytes) {}
  Backlog(const Backlog&) = delete;
  Backlog& operator=(const Backlog&) = delete;

  State state() const { return state_; }
  bool can_keep() const { return state_ == State::working; }
  /// Something of `topic` must reach the broker first.
  bool is_ahead_of(std::string_view topic) const { return topics_.has(topic); }
  /// Of requests (message_store.hpp).
  std::uint64_t generation() const { return generation_; }

  /// Takes `entry` over to be stored. False, and nothing changed, when the store is full.
  bool keep(OutboxEntry& entry);
  /// Stores a copy of a message that is in flight. False when the store is full.
  bool keep_copy(OutboxEntry& in_flight);
  /// Its publication was lost with the link: a message whose copy is under way, or one that is
  /// stored.
  void adopt(OutboxEntry being_copied);
  void give_back(OutboxEntry stored);
  /// The copy will not be made: the write failed.
  void abandon_copy(OutboxEntry& in_flight);
  /// The broker has it.
  void forget(const OutboxEntry& entry, TimePoint now);
  /// Makes a dead letter of it, which is stored first where it is not yet. False, and nothing
  /// changed, when it is not stored and there is no store or no room for one more.
  bool make_dead_letter(OutboxEntry& entry, const Refusal& refusal, std::uint32_t tries);
  /// All of them were given to the store.
  bool has_written_dead_letters() const { return new_dead_letters_.empty(); }

  /// Waits in memory for its turn after all rows there are now.
  void queue_behind(OutboxEntry entry);
  /// Returns the first entry behind the store that can be stored now and all after it. Earlier
  /// entries keep their turn.
  OutboxEntries take_behind();
  /// Drops those of them for which `is_dropped(entry)`.
  template <class Predicate>
  void drop_behind(Predicate is_dropped) {
    std::erase_if(behind_, [&](const Behind& behind) {
      if (!is_dropped(behind.entry)) return false;
      topics_.remove(behind.entry.message.topic);
      return true;
    });
  }

  /// What is to be published next; null while nothing is in memory whose turn it is.
  const OutboxEntry* next() const;
  OutboxEntry take_next();

  /// Returns messages of a former store that are in memory; they have to be stored again.
  OutboxEntries on_opened(StoreOpened opened, TimePoint now);
  OutboxEntries on_absent(TimePoint now);
  Written on_written();
  /// Everything that waited to be stored, as it was given.
  OutboxEntries on_write_failed(TimePoint now);
  /// How many messages the store should have had and does not have.
  std::size_t on_loaded(StoreLoaded loaded, TimePoint now);
  void on_load_failed(TimePoint now);
  void on_dead_letters(DeadLetterCounts dead_letters) { dead_letters_ = dead_letters; }
  /// They have their old rows, so reading begins there again and passes over what is in memory.
  void on_revived(const DeadLettersRevived& revived, const OutboxEntries& in_flight);
  /// Delete at once what is delivered, load no more. A failing store is tried once more: what it
  /// does not delete comes again.
  void on_stop();

  std::optional<WriteToStore> next_write(TimePoint now);
  std::optional<LoadFromStore> next_load();
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
  std::size_t behind() const { return behind_.size(); }
  /// Messages on their way to the disk.
  std::size_t unsaved() const;
  bool is_settled() const {
    return unsaved() == 0 && !is_writing_ && forgets_.empty() && new_dead_letters_.empty();
  }

 private:
  enum class Purpose : std::uint8_t {
    keep,         ///< it waits on disk
    copy,         ///< it is in flight; this one is for the case that it does not arrive
    dead_letter,  ///< it is one as soon as it is on disk
  };
  struct Saving {
    OutboxEntry entry;
    Purpose purpose = Purpose::keep;
    bool is_copy() const { return purpose == Purpose::copy; }
  };

  struct Behind {
    OutboxEntry entry;
    std::uint64_t after_row = 0;
  };

  std::uint64_t taken() const { return bytes_ + dead_letters_.bytes; }
  std::uint64_t free() const { return max_bytes_ - std::min(max_bytes_, taken()); }
  bool reserve(OutboxEntry& entry);
  bool has_room_for(std::string_view topic, std::uint64_t cost);
  void note_room();
  void try_again();
  void release(const OutboxEntry& entry);
  std::deque<Saving>::iterator find(std::deque<Saving>& queue, std::uint64_t row);
  bool is_behinds_turn() const;
  OutboxEntries take_behind_from(std::deque<Behind>::iterator first);
  void take_dead_letters(WriteToStore& write);
  Saving* find_saving(std::uint64_t row);
  void insert_ready(OutboxEntry entry);
  void pass_over_damaged(const StoreLoaded& loaded);
  void count_topics_again();
  void skip_what_is_in_memory();

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

  std::uint64_t last_row_ = 0;
  TopicCounts topics_;  // of all in saving_, writing_ (no copies), on disk, ready_ and behind_
  std::deque<Saving> saving_;
  std::deque<Saving> writing_;
  OutboxEntries ready_;        // rows rise
  std::deque<Behind> behind_;  // after_row rises

  std::uint64_t cursor_ = 0;       // read up to this row
  std::size_t unloaded_ = 0;       // rows above it that are not in ahead_
  std::set<std::uint64_t> ahead_;  // rows above it whose message is in memory or delivered
  std::vector<std::uint64_t> forgets_;
  std::vector<std::uint64_t> forgetting_;  // in the write that is under way
  std::vector<NewDeadLetter> new_dead_letters_;
  std::vector<NewDeadLetter> writing_dead_letters_;  // in the write that is under way
  DeadLetterCounts dead_letters_;
  std::optional<TimePoint> forget_due_;

  bool is_topic_count_wrong_ = false;  // too high for topics of rows that were damaged
  bool is_writing_ = false;
  bool is_loading_ = false;
  bool is_load_void_ = false;  // the page under way does not begin at the cursor any more
  bool is_stopping_ = false;
  bool is_probe_due_ = false;  // an empty write shows whether a failing store works again
  std::optional<TimePoint> write_retry_;
  std::optional<TimePoint> load_retry_;
  std::chrono::seconds retry_wait_ = first_retry;
};

}  // namespace slamgw
