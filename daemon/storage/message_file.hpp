// SPDX-License-Identifier: Apache-2.0
// `messages.db`: undelivered messages and dead letters in SQLite tables, readable with the sqlite3
// command while the daemon does not run. Blocks; used on SqliteStore's thread only.
//
//   messages(row INTEGER PRIMARY KEY, topic, payload, qos, retain, stored_at, mesh, received_at,
//            checksum)
//   dead_letters(id INTEGER PRIMARY KEY, ..., reason, code, tries, set_aside_at, checksum)
//   contents: one row, what the others hold (StoreContents)
//
// Write-ahead log with full synchronisation: a commit is durable. Each row has a checksum, and the
// tally beside the file says what its last commit left (store_tally.hpp), so that what damage took
// is noticed and counted. `user_version` is 3 (1 had no `mesh` and `received_at`, 2 no checksums
// and no dead letters); the file is locked for one process.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "daemon/delivery/message_store.hpp"
#include "daemon/storage/dead_letter_table.hpp"
#include "daemon/storage/message_row.hpp"
#include "daemon/storage/sqlite.hpp"
#include "daemon/storage/store_tally.hpp"

namespace slamgw {

class MessageFile {
 public:
  static constexpr int version = 3;

  /// Opens an existing file of ours, or makes an empty one ours. `max_bytes` (and a transaction
  /// more) bounds it; the log beside it stays within a few MiB. `tally`: kept up to date, outlives
  /// this; may be null. Throws SqliteError (is_corrupt() also when the file holds less than it
  /// should) and ForeignFile.
  MessageFile(const std::string& path, std::uint64_t max_bytes, StoreTally* tally);
  MessageFile(const MessageFile&) = delete;
  MessageFile& operator=(const MessageFile&) = delete;

  /// Looks at every row once.
  StoreOpened summary();
  DeadLetterCounts dead_letters() const;
  /// What the tally knew of another file that was here before; nothing when it was this one.
  const std::optional<StoreContents>& missed() const { return missed_; }

  /// One transaction: all of it is durable when this returns.
  void write(const WriteToStore& write);
  /// Rows that are not what was stored are set aside.
  StoreLoaded load(const LoadFromStore& request);
  /// Removes messages above `row`: their write was reported as failed. Those that
  /// were dead letters before (`resent`) are dead letters again.
  void drop_messages_above(std::uint64_t row, const std::vector<std::uint64_t>& resent);

  /// The file is where it was opened, and its log beside it.
  bool is_in_place();
  /// Writes a copy over an empty file; durable when this returns.
  void copy_to(const std::string& path);
  /// Closing changes nothing then.
  void leave_log_on_close() { database_.keep_log_on_close(true); }

  /// Of a new file that replaces a damaged one: what that one held, so that its numbers and the
  /// tally go on.
  void continue_from(StoreContents former);
  /// Adds what was saved, under its numbers.
  void restore(const std::vector<SavedRow>& rows);
  /// Everything is in the file itself when this returns, and durable; the log beside it is empty.
  void move_log_into_file() { database_.move_log_into_file(); }

  /// For reading.
  DeadLetterTable& dead_letter_table() { return dead_letters_; }
  /// Those that are chosen are gone when this returns; how many they were.
  std::size_t discard(const DeadLetterChoice& choice);

 private:
  struct DamagedRow {
    MessageRow row;
    std::string topic;
    Bytes payload;
  };
  void begin_contents();
  void check_contents();
  void save(const StoreContents& contents);
  void end(SqliteTransaction& transaction, StoreContents& contents);
  void insert(const MessageRow& row, StoreContents& contents);
  void keep(const StoredMessage& stored, std::int64_t now, StoreContents& contents);
  void set_aside(const SetAside& aside, std::int64_t now, StoreContents& contents);
  void erase(std::int64_t row, StoreContents& contents);
  void set_damaged_aside(std::vector<DamagedRow>& damaged, std::int64_t now);
  void shrink_when_empty();

  const std::string path_;
  SqliteDatabase database_;
  StoreTally* tally_;
  DeadLetterTable dead_letters_;
  SqliteStatement insert_;
  SqliteStatement erase_;
  SqliteStatement first_;
  SqliteStatement select_;
  SqliteStatement select_one_;
  SqliteStatement save_;
  StoreContents contents_;
  std::optional<StoreContents> missed_;
};

}  // namespace slamgw
