// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/message_file.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>

#include "daemon/storage/store_file.hpp"

namespace slamgw {
namespace {

/// A file larger than this is given back to the file system when its last message has gone.
constexpr std::int64_t pages_kept_when_empty = 64;
/// Room for a transaction that keeps before it forgets, and for the table's own pages.
constexpr std::uint64_t slack_bytes = 4u << 20;

std::int64_t wall_ms() {
  const auto now = std::chrono::system_clock::now().time_since_epoch();
  return std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
}

/// Time since `stored_at`; a clock that was set back makes nothing younger than now, a damaged file
/// nothing older than the epoch.
Duration age_of(std::int64_t stored_at, std::int64_t now) {
  return std::chrono::milliseconds{
      std::max<std::int64_t>(0, now - std::max<std::int64_t>(0, stored_at))};
}

constexpr StoreFormat format{
    MessageFile::version,
    "CREATE TABLE messages(row INTEGER PRIMARY KEY, topic TEXT NOT NULL, payload BLOB NOT NULL, "
    "qos INTEGER NOT NULL, retain INTEGER NOT NULL, stored_at INTEGER NOT NULL, "
    "mesh INTEGER NOT NULL DEFAULT 0, received_at INTEGER NOT NULL DEFAULT 0)",
    "messages",
    "'row', 'topic', 'payload', 'qos', 'retain', 'stored_at', 'mesh', 'received_at'",
    8,
    "ALTER TABLE messages ADD COLUMN mesh INTEGER NOT NULL DEFAULT 0; "
    "ALTER TABLE messages ADD COLUMN received_at INTEGER NOT NULL DEFAULT 0",
    store_page_bytes};

SqliteDatabase open(const std::string& path, std::uint64_t max_bytes) {
  SqliteDatabase database = open_store_file(path, format);
  database.execute("PRAGMA synchronous = FULL");
  const std::uint64_t pages = (max_bytes + slack_bytes) / store_page_bytes;
  const std::uint64_t log_pages = std::clamp<std::uint64_t>(pages / 16, 64, 1000);
  database.execute(fmt::format("PRAGMA max_page_count = {}; PRAGMA wal_autocheckpoint = {}; "
                               "PRAGMA journal_size_limit = {}",
                               pages, log_pages, log_pages * store_page_bytes)
                       .c_str());
  return database;
}

std::int64_t mesh_number(const BrokerMessage& message) {
  if (!message.provenance) return 0;
  return message.provenance->mesh == Mesh::ble ? 1 : 2;
}

std::int64_t received_ms(const BrokerMessage& message) {
  if (!message.provenance) return 0;
  const auto since_1970 = message.provenance->received_at.time_since_epoch();
  return std::chrono::duration_cast<std::chrono::milliseconds>(since_1970).count();
}

std::optional<Provenance> provenance_of(std::int64_t mesh, std::int64_t received_at) {
  if (mesh == 0) return std::nullopt;
  return Provenance{mesh == 1 ? Mesh::ble : Mesh::thread,
                    WallTime{std::chrono::milliseconds{received_at}}};
}

/// A statement that reads must not keep its transaction, whatever happens.
struct ResetAtEnd {
  SqliteStatement& statement;
  ~ResetAtEnd() { statement.reset(); }
};

}  // namespace

MessageFile::MessageFile(const std::string& path, std::uint64_t max_bytes)
    : database_(open(path, max_bytes)),
      insert_(database_.prepare("INSERT INTO messages(row, topic, payload, qos, retain, stored_at, "
                                "mesh, received_at) VALUES(?, ?, ?, ?, ?, ?, ?, ?)")),
      erase_(database_.prepare("DELETE FROM messages WHERE row = ?")),
      select_(database_.prepare("SELECT row, topic, payload, qos, retain, stored_at, mesh, "
                                "received_at FROM messages WHERE row > ? ORDER BY row LIMIT ?")) {}

StoreOpened MessageFile::summary() {
  StoreOpened opened;
  const std::int64_t now = wall_ms();
  // SQLite tells a blob's length without reading it.
  SqliteStatement rows =
      database_.prepare("SELECT row, topic, length(payload), stored_at FROM messages ORDER BY row");
  while (rows.step()) {
    const std::string_view topic = rows.text(1);
    opened.last_row = static_cast<std::uint64_t>(rows.number(0));
    opened.bytes += stored_cost(topic.size(), static_cast<std::size_t>(rows.number(2)));
    opened.topics.add(topic);
    if (opened.count++ == 0) opened.oldest_age = age_of(rows.number(3), now);
  }
  return opened;
}

void MessageFile::write(const WriteToStore& write) {
  const std::int64_t now = wall_ms();
  SqliteTransaction transaction(database_);
  for (const StoredMessage& stored : write.keep) {
    insert_.bind(1, static_cast<std::int64_t>(stored.row))
        .bind(2, std::string_view(stored.message.topic))
        .bind(3, ByteView(stored.message.payload))
        .bind(4, static_cast<std::int64_t>(stored.message.qos))
        .bind(5, std::int64_t{stored.message.retain})
        .bind(6, now)
        .bind(7, mesh_number(stored.message))
        .bind(8, received_ms(stored.message))
        .run();
  }
  for (const std::uint64_t row : write.forget) {
    erase_.bind(1, static_cast<std::int64_t>(row)).run();
  }
  transaction.commit();
  if (!write.forget.empty()) shrink_when_empty();
}

void MessageFile::shrink_when_empty() {
  try {
    if (database_.query_number("SELECT EXISTS(SELECT 1 FROM messages)") != 0) return;
    if (database_.query_number("PRAGMA page_count") <= pages_kept_when_empty) return;
    database_.execute("VACUUM");
    database_.query_number("PRAGMA wal_checkpoint(TRUNCATE)");
  } catch (const SqliteError&) {
    // What was asked is done; a damaged file shows itself at the next request.
  }
}

StoreLoaded MessageFile::load(const LoadFromStore& load) {
  const std::int64_t now = wall_ms();
  StoreLoaded loaded;
  const ResetAtEnd at_end{select_};
  select_.reset();
  select_.bind(1, static_cast<std::int64_t>(load.after))
      .bind(2, static_cast<std::int64_t>(load.max_messages));
  std::size_t bytes = 0;
  while (bytes < load.max_bytes && select_.step()) {
    StoredMessage stored;
    stored.row = static_cast<std::uint64_t>(select_.number(0));
    stored.message.topic = select_.text(1);
    const ByteView payload = select_.bytes(2);
    stored.message.payload.assign(payload.begin(), payload.end());
    stored.message.qos = select_.number(3) == 2 ? Qos::exactly_once : Qos::at_least_once;
    stored.message.retain = select_.number(4) != 0;
    stored.age = age_of(select_.number(5), now);
    stored.message.provenance = provenance_of(select_.number(6), select_.number(7));
    bytes += stored.message.topic.size() + stored.message.payload.size();
    loaded.messages.push_back(std::move(stored));
  }
  return loaded;
}

}  // namespace slamgw
