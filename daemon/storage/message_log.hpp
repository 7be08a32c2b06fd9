// SPDX-License-Identifier: Apache-2.0
// The message store on disk: undelivered messages and dead letters in one record log, by row.
// Blocks; used on the disk's thread by DiskStore.
//
//   messages/      time of storing, time of receipt (8 octets each), mesh, flags (1 each), topic's
//                  length (2), topic, only for a dead letter: since when it is one (8), reason
//                  code, tries (4 each), reason's length (2), reason; payload
//
// Flags: retain 1, QoS 2 and 4, dead letter 8. Numbers are little-endian, times milliseconds since
// 1970; the mesh is 0 for none, else 1 + Mesh.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "daemon/core/operator_order.hpp"
#include "daemon/delivery/message_store.hpp"
#include "daemon/storage/record_log.hpp"

namespace slamgw {

/// States why and since when a message is a dead letter.
struct DeadLetterFacts {
  WallTime set_aside_at{};
  int code = 0;  ///< MQTT 5 reason code; 0: there is none
  std::uint32_t tries = 0;
  std::string reason;
};
/// A record of messages/.
struct MessageRecord {
  WallTime stored_at{};
  BrokerMessage message;
  std::optional<DeadLetterFacts> dead = {};
};
Bytes encode_message(const MessageRecord& record);
/// Returns nothing when `octets` are not a record of messages/.
std::optional<MessageRecord> decode_message(ByteView octets);

/// A dead letter as operators see it.
struct ListedDeadLetter {
  std::uint64_t id = 0;  ///< its row
  MessageRecord record;
  /// The disk cannot read it: the dead letter's reason says why. Only topic and size are known.
  bool is_unreadable = false;
};

class MessageLog {
 public:
  /// A longer reason of a dead letter is cut.
  static constexpr std::size_t max_reason_bytes = 200;

  /// Reads the whole log. Throws LogError, also for records that the disk cannot read, unless
  /// `skips_unreadable`: then these records are lost.
  MessageLog(const std::string& directory, std::uint64_t max_bytes, bool skips_unreadable);

  /// Returns what the log held at the start. Call once.
  StoreOpened take_opened() { return std::move(opened_); }
  /// Records that were missing at the start.
  const RecordLog::Summary& lost() const { return lost_; }

  /// Writes all of the request durably. Returns the number of messages that were to become dead
  /// letters but are damaged: they are lost. Throws LogError, and then has kept no message.
  std::size_t write(const WriteToStore& write);
  /// Reads the requested messages and erases damaged ones. Throws LogError.
  StoreLoaded load(const LoadFromStore& request, bool skips_unreadable);

  DeadLetterCounts dead_letters() const { return {letters_.size(), letter_bytes_}; }
  /// Returns the first dead letters of `topic` (empty: of any topic) with ids above `after`: at
  /// most `max_count` and about `max_bytes`, but at least one if there is one. Throws LogError, as
  /// do ids(), revive() and discard().
  std::vector<ListedDeadLetter> list(const std::string& topic, std::uint64_t after,
                                     std::size_t max_count, std::size_t max_bytes) const;
  /// Returns the ids of the chosen dead letters that exist, in rising order.
  std::vector<std::uint64_t> ids(const DeadLetterChoice& choice) const;
  /// Returns the ids of the dead letters that RetryDeadLetters means.
  std::vector<std::uint64_t> retried(const std::string& topic, std::size_t most) const;
  struct Revival {
    std::vector<FormerLetter> messages;
    std::vector<FormerLetter> damaged;  ///< they are lost
    std::size_t tried = 0;              ///< of the ids
  };
  /// Limit of letters that the disk cannot read in one revive(): each may take seconds.
  static constexpr std::size_t most_unreadable = 256;
  /// Turns dead letters into messages again, in their rows: the first ones, at most `most`. Letters
  /// that the disk cannot read stay; after `patience` they are no longer among retried(). Throws
  /// LogError if it can read none.
  Revival revive(std::span<const std::uint64_t> ids, std::size_t most, Duration patience);
  /// Returns the disk's error when revive() has taken letters out of retried() since the last call;
  /// else nothing.
  std::string take_why_given_up() { return std::exchange(why_given_up_, {}); }
  std::vector<FormerLetter> discard(const std::vector<std::uint64_t>& ids);

  RecordLog& log() { return log_; }

 private:
  struct LettersOfTopic {
    std::size_t count = 0;
    /// The letters that are retried, by id, but letters that have lost a connection (false) come
    /// first, as RetryDeadLetters wants them.
    std::set<std::pair<bool, std::uint64_t>> retried;
  };
  using Topics = std::map<std::string, LettersOfTopic, std::less<>>;
  struct Letter {
    std::uint64_t bytes = 0;  ///< stored_cost()
    std::uint64_t reason_bytes = 0;
    Topics::iterator topic;
    std::optional<TimePoint> unreadable_since = {};
  };

  void read_all(bool skips_unreadable);
  std::optional<MessageRecord> find(std::uint64_t row, bool skips_unreadable = false) const;
  std::optional<MessageRecord> find_letter(std::uint64_t id) const;
  std::optional<ListedDeadLetter> show_letter(std::uint64_t id) const;
  void put(std::uint64_t row, const MessageRecord& record) {
    log_.put(row, encode_message(record));
  }
  void add_letter(std::uint64_t id, const MessageRecord& record);
  FormerLetter drop_letter(std::uint64_t id);

  RecordLog log_;                            // by row
  std::map<std::uint64_t, Letter> letters_;  // by row
  Topics topics_;                            // of letters; none is empty
  std::uint64_t letter_bytes_ = 0;
  std::string why_given_up_;
  StoreOpened opened_;
  RecordLog::Summary lost_;
};

}  // namespace slamgw
