// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/store_file.hpp"

#include <fcntl.h>
#include <fmt/chrono.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <sqlite3.h>
#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <vector>

namespace slamgw {

namespace {

namespace fs = std::filesystem;

[[noreturn]] void fail(const std::string& what) {
  throw std::runtime_error(fmt::format("{}: {}", what, std::strerror(errno)));
}

void run_and_set_version(SqliteDatabase& database, const char* statements, int version) {
  SqliteTransaction transaction(database);
  database.execute(statements);
  database.execute(fmt::format("PRAGMA user_version = {}", version).c_str());
  transaction.commit();
}

void check_tables(SqliteDatabase& database, const StoreFormat& format) {
  for (const StoreTable& table : format.tables) {
    const std::string columns =
        fmt::format("SELECT count(*) FROM pragma_table_info('{}') WHERE name IN ({})", table.name,
                    table.columns);
    if (database.query_number(columns.c_str()) == table.column_count) continue;
    throw SqliteError(SQLITE_CORRUPT, fmt::format("the table {} is not there", table.name));
  }
}

/// The version that is in the file; 0 when it is still empty.
int check_version(SqliteDatabase& database, const StoreFormat& format, bool is_known) {
  const std::int64_t found = database.query_number("PRAGMA user_version");
  const bool is_empty =
      found == 0 && database.query_number("SELECT count(*) FROM sqlite_master") == 0;
  if (found > 0 && found <= format.version) return static_cast<int>(found);
  if (is_empty && !is_known) return 0;
  if (is_known) {
    throw SqliteError(SQLITE_CORRUPT, fmt::format("its format is {}, which cannot be", found));
  }
  if (found == 0) throw ForeignFile("it is some other program's database");
  throw ForeignFile(fmt::format("it was written by a newer version (format {}, this one knows {})",
                                found, format.version));
}

/// True when the file is still empty.
bool check(SqliteDatabase& database, const StoreFormat& format, bool is_known) {
  const int found = check_version(database, format, is_known);
  if (found == 0) return true;
  const std::string answer = database.query_text("PRAGMA quick_check(1)");
  if (answer != "ok") throw SqliteError(SQLITE_CORRUPT, answer);
  for (int version = found; version < format.version; ++version) {
    const auto step = static_cast<std::size_t>(version - 1);
    run_and_set_version(database, format.upgrades[step], version + 1);
  }
  check_tables(database, format);
  return false;
}

/// Renames without replacing. False when `to` exists.
bool rename_to_free_name(const std::string& from, const std::string& to) {
  if (renameat2(AT_FDCWD, from.c_str(), AT_FDCWD, to.c_str(), RENAME_NOREPLACE) == 0) return true;
  if (errno != EEXIST) fail(from);
  return false;
}

std::string name_aside(const std::string& path, const char* word, int attempt) {
  const auto now =
      std::chrono::time_point_cast<std::chrono::seconds>(std::chrono::system_clock::now());
  const std::string name = fmt::format("{}.{}-{:%Y%m%dT%H%M%SZ}", path, word, fmt::gmtime(now));
  return attempt == 0 ? name : fmt::format("{}-{}", name, attempt);
}

/// The files with `word` in their names (empty: with any), the oldest first.
std::vector<fs::path> files_aside(const std::string& path, const std::string& word) {
  const fs::path file(path);
  const std::string start = file.filename().string() + "." + word;
  std::vector<fs::path> found;
  for (const auto& entry : fs::directory_iterator(file.parent_path())) {
    const std::string name = entry.path().filename().string();
    const bool is_log = name.ends_with("-wal") || name.ends_with("-shm");
    if (name.starts_with(start) && name.find("Z", start.size()) != std::string::npos && !is_log)
      found.push_back(entry.path());
  }
  std::sort(found.begin(), found.end());
  return found;
}

void remove_with_log(const fs::path& file) {
  std::error_code ignored;
  fs::remove(file.string() + "-wal", ignored);
  fs::remove(file, ignored);
}

std::uintmax_t size_or_nothing(const std::string& path) {
  std::error_code error;
  const std::uintmax_t size = fs::file_size(path, error);
  return error ? 0 : size;
}

}  // namespace

void make_store_directory(const std::string& directory) {
  std::error_code error;
  std::filesystem::create_directories(std::filesystem::path(directory).parent_path(), error);
  if (mkdir(directory.c_str(), 0700) != 0 && errno != EEXIST) fail(directory);
}

/// SQLite would make it readable for everybody; its log takes over the mode.
void make_store_file(const std::string& directory, const std::string& path) {
  make_store_directory(directory);
  const int file = ::open(path.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  if (file < 0) {
    if (errno != EEXIST) fail(path);
    chmod(path.c_str(), 0600);
    return;
  }
  close(file);
  synchronise_directory_of(path);
}

void synchronise_directory_of(const std::string& path) {
  const std::string directory = std::filesystem::path(path).parent_path();
  const int entry = ::open(directory.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (entry < 0) return;
  fsync(entry);
  close(entry);
}

std::string words_for(const SqliteError& error) {
  return error.is_locked()
             ? "another process has it open, perhaps a second slam-gatewayd: end one of the two"
             : error.what();
}

SqliteDatabase open_store_file(const std::string& path, const StoreFormat& format, bool is_known) {
  SqliteDatabase database(path, store_busy_wait_ms);
  database.keep_log_on_close(true);
  database.execute("PRAGMA locking_mode = EXCLUSIVE");
  const bool is_empty = check(database, format, is_known);
  if (is_empty) database.execute(fmt::format("PRAGMA page_size = {}", format.page_bytes).c_str());
  if (database.query_text("PRAGMA journal_mode = WAL") != "wal") {
    throw SqliteError(SQLITE_IOERR, "the file system does not allow a write-ahead log");
  }
  // What was deleted does not come back when pages are searched for messages after damage.
  database.execute("PRAGMA temp_store = MEMORY; PRAGMA secure_delete = ON");
  if (is_empty) run_and_set_version(database, format.create, format.version);
  return database;
}

void make_room_for_copy(const std::string& path) {
  const std::uintmax_t needed = size_or_nothing(path) + size_or_nothing(path + "-wal");
  for (const fs::path& oldest : files_aside(path, damaged_word)) {
    std::error_code error;
    if (fs::space(oldest.parent_path(), error).available > needed || error) return;
    remove_with_log(oldest);
  }
}

std::string put_store_file_aside(const std::string& path, const char* word) {
  const std::vector<fs::path> damaged = files_aside(path, damaged_word);
  for (std::size_t i = 0; i + max_damaged_files <= damaged.size(); ++i) remove_with_log(damaged[i]);
  if (files_aside(path, {}).size() >= max_files_aside) {
    throw std::runtime_error(fmt::format(
        "{} files that were put aside lie beside {}; move them away", max_files_aside, path));
  }
  for (int attempt = 0;; ++attempt) {
    const std::string aside = name_aside(path, word, attempt);
    if (access(aside.c_str(), F_OK) == 0) continue;
    // The log first: beside another file SQLite would play it into that one.
    const std::string log = path + "-wal";
    if (access(log.c_str(), F_OK) == 0 && !rename_to_free_name(log, aside + "-wal")) continue;
    if (access(path.c_str(), F_OK) != 0) return {};
    if (!rename_to_free_name(path, aside)) continue;
    synchronise_directory_of(path);
    return aside;
  }
}

}  // namespace slamgw
