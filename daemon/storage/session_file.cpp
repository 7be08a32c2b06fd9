// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/session_file.hpp"

#include <fmt/format.h>

#include <array>

#include "daemon/storage/store_file.hpp"

namespace slamgw {
namespace {

constexpr std::array<StoreTable, 1> tables{{{"sessions", "'id', 'content'", 2}}};

SqliteDatabase open(const std::string& path) {
  const StoreFormat format{
      SessionFile::version,
      "CREATE TABLE sessions(id TEXT PRIMARY KEY, content BLOB NOT NULL) WITHOUT ROWID", tables};
  SqliteDatabase database = open_store_file(path, format);
  database.execute("PRAGMA synchronous = NORMAL");
  database.execute(
      fmt::format("PRAGMA max_page_count = {}", SessionFile::max_bytes / format.page_bytes)
          .c_str());
  database.keep_log_on_close(false);
  return database;
}

}  // namespace

SessionFile::SessionFile(const std::string& path)
    : database_(open(path)),
      replace_(database_.prepare("INSERT OR REPLACE INTO sessions(id, content) VALUES(?, ?)")),
      erase_(database_.prepare("DELETE FROM sessions WHERE id = ?")) {}

std::vector<SessionStore::Session> SessionFile::load() {
  std::vector<SessionStore::Session> sessions;
  SqliteStatement rows = database_.prepare("SELECT id, content FROM sessions ORDER BY id");
  while (rows.step()) {
    const ByteView content = rows.bytes(1);
    sessions.push_back({std::string(rows.text(0)), Bytes(content.begin(), content.end())});
  }
  return sessions;
}

void SessionFile::write(const std::vector<SessionStore::Change>& changes) {
  SqliteTransaction transaction(database_);
  for (const auto& [id, content] : changes) {
    if (content) {
      replace_.bind(1, std::string_view(id)).bind(2, ByteView(*content)).run();
    } else {
      erase_.bind(1, std::string_view(id)).run();
    }
  }
  transaction.commit();
}

void SessionFile::sync() { database_.query_number("PRAGMA wal_checkpoint(PASSIVE)"); }

}  // namespace slamgw
