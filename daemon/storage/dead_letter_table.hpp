// SPDX-License-Identifier: Apache-2.0
// Dead letters: the table of messages that were set aside. Part of MessageFile, whose transactions
// its changes belong to. All members throw SqliteError.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "daemon/delivery/message_store.hpp"
#include "daemon/storage/message_row.hpp"
#include "daemon/storage/sqlite.hpp"

namespace slamgw {

/// A dead letter as operators see it.
struct ListedDeadLetter {
  DeadLetter letter;
  std::string reason;
  int code = 0;  ///< MQTT 5 reason code; 0: there is none
  std::uint32_t tries = 0;
  WallTime stored_at{};
  WallTime set_aside_at{};
  bool is_damaged = false;  ///< not what was set aside: its checksum does not match
};

/// Which dead letters an operator means: those with these ids or of this topic; all when both are
/// empty.
struct DeadLetterChoice {
  std::vector<std::uint64_t> ids;
  std::string topic;
  bool operator==(const DeadLetterChoice&) const = default;
};

class DeadLetterTable {
 public:
  static constexpr const char* create =
      "CREATE TABLE dead_letters(id INTEGER PRIMARY KEY, topic TEXT NOT NULL, payload BLOB NOT "
      "NULL, qos INTEGER NOT NULL, retain INTEGER NOT NULL, stored_at INTEGER NOT NULL, mesh "
      "INTEGER NOT NULL, received_at INTEGER NOT NULL, reason TEXT NOT NULL, code INTEGER NOT "
      "NULL, tries INTEGER NOT NULL, set_aside_at INTEGER NOT NULL, checksum INTEGER NOT NULL)";
  static constexpr const char* columns =
      "'id', 'topic', 'payload', 'qos', 'retain', 'stored_at', 'mesh', 'received_at', 'reason', "
      "'code', 'tries', 'set_aside_at', 'checksum'";
  static constexpr int column_count = 13;
  /// A longer reason is cut.
  static constexpr std::size_t max_reason_bytes = 200;

  explicit DeadLetterTable(SqliteDatabase& database);

  /// These change `contents` with the table.
  void add(const DeadLetterRow& letter, StoreContents& contents);
  /// When it was stored as a message; nothing when there is no such dead letter.
  std::optional<std::int64_t> erase(std::int64_t id, StoreContents& contents);

  /// The first `max_count` of them with ids above `after`, about `max_bytes` at most, but one if
  /// there is one.
  std::vector<ListedDeadLetter> list(const DeadLetterChoice& choice, std::uint64_t after,
                                     std::size_t max_count, std::size_t max_bytes);

 private:
  bool has(std::int64_t id);
  ListedDeadLetter current() const;

  SqliteDatabase& database_;
  SqliteStatement insert_;
  SqliteStatement find_;
  SqliteStatement erase_;
  SqliteStatement select_;
};

}  // namespace slamgw
