// SPDX-License-Identifier: Apache-2.0
// Dead letters: the table of messages that were set aside. Part of MessageFile, whose transactions
// its changes belong to. All members throw SqliteError.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/operator_order.hpp"
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
  bool is_damaged = false;  ///< its message is not what a robot sent
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

  /// The first of `topic` (empty: of any) with ids above `after`: at most `max_count`, about
  /// `max_bytes`, but one if there is one.
  std::vector<ListedDeadLetter> list(const std::string& topic, std::uint64_t after,
                                     std::size_t max_count, std::size_t max_bytes);
  std::optional<ListedDeadLetter> find(std::uint64_t id);
  /// Those that are there, by the time when they were stored first.
  std::vector<std::uint64_t> ids(const DeadLetterChoice& choice);

 private:
  bool has(std::int64_t id);

  SqliteStatement insert_;
  SqliteStatement sizes_;
  SqliteStatement erase_;
  SqliteStatement select_;
  SqliteStatement ids_;
};

}  // namespace slamgw
