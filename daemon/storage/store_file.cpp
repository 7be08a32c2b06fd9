// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/store_file.hpp"

#include <fcntl.h>
#include <fmt/chrono.h>
#include <fmt/format.h>
#include <sqlite3.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>

namespace slamgw {
namespace {

[[noreturn]] void fail(const std::string& what) {
  throw std::runtime_error(fmt::format("{}: {}", what, std::strerror(errno)));
}

void make_directory(const std::string& directory) {
  std::error_code error;
  std::filesystem::create_directories(std::filesystem::path(directory).parent_path(), error);
  if (mkdir(directory.c_str(), 0700) != 0 && errno != EEXIST) fail(directory);
}

void run_and_set_version(SqliteDatabase& database, const char* statements, int version) {
  SqliteTransaction transaction(database);
  database.execute(statements);
  database.execute(fmt::format("PRAGMA user_version = {}", version).c_str());
  transaction.commit();
}

/// True when the file is still empty.
bool check(SqliteDatabase& database, const StoreFormat& format) {
  const std::int64_t found = database.query_number("PRAGMA user_version");
  if (found > format.version) {
    throw ForeignFile(fmt::format(
        "it was written by a newer version (format {}, this one knows {})", found, format.version));
  }
  if (found == 0) {
    if (database.query_number("SELECT count(*) FROM sqlite_master") == 0) return true;
    throw ForeignFile("it is some other program's database");
  }
  const std::string answer = database.query_text("PRAGMA quick_check(1)");
  if (answer != "ok") throw SqliteError(SQLITE_CORRUPT, answer);
  if (found < format.version) run_and_set_version(database, format.upgrade, format.version);
  const std::string columns =
      fmt::format("SELECT count(*) FROM pragma_table_info('{}') WHERE name IN ({})", format.table,
                  format.columns);
  if (database.query_number(columns.c_str()) != format.column_count) {
    throw SqliteError(SQLITE_CORRUPT, fmt::format("the table {} is not there", format.table));
  }
  return false;
}

}  // namespace

/// SQLite would make it readable for everybody; its log takes over the mode. The directory is
/// synchronised, so that a new file survives a power cut.
void make_store_file(const std::string& directory, const std::string& path) {
  make_directory(directory);
  const int file = ::open(path.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  if (file < 0) {
    if (errno != EEXIST) fail(path);
    chmod(path.c_str(), 0600);
    return;
  }
  close(file);
  const int entry = ::open(directory.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (entry < 0) return;
  fsync(entry);
  close(entry);
}

SqliteDatabase open_store_file(const std::string& path, const StoreFormat& format) {
  SqliteDatabase database(path, store_busy_wait_ms);
  database.keep_log_on_close(true);
  database.execute("PRAGMA locking_mode = EXCLUSIVE");
  const bool is_empty = check(database, format);
  database.keep_log_on_close(false);
  if (is_empty) database.execute(fmt::format("PRAGMA page_size = {}", format.page_bytes).c_str());
  if (database.query_text("PRAGMA journal_mode = WAL") != "wal") {
    throw SqliteError(SQLITE_IOERR, "the file system does not allow a write-ahead log");
  }
  database.execute("PRAGMA temp_store = MEMORY");
  if (is_empty) run_and_set_version(database, format.create, format.version);
  return database;
}

std::string move_store_file_aside(const std::string& path) {
  const auto now =
      std::chrono::time_point_cast<std::chrono::seconds>(std::chrono::system_clock::now());
  const std::string aside = fmt::format("{}.corrupt-{:%Y%m%dT%H%M%SZ}", path, fmt::gmtime(now));
  for (const char* const part : {"-wal", "-shm", ""}) {
    std::error_code ignored;  // the log need not exist; what cannot be moved cannot be opened
    std::filesystem::rename(path + part, aside + part, ignored);
  }
  return aside;
}

}  // namespace slamgw
