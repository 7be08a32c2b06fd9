// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/sqlite_session_store.hpp"

#include <fmt/format.h>

#include <future>
#include <utility>

#include "daemon/storage/store_file.hpp"

namespace slamgw {

SqliteSessionStore::SqliteSessionStore(boost::asio::io_context& io, std::string directory,
                                       std::function<void(Notice)> on_notice)
    : directory_(std::move(directory)),
      path_(directory_ + "/sessions.db"),
      on_notice_(std::move(on_notice)),
      retry_timer_(io),
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
    return;
  }
  changes_.merge(std::move(changes));  // newer ones of the same session stay
  retry_timer_.expires_after(retry_interval);
  retry_timer_.async_wait([this](boost::system::error_code error) {
    if (!error) write_changes();
  });
}

std::vector<SessionStore::Session> SqliteSessionStore::open_and_load() {
  if (!open()) return {};
  try {
    return file_->load();
  } catch (const SqliteError& error) {
    move_aside(error.what());
    open();
    return {};
  }
}

bool SqliteSessionStore::open() {
  try {
    make_store_file(directory_, path_);
    try {
      file_.emplace(path_);
    } catch (const SqliteError& error) {
      if (!error.is_corrupt()) throw;
      move_aside(error.what());
      make_store_file(directory_, path_);
      file_.emplace(path_);
    }
    return true;
  } catch (const SqliteError& error) {
    fail(path_ + ": " +
         (error.is_locked() ? "another process has it open; does a second slam-gatewayd run?"
                            : error.what()));
  } catch (const ForeignFile& error) {
    fail(fmt::format("{} is left as it is: {}", path_, error.what()));
  } catch (const std::runtime_error& error) {
    fail(error.what());
  }
  return false;
}

void SqliteSessionStore::move_aside(const std::string& why) {
  file_.reset();
  const std::string aside = put_store_file_aside(path_, "corrupt");
  notice(Severity::error,
         fmt::format("the sessions in {} are damaged ({}): moved to {} and begun anew; MQTT-SN "
                     "clients have to connect again",
                     path_, why, aside));
}

void SqliteSessionStore::fail(const std::string& why) {
  if (std::exchange(why_failed_, why) == why) return;
  notice(Severity::warning,
         fmt::format("sessions of MQTT-SN clients are not kept: {}. After a restart they have to "
                     "connect again",
                     why));
}

void SqliteSessionStore::notice(Severity severity, std::string text) {
  thread_.report([this, severity, what = std::move(text)] { on_notice_({severity, what, {}}); });
}

bool SqliteSessionStore::write(const Changes& changes) {
  if (!file_ && !open()) return false;
  std::vector<Change> list;
  list.reserve(changes.size());
  for (const auto& [id, content] : changes) list.push_back({id, content});
  try {
    file_->write(list);
  } catch (const SqliteError& error) {
    if (error.is_corrupt()) move_aside(error.what());
    fail(fmt::format("{}: {}", path_, error.what()));
    return false;
  }
  if (!std::exchange(why_failed_, {}).empty())
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
