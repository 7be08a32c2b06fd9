// SPDX-License-Identifier: Apache-2.0
// SQLite's C API with owners and exceptions: a database and its statements. Used by the stores'
// files, each on one thread.
#pragma once

#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <string_view>

#include "daemon/core/bytes.hpp"

struct sqlite3;
struct sqlite3_stmt;

namespace slamgw {

class SqliteError : public std::runtime_error {
 public:
  /// `code`: a primary result code (SQLITE_FULL, SQLITE_CORRUPT, ...).
  SqliteError(int code, const std::string& text) : std::runtime_error(text), code_(code) {}
  /// What was read is no database, or a damaged one. A disk that fails to read can look like that.
  bool is_corrupt() const;
  /// The disk or the file system failed.
  bool is_io_error() const;
  /// Another process has it open.
  bool is_locked() const;

 private:
  int code_;
};

/// A prepared statement. Columns are counted from 0, as SQLite counts them. All members throw
/// SqliteError.
class SqliteStatement {
 public:
  SqliteStatement(sqlite3* database, const char* sql);

  /// One value for each parameter, in order: numbers, texts, octets. Texts and octets must outlive
  /// the next step().
  template <class... Values>
  SqliteStatement& bind(const Values&... values) {
    int parameter = 0;
    (bind_at(++parameter, values), ...);
    return *this;
  }
  /// True when there is a row.
  bool step();
  /// Runs a statement without rows and makes it ready for the next time.
  void run();
  void reset();

  std::int64_t number(int column) const;
  std::string_view text(int column) const;  ///< valid until the next step() or reset()
  ByteView bytes(int column) const;         ///< the same

 private:
  struct Finalize {
    void operator()(sqlite3_stmt* statement) const;
  };
  void bind_at(int parameter, std::int64_t value);
  void bind_at(int parameter, std::string_view text);
  void bind_at(int parameter, ByteView bytes);
  void check(int result) const;
  std::unique_ptr<sqlite3_stmt, Finalize> statement_;
};

/// A statement that reads must not keep its transaction, whatever happens.
struct SqliteStatementReset {
  SqliteStatement& statement;
  ~SqliteStatementReset() { statement.reset(); }
};

class SqliteDatabase {
 public:
  /// An existing file, which may be empty. `busy_wait_ms`: how long another process is waited for.
  SqliteDatabase(const std::string& path, int busy_wait_ms);

  void execute(const char* sql);
  std::int64_t query_number(const char* sql);
  std::string query_text(const char* sql);
  /// The file is no longer where it was opened, or another file is there.
  bool has_moved() const;
  /// Rows that the last statement inserted or deleted.
  std::int64_t changed_rows() const;
  SqliteStatement prepare(const char* sql) { return {database_.get(), sql}; }
  /// Everything is in the file itself when this returns, and durable; its log is empty.
  void move_log_into_file();
  /// Leaves the write-ahead log as it is when this closes, so that nothing at all changes.
  void keep_log_on_close(bool keep);

 private:
  struct Close {
    void operator()(sqlite3* database) const;
  };
  std::unique_ptr<sqlite3, Close> database_;
};

/// Rolls back unless commit() was reached.
class SqliteTransaction {
 public:
  explicit SqliteTransaction(SqliteDatabase& database);
  ~SqliteTransaction();
  SqliteTransaction(const SqliteTransaction&) = delete;
  SqliteTransaction& operator=(const SqliteTransaction&) = delete;
  void commit();

 private:
  SqliteDatabase& database_;
  bool is_committed_ = false;
};

}  // namespace slamgw
