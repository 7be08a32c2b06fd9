// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/session_file.hpp"

#include <fmt/format.h>

#include <array>
#include <boost/crc.hpp>
#include <map>

#include "daemon/storage/store_file.hpp"
#include "daemon/storage/table_record.hpp"

namespace slamgw {
namespace {

constexpr std::array<StoreTable, 1> tables{{{"sessions", "'id', 'content', 'checksum'", 3}}};

/// The checksum of a session that was written before sessions had one.
constexpr std::int64_t unchecked = -1;

constexpr std::array<const char*, 1> upgrades{
    "ALTER TABLE sessions RENAME TO former; "
    "CREATE TABLE sessions(id TEXT PRIMARY KEY, content BLOB NOT NULL, checksum INTEGER NOT NULL); "
    "INSERT INTO sessions SELECT id, content, -1 FROM former; DROP TABLE former"};

SqliteDatabase open(const std::string& path) {
  const StoreFormat format{SessionFile::version,
                           "CREATE TABLE sessions(id TEXT PRIMARY KEY, content BLOB NOT NULL, "
                           "checksum INTEGER NOT NULL)",
                           tables, upgrades};
  SqliteDatabase database = open_store_file(path, format);
  // Sessions are read at a start and written one by one: 256 KiB of pages, in place of 2 MiB.
  database.execute("PRAGMA synchronous = NORMAL; PRAGMA cache_size = -256");
  database.execute(
      fmt::format("PRAGMA max_page_count = {}", SessionFile::max_bytes / format.page_bytes)
          .c_str());
  database.keep_log_on_close(false);
  return database;
}

/// CRC-32 (ISO-HDLC) of the id, a zero octet, and the content.
std::int64_t checksum(std::string_view id, ByteView content) {
  boost::crc_32_type crc;
  crc.process_bytes(id.data(), id.size());
  crc.process_byte(0);
  crc.process_bytes(content.data(), content.size());
  return crc.checksum();
}

bool is_whole(std::string_view id, ByteView content, std::int64_t found) {
  return found == unchecked || found == checksum(id, content);
}

}  // namespace

SessionFile::SessionFile(const std::string& path)
    : database_(open(path)),
      replace_(database_.prepare(
          "INSERT OR REPLACE INTO sessions(id, content, checksum) VALUES(?, ?, ?)")),
      erase_(database_.prepare("DELETE FROM sessions WHERE id = ?")) {}

SessionFile::Loaded SessionFile::load() {
  Loaded loaded;
  std::vector<SessionStore::Change> damaged;
  SqliteStatement rows =
      database_.prepare("SELECT id, content, checksum FROM sessions ORDER BY id");
  while (rows.step()) {
    const ByteView content = rows.bytes(1);
    if (is_whole(rows.text(0), content, rows.number(2))) {
      loaded.sessions.push_back({std::string(rows.text(0)), Bytes(content.begin(), content.end())});
    } else {
      damaged.push_back({std::string(rows.text(0)), std::nullopt});
    }
  }
  loaded.damaged = damaged.size();
  if (!damaged.empty()) write(damaged);
  return loaded;
}

void SessionFile::write(const std::vector<SessionStore::Change>& changes) {
  SqliteTransaction transaction(database_);
  for (const auto& [id, content] : changes) {
    if (content) {
      replace_.bind(std::string_view(id), ByteView(*content), checksum(id, *content)).run();
    } else {
      erase_.bind(std::string_view(id)).run();
    }
  }
  transaction.commit();
}

void SessionFile::sync() { database_.query_number("PRAGMA wal_checkpoint(PASSIVE)"); }

SavedSessions::SavedSessions(const std::string& path) {
  DatabasePages pages(path, StoreFormat{}.page_bytes);
  std::map<std::string, std::pair<std::uint64_t, Bytes>, std::less<>> newest;  // rank, content
  for_each_record(pages, [&](std::uint32_t version, std::uint32_t, const TableRecord& record) {
    if (shape_of(record) != "tbi") return;
    const std::string_view id = as_text(record.values[0].bytes);
    const ByteView content = record.values[1].bytes;
    if (!is_whole(id, content, record.values[2].number)) return;
    // A session's row gets a new, higher number with each change.
    const std::uint64_t rank = static_cast<std::uint64_t>(record.row) << 1 |
                               (pages.versions()[version].is_current ? 1 : 0);
    auto& best = newest.try_emplace(std::string(id), 0, Bytes{}).first->second;
    if (rank >= best.first) best = {rank, Bytes(content.begin(), content.end())};
  });
  unreadable = pages.unreadable();
  for (auto& [id, session] : newest) sessions.push_back({id, std::move(session.second)});
}

}  // namespace slamgw
