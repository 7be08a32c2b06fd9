// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/sqlite_session_store.hpp"

#include <fmt/format.h>
#include <boost/crc.hpp>

#include <array>
#include <future>
#include <map>
#include <thread>
#include <utility>

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

SqliteSessionStore::SqliteSessionStore(boost::asio::io_context& io, std::string directory,
                                       std::function<void(Notice)> on_notice,
                                       StorePatience patience)
    : directory_(std::move(directory)),
      path_(directory_ + "/sessions.db"),
      replacement_(path_),
      patience_(patience),
      on_notice_(std::move(on_notice)),
      retry_timer_(io),
      verdict_(patience.unreadable),
      thread_(io),
      sync_timer_(thread_.context()) {}

SqliteSessionStore::~SqliteSessionStore() { stop(); }

std::vector<SessionStore::Session> SqliteSessionStore::load() {
  std::promise<std::vector<Session>> loaded;
  thread_.run([&] { loaded.set_value(open_and_load()); });
  return loaded.get_future().get();
}

void SqliteSessionStore::save(std::vector<Change> changes) {
  for (Change& change : changes) changes_[std::move(change.id)] = std::move(change.content);
  if (!is_writing_) write_changes();
}

bool SqliteSessionStore::is_busy() const { return is_writing_ || !changes_.empty(); }

void SqliteSessionStore::stop() {
  retry_timer_.cancel();
  if (!changes_.empty()) write_changes();
  thread_.run([this] { file_.reset(); });  // synchronises
  thread_.stop();
}

/// All that have come together go in one transaction, and as many as come meanwhile in the next.
void SqliteSessionStore::write_changes() {
  is_writing_ = true;
  thread_.run([this, changes = std::exchange(changes_, {})]() mutable {
    const bool is_written = write(changes);
    thread_.report([this, is_written, changes = std::move(changes)]() mutable {
      on_written(is_written, std::move(changes));
    });
  });
}

void SqliteSessionStore::on_written(bool is_written, Changes changes) {
  if (is_written) {
    is_writing_ = false;
    if (!changes_.empty()) write_changes();
  } else {
    changes_.merge(std::move(changes));  // newer ones of the same session stay
    retry_timer_.expires_after(patience_.reopen);
    retry_timer_.async_wait([this](boost::system::error_code error) {
      if (!error) write_changes();
    });
  }
  if (on_written_) on_written_(is_written);
}

/// A disk that fails for a moment is waited for: sessions are worth a start that takes longer.
std::vector<SessionStore::Session> SqliteSessionStore::open_and_load() {
  const auto give_up_at = std::chrono::steady_clock::now() + patience_.opening;
  while (!open()) {
    if (!is_doubtful_ || std::chrono::steady_clock::now() > give_up_at) {
      report_failure();
      return {};
    }
    std::this_thread::sleep_for(patience_.check);
  }
  return std::move(loaded_);
}

bool SqliteSessionStore::open() {
  is_doubtful_ = false;
  try {
    try_to_open();
    return true;
  } catch (const SqliteError& error) {
    close_as_it_is();
    is_doubtful_ = error.is_corrupt() || error.is_io_error();
    why_closed_ = fmt::format("{}: {}", path_, words_for(error));
    if (is_doubtful_ && save_if_damaged(error)) return open();
  } catch (const ForeignFile& error) {
    close_as_it_is();
    why_closed_ = fmt::format("{} is left as it is: {}", path_, error.what());
  } catch (const std::runtime_error& error) {
    close_as_it_is();
    why_closed_ = error.what();
  }
  return false;
}

void SqliteSessionStore::try_to_open() {
  make_store_directory(directory_);
  replacement_.finish_what_was_begun("corrupt");
  make_store_file(directory_, path_);
  file_.emplace(path_);
  SessionFile::Loaded loaded = file_->load();
  verdict_.reset();
  loaded_ = std::move(loaded.sessions);
  if (loaded.damaged == 0) return;
  notice(Severity::error, fmt::format("{} sessions in {} are damaged: those MQTT-SN clients have "
                                      "to connect again",
                                      loaded.damaged, path_));
}

/// True when what is left of a damaged file is in its place. What goes wrong is tried again at
/// the next check.
bool SqliteSessionStore::save_if_damaged(const SqliteError& why) {
  try {
    const SavedSessions saved(path_);
    if (!verdict_.is_damaged(saved.unreadable, std::chrono::steady_clock::now())) return false;
    if (saved.unreadable > 0 ? saved.sessions.empty() : !why.is_corrupt()) return false;
    {
      SessionFile file(replacement_.begin());
      file.write(saved.sessions);
      file.move_log_into_file();
    }
    const std::string aside = replacement_.finish(damaged_word);
    verdict_.reset();
    notice(Severity::error,
           fmt::format("the sessions in {} were damaged ({}): {} were saved, other MQTT-SN clients "
                       "have to connect again; the damaged file is {}",
                       path_, why.what(), saved.sessions.size(), aside));
    return true;
  } catch (const std::runtime_error& error) {
    why_closed_ = fmt::format("{} is damaged ({}), and what is left of it cannot be saved: {}",
                              path_, why.what(), error.what());
    return false;
  }
}

void SqliteSessionStore::close_as_it_is() {
  if (file_) file_->leave_log_on_close();
  file_.reset();
}

void SqliteSessionStore::report_failure() {
  if (std::exchange(why_reported_, why_closed_) == why_closed_) return;
  notice(Severity::warning,
         fmt::format("sessions of MQTT-SN clients are not kept: {}. After a restart they have to "
                     "connect again",
                     why_closed_));
}

void SqliteSessionStore::notice(Severity severity, std::string text) {
  thread_.report([this, severity, what = std::move(text)] { on_notice_({severity, what, {}}); });
}

bool SqliteSessionStore::write(const Changes& changes) {
  if (!file_ && !open()) {
    report_failure();
    return false;
  }
  loaded_.clear();
  std::vector<Change> list;
  list.reserve(changes.size());
  for (const auto& [id, content] : changes) list.push_back({id, content});
  try {
    file_->write(list);
  } catch (const SqliteError& error) {
    why_closed_ = fmt::format("{}: {}", path_, error.what());
    if (error.is_corrupt()) close_as_it_is();
    report_failure();
    return false;
  }
  if (!std::exchange(why_reported_, {}).empty())
    notice(Severity::notice, fmt::format("sessions are kept in {} again", path_));
  sync_later();
  return true;
}

void SqliteSessionStore::sync_later() {
  if (std::exchange(is_sync_due_, true)) return;
  sync_timer_.expires_after(sync_interval);
  sync_timer_.async_wait([this](boost::system::error_code error) {
    if (!error) sync();
  });
}

void SqliteSessionStore::sync() {
  is_sync_due_ = false;
  try {
    if (file_) file_->sync();
  } catch (const SqliteError&) {
    // The next write says what is wrong.
  }
}

}  // namespace slamgw
