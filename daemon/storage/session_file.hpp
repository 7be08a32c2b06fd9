// SPDX-License-Identifier: Apache-2.0
// `sessions.db`: the sessions of MQTT-SN clients, one row each. Blocks; used by SqliteSessionStore.
//
//   sessions(id TEXT PRIMARY KEY, content BLOB)    content: CBOR (adapters/mqttsn_udp)
//
// Write-ahead log without a synchronisation for each commit: what is written survives the end of
// the process at once, and a power cut from the next sync() on.
#pragma once

#include <string>
#include <vector>

#include "daemon/core/session_store.hpp"
#include "daemon/storage/sqlite.hpp"

namespace slamgw {

class SessionFile {
 public:
  static constexpr int version = 1;
  static constexpr std::uint64_t max_bytes = std::uint64_t{256} << 20;

  /// Opens an existing file of ours, or makes an empty one ours. Throws SqliteError and
  /// ForeignFile.
  explicit SessionFile(const std::string& path);

  std::vector<SessionStore::Session> load();
  void write(const std::vector<SessionStore::Change>& changes);
  void sync();

 private:
  SqliteDatabase database_;
  SqliteStatement replace_;
  SqliteStatement erase_;
};

}  // namespace slamgw
