// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/sqlite.hpp"

#include <sqlite3.h>

namespace slamgw {
namespace {

[[noreturn]] void fail(sqlite3* database) {
  const int code = sqlite3_errcode(database) & 0xff;
  std::string text = sqlite3_errmsg(database);
  if (code == SQLITE_FULL) text += ": free space there (see df -h)";
  throw SqliteError(code, text);
}

/// In place of 20 pages for each file in advance, which are more than most stores ever need.
bool take_pages_when_needed() {
  return sqlite3_config(SQLITE_CONFIG_PAGECACHE, nullptr, 0, 0) == SQLITE_OK;
}

}  // namespace

bool SqliteError::is_corrupt() const { return code_ == SQLITE_CORRUPT || code_ == SQLITE_NOTADB; }

bool SqliteError::is_io_error() const { return code_ == SQLITE_IOERR; }

bool SqliteError::is_locked() const { return code_ == SQLITE_BUSY || code_ == SQLITE_LOCKED; }

void SqliteStatement::Finalize::operator()(sqlite3_stmt* statement) const {
  sqlite3_finalize(statement);
}

SqliteStatement::SqliteStatement(sqlite3* database, const char* sql) {
  sqlite3_stmt* statement = nullptr;
  if (sqlite3_prepare_v2(database, sql, -1, &statement, nullptr) != SQLITE_OK) fail(database);
  statement_.reset(statement);
}

void SqliteStatement::check(int result) const {
  if (result != SQLITE_OK) fail(sqlite3_db_handle(statement_.get()));
}

void SqliteStatement::bind_at(int parameter, std::int64_t value) {
  check(sqlite3_bind_int64(statement_.get(), parameter, value));
}

void SqliteStatement::bind_at(int parameter, std::string_view text) {
  const char* const first = text.empty() ? "" : text.data();  // a null pointer would bind NULL
  check(sqlite3_bind_text64(statement_.get(), parameter, first, text.size(), SQLITE_STATIC,
                            SQLITE_UTF8));
}

void SqliteStatement::bind_at(int parameter, ByteView bytes) {
  if (bytes.empty()) {  // a null pointer would bind NULL
    check(sqlite3_bind_zeroblob(statement_.get(), parameter, 0));
  } else {
    check(sqlite3_bind_blob64(statement_.get(), parameter, bytes.data(), bytes.size(),
                              SQLITE_STATIC));
  }
}

bool SqliteStatement::step() {
  const int result = sqlite3_step(statement_.get());
  if (result == SQLITE_ROW) return true;
  if (result != SQLITE_DONE) fail(sqlite3_db_handle(statement_.get()));
  return false;
}

void SqliteStatement::run() {
  reset();
  step();
  reset();
}

void SqliteStatement::reset() {
  // The result repeats the error of the last step, which was thrown then.
  sqlite3_reset(statement_.get());
}

std::int64_t SqliteStatement::number(int column) const {
  return sqlite3_column_int64(statement_.get(), column);
}

std::string_view SqliteStatement::text(int column) const { return as_text(bytes(column)); }

ByteView SqliteStatement::bytes(int column) const {
  const void* const first = sqlite3_column_blob(statement_.get(), column);
  const int size = sqlite3_column_bytes(statement_.get(), column);
  return {static_cast<const std::uint8_t*>(first), static_cast<std::size_t>(size)};
}

void SqliteDatabase::Close::operator()(sqlite3* database) const { sqlite3_close_v2(database); }

SqliteDatabase::SqliteDatabase(const std::string& path, int busy_wait_ms) {
  [[maybe_unused]] static const bool once = take_pages_when_needed();
  sqlite3* database = nullptr;
  const int flags = SQLITE_OPEN_READWRITE | SQLITE_OPEN_NOMUTEX;
  const int result = sqlite3_open_v2(path.c_str(), &database, flags, nullptr);
  database_.reset(database);
  if (!database) throw SqliteError(SQLITE_NOMEM, "out of memory");
  if (result != SQLITE_OK) fail(database);
  sqlite3_busy_timeout(database, busy_wait_ms);
}

void SqliteDatabase::execute(const char* sql) {
  if (sqlite3_exec(database_.get(), sql, nullptr, nullptr, nullptr) != SQLITE_OK) {
    fail(database_.get());
  }
}

std::int64_t SqliteDatabase::query_number(const char* sql) {
  SqliteStatement statement = prepare(sql);
  return statement.step() ? statement.number(0) : 0;
}

std::string SqliteDatabase::query_text(const char* sql) {
  SqliteStatement statement = prepare(sql);
  return statement.step() ? std::string(statement.text(0)) : std::string();
}

std::int64_t SqliteDatabase::changed_rows() const { return sqlite3_changes64(database_.get()); }

bool SqliteDatabase::has_moved() const {
  int has_moved = 0;
  sqlite3_file_control(database_.get(), "main", SQLITE_FCNTL_HAS_MOVED, &has_moved);
  return has_moved != 0;
}

void SqliteDatabase::move_log_into_file() {
  if (query_number("PRAGMA wal_checkpoint(TRUNCATE)") == 0) return;
  throw SqliteError(SQLITE_BUSY, "the log cannot be moved into the file");
}

void SqliteDatabase::keep_log_on_close(bool keep) {
  sqlite3_db_config(database_.get(), SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, keep ? 1 : 0, nullptr);
}

SqliteTransaction::SqliteTransaction(SqliteDatabase& database) : database_(database) {
  database_.execute("BEGIN IMMEDIATE");
}

SqliteTransaction::~SqliteTransaction() {
  if (is_committed_) return;
  try {
    database_.execute("ROLLBACK");
  } catch (const SqliteError&) {
    // SQLite has rolled back by itself, as it does after a full disk or an I/O error
  }
}

void SqliteTransaction::commit() {
  database_.execute("COMMIT");
  is_committed_ = true;
}

}  // namespace slamgw
