// SPDX-License-Identifier: Apache-2.0
// The message store on disk: undelivered messages and dead letters in one record log, by row.
// Blocks; DiskStore uses it on the disk's thread.
//
//   messages/      time of storing, time of receipt (8 octets each), mesh, flags (1 each), topic's
//                  length (2), topic, only for a dead letter: since when it is one (8), reason
//                  code, tries (4 each), reason's length (2), reason; payload
//
// Flags: retain 1, QoS 2 and 4, dead letter 8. Numbers are little-endian, times milliseconds since
// 1970; the mesh is 0 for none, else 1 + Mesh.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "daemon/core/operator_order.hpp"
#include "daemon/delivery/message_store.hpp"
#include "daemon/mqtt/settings.hpp"
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

/// Serves the outbox's requests and operators' orders. Its answers are StoreEvents; a request that
/// throws has none. What damage has destroyed is among the events (MessagesLost).
class MessageLog {
 public:
  /// A longer reason of a dead letter is cut.
  static constexpr std::size_t max_reason_bytes = 200;
  /// Limits of one page of a list of dead letters.
  static constexpr std::size_t page_letters = 256;
  static constexpr std::size_t page_bytes = 256u << 10;
  /// Limit of dead letters that become messages again in one commit.
  static constexpr std::size_t revived_at_once = 64;
  /// Dead letters that a retry passes over because the disk cannot read them.
  static constexpr std::size_t max_unreadable = 16;
  /// Limit of letters that the disk cannot read in one commit: each may take seconds.
  static constexpr std::size_t most_unreadable = 256;

  /// Reads the whole log. Throws LogError, also for records that the disk cannot read, unless
  /// `skips_unreadable`: then these records are lost.
  MessageLog(const StoreSettings& settings, bool skips_unreadable,
             std::function<void(StoreEvent)> post);

  /// Reports the losses at the start, and StoreOpened. Call once.
  void report_opened();

  /// All of these throw LogError. After a failed write no message is kept. A message that the disk
  /// fails to read becomes a dead letter in memory only: the next start finds it as a message.
  void serve(const WriteToStore& write);
  /// `skips_unreadable`: messages that the disk cannot read are lost, as damaged ones are.
  void serve(const LoadFromStore& request, bool skips_unreadable);
  /// Letters that the disk cannot read stay; after `patience` they wait for an operator.
  void serve(const RetryDeadLetters& retry, Duration patience);
  OrderAnswer answer(const ListDeadLetters& order) const;
  OrderAnswer answer(const DiscardOrder& order);
  /// Letters that the disk cannot read stay.
  OrderAnswer answer(const ResendOrder& order);
  /// Restores files of the log that were moved, removed or replaced, and writes erasures that could
  /// not be written before. Call at times, and at the end.
  void repair();

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
  MessageRecord unreadable(const NewDeadLetter& letter, const LogError& error);
  nlohmann::json show_letter(std::uint64_t id, const Letter& letter, bool with_payload) const;
  void put(std::uint64_t row, const MessageRecord& record) {
    log_.put(row, encode_message(record));
  }
  void add_letter(std::uint64_t id, const MessageRecord& record);
  FormerLetter drop_letter(std::uint64_t id);
  static bool stop_retrying(const Letter& letter, std::uint64_t id);
  DeadLetterCounts dead_letters() const { return {letters_.size(), letter_bytes_}; }
  std::vector<std::uint64_t> ids(const DeadLetterChoice& choice) const;
  std::vector<std::uint64_t> retried(const std::string& topic, std::size_t most) const;
  std::size_t revive(std::span<const std::uint64_t>& ids, std::size_t most,
                     const std::string& topic, Duration patience);
  void restore_files();
  void report_damaged(std::size_t messages);
  void notify(Severity severity, std::string text) { post_(Notice{severity, std::move(text), {}}); }

  const StoreSettings settings_;
  const std::function<void(StoreEvent)> post_;
  RecordLog log_;                            // by row
  std::map<std::uint64_t, Letter> letters_;  // by row
  Topics topics_;                            // of letters; none is empty
  std::uint64_t letter_bytes_ = 0;
  std::string why_given_up_;  // the disk's error for letters that wait for an operator now
  StoreOpened opened_;
  RecordLog::Summary lost_;
};

}  // namespace slamgw
