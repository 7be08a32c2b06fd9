// SPDX-License-Identifier: Apache-2.0
// `sessions.db`: the sessions of MQTT-SN clients, one row each. Blocks; used by SqliteSessionStore.
//
//   sessions(id TEXT PRIMARY KEY, content BLOB, checksum)    content: CBOR (adapters/mqttsn_udp)
//
// Write-ahead log without a synchronisation for each commit: what is written survives the end of
// the process at once, and a power cut from the next sync() on. `user_version` is 2 (1 had no
// checksums).
#pragma once

#include <string>
#include <vector>

#include "daemon/core/session_store.hpp"
#include "daemon/storage/sqlite.hpp"

namespace slamgw {

class SessionFile {
 public:
  static constexpr int version = 2;
  static constexpr std::uint64_t max_bytes = std::uint64_t{256} << 20;

  struct Loaded {
    std::vector<SessionStore::Session> sessions;
    std::size_t damaged = 0;  ///< not what was written, and gone now
  };

  /// Opens an existing file of ours, or makes an empty one ours. Throws SqliteError and
  /// ForeignFile.
  explicit SessionFile(const std::string& path);

  Loaded load();
  void write(const std::vector<SessionStore::Change>& changes);
  void sync();
  /// Everything is in the file itself when this returns, and durable; the log beside it is empty.
  void move_log_into_file() { database_.move_log_into_file(); }
  /// Closing changes nothing then.
  void leave_log_on_close() { database_.keep_log_on_close(true); }

 private:
  SqliteDatabase database_;
  SqliteStatement replace_;
  SqliteStatement erase_;
};

/// Whole sessions that are left in a damaged file and its log; the newest version of each that is.
/// Used while the file is closed. Throws SqliteError when a file cannot be opened.
struct SavedSessions {
  explicit SavedSessions(const std::string& path);

  std::vector<SessionStore::Change> sessions;
  std::size_t unreadable = 0;  ///< parts that the disk could not read
};

}  // namespace slamgw
