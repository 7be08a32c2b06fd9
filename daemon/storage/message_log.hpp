// SPDX-License-Identifier: Apache-2.0
// The message store on disk: undelivered messages in one record log, in the order of their rows,
// and dead letters in another. Blocks; used on the disk's thread by DiskStore.
//
//   messages/      row, time of storing, the dead letter it was, time of receipt (8 octets each),
//                  mesh, QoS and retain flag (1 each), length of the topic (2), topic, payload
//   dead-letters/  when it became one (8), reason code, tries (4 each), reason's length (2),
//                  reason, and then a record as in messages/
//
// Numbers are little-endian, times milliseconds since 1970; the mesh is 0 for none, else 1 + Mesh.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "daemon/core/operator_order.hpp"
#include "daemon/delivery/message_store.hpp"
#include "daemon/storage/keyed_log.hpp"
#include "daemon/storage/record_log.hpp"

namespace slamgw {

/// A record of messages/.
struct MessageRecord {
  std::uint64_t row = 0;
  std::int64_t stored_at = 0;
  std::uint64_t dead_letter = 0;  ///< that it was; 0: none
  BrokerMessage message;
};
Bytes encode_message(const MessageRecord& record);
/// Nothing when it is not such a record.
std::optional<MessageRecord> decode_message(ByteView octets);

/// A dead letter as operators see it.
struct ListedDeadLetter {
  DeadLetter letter;
  std::string reason;
  int code = 0;  ///< MQTT 5 reason code; 0: there is none
  std::uint32_t tries = 0;
  WallTime stored_at{};
  WallTime set_aside_at{};
};

class MessageLog {
 public:
  /// A longer reason of a dead letter is cut.
  static constexpr std::size_t max_reason_bytes = 200;

  /// Reads everything that is there. Throws LogError, also for what the disk cannot read unless
  /// `skips_unreadable`: that is lost then.
  MessageLog(const std::string& directory, std::uint64_t max_bytes, bool skips_unreadable);

  /// What was there at the start.
  StoreOpened take_opened() { return std::move(opened_); }
  const RecordLog::Summary& lost_messages() const { return lost_messages_; }
  const RecordLog::Summary& lost_dead_letters() const { return lost_dead_letters_; }

  /// All of it is durable when this returns, and nothing of it when it throws LogError. Returns how
  /// many messages that were to be dead letters turned out to be damaged: they are lost.
  std::size_t write(const WriteToStore& write);
  /// Damaged messages are lost. Throws LogError.
  StoreLoaded load(const LoadFromStore& request, bool skips_unreadable);

  DeadLetterCounts dead_letters() const;
  /// The first of `topic` (empty: of any) with ids above `after`: at most `max_count`, about
  /// `max_bytes`, but one if there is one. Throws LogError, as the next ones.
  std::vector<ListedDeadLetter> list(const std::string& topic, std::uint64_t after,
                                     std::size_t max_count, std::size_t max_bytes) const;
  std::optional<ListedDeadLetter> find(std::uint64_t id) const;
  /// Those that are there, by the time when they were stored first.
  std::vector<std::uint64_t> ids(const DeadLetterChoice& choice) const;
  /// Those that RetryDeadLetters means.
  std::vector<ListedDeadLetter> retried(const std::string& topic, std::size_t most) const;
  /// How many there were.
  std::size_t discard(const DeadLetterChoice& choice);

  bool is_in_place() const { return messages_.is_in_place() && letters_.log().is_in_place(); }
  /// As RecordLog::put_back_in_place().
  std::vector<std::string> put_back_in_place();

 private:
  struct Row {
    std::uint32_t distance = 0;  ///< from the segment's first row
    std::uint32_t offset = 0;    ///< 0: erased
    std::uint32_t bytes = 0;
  };
  /// Rows that are in one segment and follow each other.
  struct SegmentRows {
    std::uint32_t segment = 0;
    std::vector<Row> rows;  ///< distances rise
    std::size_t live = 0;
  };
  using Rows = std::map<std::uint64_t, SegmentRows>;  // by the first row
  struct Kept {
    std::uint64_t row;
    RecordLog::Place place;
    std::size_t bytes;
  };

  /// Of one topic: whether it has not lost a connection, and its id.
  using Retried = std::set<std::pair<bool, std::uint64_t>>;
  using RetriedOfTopic = std::map<std::string, Retried, std::less<>>;
  struct Letter {
    std::uint64_t bytes = 0;  ///< as counted against max_bytes
    RetriedOfTopic::iterator retried;
    bool has_lost_connection = false;
  };

  void replay(bool skips_unreadable);
  void replay_letters(bool skips_unreadable);
  void add_row(const Kept& kept);
  void forget_copies(std::vector<Kept>& found);
  void move_rows_of(std::uint32_t segment);
  Row* find_row(std::uint64_t row, std::uint32_t& segment);
  void erase_rows(const std::vector<std::uint64_t>& rows);
  Bytes put_letter(std::uint64_t id, ByteView message, const NewDeadLetter& letter,
                   std::int64_t now);
  void add_letter(ByteView record);
  void drop_letter(std::uint64_t id);

  RecordLog messages_;
  KeyedLog<std::uint64_t> letters_;  // by id: the row that it had
  Rows rows_;
  std::uint64_t last_row_ = 0;
  std::unordered_map<std::uint64_t, Letter> letters_here_;  // by id
  RetriedOfTopic retried_;                                  // none is empty
  std::uint64_t letter_bytes_ = 0;
  StoreOpened opened_;
  RecordLog::Summary lost_messages_;
  RecordLog::Summary lost_dead_letters_;
};

}  // namespace slamgw
