// SPDX-License-Identifier: Apache-2.0
// `messages.db`: undelivered messages in one SQLite table, readable with the sqlite3 command while
// the daemon does not run. Blocks; used on SqliteStore's thread only.
//
//   messages(row INTEGER PRIMARY KEY, topic TEXT, payload BLOB, qos, retain, stored_at, mesh,
//            received_at)
//
// Write-ahead log with full synchronisation: a commit is durable. `user_version` is 2 (1 had no
// `mesh` and `received_at`); the file is locked for one process. Times: milliseconds since 1970,
// for people and ages. `mesh`: 0 none, 1 BLE, 2 Thread.
#pragma once

#include <cstdint>
#include <string>

#include "daemon/delivery/message_store.hpp"
#include "daemon/storage/sqlite.hpp"

namespace slamgw {

class MessageFile {
 public:
  static constexpr int version = 2;

  /// Opens an existing file of ours, or makes an empty one ours. `max_bytes` (and a transaction
  /// more) bounds it; the log beside it stays within a few MiB. Throws SqliteError and ForeignFile.
  MessageFile(const std::string& path, std::uint64_t max_bytes);

  /// Looks at every row once.
  StoreOpened summary();
  void write(const WriteToStore& write);
  StoreLoaded load(const LoadFromStore& load);

 private:
  void shrink_when_empty();

  SqliteDatabase database_;
  SqliteStatement insert_;
  SqliteStatement erase_;
  SqliteStatement select_;
};

}  // namespace slamgw
