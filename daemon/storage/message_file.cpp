// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/message_file.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sqlite3.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <filesystem>
#include <random>

#include "daemon/storage/store_file.hpp"

namespace slamgw {
namespace {

/// A file larger than this is given back to the file system when its last message has gone.
constexpr std::int64_t pages_kept_when_empty = 64;
/// Room for a transaction that keeps before it forgets, and for the tables' own pages.
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

constexpr const char* create_contents =
    "CREATE TABLE contents(id INTEGER PRIMARY KEY, file INTEGER NOT NULL, commits INTEGER NOT "
    "NULL, messages INTEGER NOT NULL, dead_letters INTEGER NOT NULL, dead_letter_bytes INTEGER NOT "
    "NULL, first_row INTEGER NOT NULL, last_row INTEGER NOT NULL, checksum INTEGER NOT NULL)";

const std::string create_tables = fmt::format(
    "CREATE TABLE messages(row INTEGER PRIMARY KEY, topic TEXT NOT NULL, payload BLOB NOT NULL, "
    "qos INTEGER NOT NULL, retain INTEGER NOT NULL, stored_at INTEGER NOT NULL, "
    "mesh INTEGER NOT NULL DEFAULT 0, received_at INTEGER NOT NULL DEFAULT 0, "
    "checksum INTEGER NOT NULL DEFAULT {}); {}; {}",
    unchecked, DeadLetterTable::create, create_contents);

const std::string upgrade_from_2 =
    fmt::format("ALTER TABLE messages ADD COLUMN checksum INTEGER NOT NULL DEFAULT {}; {}; {}",
                unchecked, DeadLetterTable::create, create_contents);

const std::array<const char*, 2> upgrades{
    "ALTER TABLE messages ADD COLUMN mesh INTEGER NOT NULL DEFAULT 0; "
    "ALTER TABLE messages ADD COLUMN received_at INTEGER NOT NULL DEFAULT 0",
    upgrade_from_2.c_str()};

constexpr std::array<StoreTable, 3> tables{
    {{"messages",
      "'row', 'topic', 'payload', 'qos', 'retain', 'stored_at', 'mesh', 'received_at', 'checksum'",
      9},
     {"dead_letters", DeadLetterTable::columns, DeadLetterTable::column_count},
     {"contents",
      "'id', 'file', 'commits', 'messages', 'dead_letters', 'dead_letter_bytes', 'first_row', "
      "'last_row', 'checksum'",
      9}}};

SqliteDatabase open(const std::string& path, std::uint64_t max_bytes, bool is_known) {
  const StoreFormat format{MessageFile::version, create_tables.c_str(), tables, upgrades,
                           store_page_bytes};
  SqliteDatabase database = open_store_file(path, format, is_known);
  database.execute("PRAGMA synchronous = FULL");
  const std::uint64_t pages = (max_bytes + slack_bytes) / store_page_bytes;
  const std::uint64_t log_pages = std::clamp<std::uint64_t>(pages / 16, 64, 1000);
  database.execute(fmt::format("PRAGMA max_page_count = {}; PRAGMA wal_autocheckpoint = {}; "
                               "PRAGMA journal_size_limit = {}",
                               pages, log_pages, log_pages * store_page_bytes)
                       .c_str());
  return database;
}

/// Something was written to the file or its log, whatever SQLite finds there.
bool has_octets(const std::string& path) {
  std::error_code none;
  const auto size = [&](const std::string& of) {
    const auto bytes = std::filesystem::file_size(of, none);
    return none ? 0 : bytes;
  };
  return size(path) > 0 || size(path + "-wal") > 0;
}

bool is_whole(const MessageRow& row, std::int64_t found_checksum) {
  return found_checksum == unchecked || found_checksum == checksum(row);
}

}  // namespace

MessageFile::MessageFile(const std::string& path, std::uint64_t max_bytes, StoreTally* tally)
    : path_(path),
      database_(open(path, max_bytes, tally && tally->read() && has_octets(path))),
      tally_(tally),
      dead_letters_(database_),
      insert_(database_.prepare("INSERT INTO messages(row, topic, payload, qos, retain, stored_at, "
                                "mesh, received_at, checksum) VALUES(?, ?, ?, ?, ?, ?, ?, ?, ?)")),
      erase_(database_.prepare("DELETE FROM messages WHERE row = ?")),
      first_(database_.prepare("SELECT min(row) FROM messages")),
      select_(database_.prepare("SELECT row, topic, payload, qos, retain, stored_at, mesh, "
                                "received_at, checksum FROM messages WHERE row > ? ORDER BY row "
                                "LIMIT ?")),
      select_one_(database_.prepare("SELECT row, topic, payload, qos, retain, stored_at, mesh, "
                                    "received_at, checksum FROM messages WHERE row = ?")),
      save_(database_.prepare("INSERT OR REPLACE INTO contents(id, file, commits, messages, "
                              "dead_letters, dead_letter_bytes, first_row, last_row, checksum) "
                              "VALUES(1, ?, ?, ?, ?, ?, ?, ?, ?)")) {
  if (database_.query_number("SELECT count(*) FROM contents") == 0) {
    begin_contents();
  } else {
    check_contents();
  }
  database_.keep_log_on_close(false);
  if (tally_) tally_->write(contents_);
}

/// Of a new file, or of one of an older format.
void MessageFile::begin_contents() {
  if (tally_) missed_ = tally_->read();
  StoreContents contents;
  std::random_device random;
  contents.file = static_cast<std::int64_t>(random()) << 31 ^ static_cast<std::int64_t>(random());
  contents.messages = database_.query_number("SELECT count(*) FROM messages");
  contents.first_row = database_.query_number("SELECT min(row) FROM messages");
  contents.last_row = database_.query_number("SELECT max(row) FROM messages");
  SqliteTransaction transaction(database_);
  save(contents);
  transaction.commit();
  contents_ = contents;
}

/// Finds what SQLite takes for a sound file although some of it is missing.
void MessageFile::check_contents() {
  {
    SqliteStatement row = database_.prepare(
        "SELECT file, commits, messages, dead_letters, dead_letter_bytes, first_row, last_row, "
        "checksum FROM contents");
    row.step();
    contents_ = {row.number(0), row.number(1), row.number(2), row.number(3),
                 row.number(4), row.number(5), row.number(6)};
    if (row.number(7) != checksum(contents_)) {
      throw SqliteError(SQLITE_CORRUPT, "its table of contents is damaged");
    }
  }
  const bool is_complete =
      database_.query_number("SELECT count(*) FROM messages") == contents_.messages &&
      database_.query_number("SELECT count(*) FROM dead_letters") == contents_.dead_letters;
  if (!is_complete) throw SqliteError(SQLITE_CORRUPT, "rows are missing");
  const auto tally = tally_ ? tally_->read() : std::nullopt;
  if (!tally) return;
  if (tally->file != contents_.file) {
    missed_ = tally;
  } else if (tally->commits > contents_.commits) {
    throw SqliteError(SQLITE_CORRUPT, fmt::format("its last {} transactions are missing",
                                                  tally->commits - contents_.commits));
  } else if (tally->commits == contents_.commits && *tally != contents_) {
    throw SqliteError(SQLITE_CORRUPT, "it is not what was written last");
  }
}

DeadLetterCounts MessageFile::dead_letters() const {
  return {static_cast<std::size_t>(std::max<std::int64_t>(0, contents_.dead_letters)),
          static_cast<std::uint64_t>(std::max<std::int64_t>(0, contents_.dead_letter_bytes))};
}

StoreOpened MessageFile::summary() {
  StoreOpened opened;
  const std::int64_t now = wall_ms();
  // SQLite knows a blob's length without reading it.
  SqliteStatement rows =
      database_.prepare("SELECT row, topic, length(payload), stored_at FROM messages ORDER BY row");
  while (rows.step()) {
    const std::string_view topic = rows.text(1);
    const auto bytes = stored_cost(topic.size(), static_cast<std::size_t>(rows.number(2)));
    opened.bytes += bytes;
    opened.topics.add(topic);
    opened.shares.add(topic, bytes);
    if (opened.count++ == 0) opened.oldest_age = age_of(rows.number(3), now);
  }
  opened.last_row = static_cast<std::uint64_t>(contents_.last_row);
  opened.dead_letters = dead_letters();
  return opened;
}

void MessageFile::save(const StoreContents& contents) {
  save_
      .bind(contents.file, contents.commits, contents.messages, contents.dead_letters,
            contents.dead_letter_bytes, contents.first_row, contents.last_row,
            std::int64_t{checksum(contents)})
      .run();
}

/// Commits; the file holds `contents` from then on.
void MessageFile::end(SqliteTransaction& transaction, StoreContents& contents) {
  {
    const SqliteStatementReset reset{first_};
    first_.reset();
    first_.step();
    contents.first_row = contents.messages > 0 ? first_.number(0) : contents.last_row + 1;
  }
  ++contents.commits;
  save(contents);
  transaction.commit();
  contents_ = contents;
  if (tally_) tally_->write(contents_);
}

void MessageFile::write(const WriteToStore& write) {
  const std::int64_t now = wall_ms();
  StoreContents contents = contents_;
  SqliteTransaction transaction(database_);
  for (const StoredMessage& stored : write.keep) keep(stored, now, contents);
  for (const SetAside& aside : write.set_aside) set_aside(aside, now, contents);
  for (const std::uint64_t row : write.forget) erase(static_cast<std::int64_t>(row), contents);
  end(transaction, contents);
  if (!write.forget.empty()) shrink_when_empty();
}

/// A dead letter that is sent again keeps the time when it was stored first.
void MessageFile::keep(const StoredMessage& stored, std::int64_t now, StoreContents& contents) {
  std::int64_t stored_at = now;
  if (stored.dead_letter != 0) {
    const auto id = static_cast<std::int64_t>(stored.dead_letter);
    stored_at = dead_letters_.erase(id, contents).value_or(now);
  }
  insert(row_of(stored.row, stored.message, stored_at), contents);
}

void MessageFile::insert(const MessageRow& row, StoreContents& contents) {
  insert_
      .bind(row.row, row.topic, row.payload, row.qos, row.retain, row.stored_at, row.mesh,
            row.received_at, std::int64_t{checksum(row)})
      .run();
  ++contents.messages;
  contents.last_row = std::max(contents.last_row, row.row);
}

void MessageFile::set_aside(const SetAside& aside, std::int64_t now, StoreContents& contents) {
  const SqliteStatementReset reset{select_one_};
  select_one_.reset();
  if (!select_one_.bind(static_cast<std::int64_t>(aside.row)).step()) return;
  const MessageRow row = message_row_at(select_one_);
  const bool is_good = is_whole(row, select_one_.number(8));
  const std::string_view reason = is_good ? aside.reason : damaged_on_disk;
  dead_letters_.add({row, reason, aside.code, aside.tries, now}, contents);
  erase(row.row, contents);
}

void MessageFile::erase(std::int64_t row, StoreContents& contents) {
  erase_.bind(row).run();
  contents.messages -= database_.changed_rows();
}

void MessageFile::drop_messages_above(std::uint64_t row, const std::vector<std::uint64_t>& resent) {
  StoreContents contents = contents_;
  SqliteTransaction transaction(database_);
  for (const std::uint64_t letter : resent) {
    set_aside({letter, "it was not sent again: the disk failed", 0, 0}, wall_ms(), contents);
  }
  database_.execute(fmt::format("DELETE FROM messages WHERE row > {}", row).c_str());
  contents.messages -= database_.changed_rows();
  if (contents != contents_) end(transaction, contents);
}

/// Only SQLite removes the log, at the end.
bool MessageFile::is_in_place() {
  return !database_.has_moved() && access((path_ + "-wal").c_str(), F_OK) == 0;
}

void MessageFile::copy_to(const std::string& path) {
  database_.prepare("VACUUM INTO ?").bind(std::string_view(path)).run();
  const int file = ::open(path.c_str(), O_RDWR | O_CLOEXEC);
  const bool is_durable = file >= 0 && fsync(file) == 0;
  if (file >= 0) close(file);
  if (!is_durable) throw SqliteError(SQLITE_IOERR, "a copy of it cannot be synchronised");
}

void MessageFile::continue_from(StoreContents former) {
  former.messages = former.dead_letters = former.dead_letter_bytes = 0;
  SqliteTransaction transaction(database_);
  end(transaction, former);
}

void MessageFile::restore(const std::vector<SavedRow>& rows) {
  StoreContents contents = contents_;
  SqliteTransaction transaction(database_);
  for (const SavedRow& saved : rows) {
    if (saved.is_dead_letter) {
      dead_letters_.add(saved.row, contents);
    } else {
      insert(saved.row.message, contents);
    }
  }
  end(transaction, contents);
}

void MessageFile::shrink_when_empty() {
  try {
    if (contents_.messages > 0 || contents_.dead_letters > 0) return;
    if (database_.query_number("PRAGMA page_count") <= pages_kept_when_empty) return;
    database_.execute("VACUUM");
    database_.query_number("PRAGMA wal_checkpoint(TRUNCATE)");
  } catch (const SqliteError&) {
    // What was asked is done; a damaged file shows itself at the next request.
  }
}

StoreLoaded MessageFile::load(const LoadFromStore& request) {
  const std::int64_t now = wall_ms();
  StoreLoaded loaded;
  std::vector<DamagedRow> damaged;
  std::size_t bytes = 0;
  const auto is_full = [&] {
    return loaded.messages.size() >= request.max_messages || bytes >= request.max_bytes;
  };
  const auto take = [&](const SqliteStatement& statement) {
    const MessageRow row = message_row_at(statement);
    const auto number = static_cast<std::uint64_t>(row.row);
    bytes += row.topic.size() + row.payload.size();
    if (is_whole(row, statement.number(8))) {
      loaded.messages.push_back({number, message_of(row), age_of(row.stored_at, now)});
      return;
    }
    loaded.damaged.push_back(number);
    loaded.damaged_bytes += stored_cost(row.topic.size(), row.payload.size());
    damaged.push_back({row, std::string(row.topic), {row.payload.begin(), row.payload.end()}});
  };
  if (request.rows.empty()) {
    const SqliteStatementReset reset{select_};
    select_.reset();
    select_.bind(static_cast<std::int64_t>(request.after),
                 static_cast<std::int64_t>(request.max_messages));
    while (!is_full() && select_.step()) take(select_);
  }
  for (std::size_t i = 0; i < request.rows.size() && !is_full(); ++i) {
    const SqliteStatementReset reset{select_one_};
    select_one_.reset();
    if (select_one_.bind(static_cast<std::int64_t>(request.rows[i])).step()) take(select_one_);
  }
  set_damaged_aside(damaged, now);
  return loaded;
}

void MessageFile::set_damaged_aside(std::vector<DamagedRow>& damaged, std::int64_t now) {
  if (damaged.empty()) return;
  try {
    StoreContents contents = contents_;
    SqliteTransaction transaction(database_);
    for (DamagedRow& one : damaged) {
      one.row.topic = one.topic;
      one.row.payload = one.payload;
      dead_letters_.add({one.row, damaged_on_disk, 0, 0, now}, contents);
      erase(one.row.row, contents);
    }
    end(transaction, contents);
  } catch (const SqliteError&) {
    // A disk that takes nothing now leaves them where they are: they are found again by the next
    // process.
  }
}

std::size_t MessageFile::discard(const DeadLetterChoice& choice) {
  StoreContents contents = contents_;
  SqliteTransaction transaction(database_);
  std::size_t count = 0;
  for (const std::uint64_t id : dead_letters_.ids(choice)) {
    if (dead_letters_.erase(static_cast<std::int64_t>(id), contents)) ++count;
  }
  if (count == 0) return 0;
  end(transaction, contents);
  shrink_when_empty();
  return count;
}

}  // namespace slamgw
