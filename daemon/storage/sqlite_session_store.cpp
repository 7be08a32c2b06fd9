// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/sqlite_session_store.hpp"

#include <fmt/format.h>

#include <boost/asio/post.hpp>
#include <utility>

#include "daemon/storage/store_file.hpp"

namespace slamgw {

SqliteSessionStore::SqliteSessionStore(boost::asio::io_context& io, std::string directory,
                                       std::function<void(Notice)> on_notice)
    : io_(io),
      directory_(std::move(directory)),
      path_(directory_ + "/sessions.db"),
      on_notice_(std::make_shared<std::function<void(Notice)>>(std::move(on_notice))) {}

SqliteSessionStore::~SqliteSessionStore() { stop(); }

std::vector<SessionStore::Session> SqliteSessionStore::load() {
  std::vector<Session> sessions;
  if (open()) {
    try {
      sessions = file_->load();
    } catch (const SqliteError& error) {
      move_aside(error.what());
      open();
    }
  }
  thread_ = std::thread([this] { run(); });
  return sessions;
}

void SqliteSessionStore::save(std::vector<Change> changes) {
  {
    const std::lock_guard lock(mutex_);
    for (Change& change : changes) changes_[std::move(change.id)] = std::move(change.content);
  }
  wake_.notify_one();
}

bool SqliteSessionStore::is_busy() const {
  const std::lock_guard lock(mutex_);
  return is_writing_ || !changes_.empty();
}

void SqliteSessionStore::stop() {
  if (!thread_.joinable()) return;
  {
    const std::lock_guard lock(mutex_);
    is_stopping_ = true;
  }
  wake_.notify_one();
  thread_.join();
  *on_notice_ = nullptr;
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
  const std::string aside = move_store_file_aside(path_);
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
  boost::asio::post(io_, [on_notice = on_notice_, severity, text = std::move(text)]() mutable {
    if (*on_notice) (*on_notice)({severity, std::move(text), {}});
  });
}

void SqliteSessionStore::run() {
  std::unique_lock lock(mutex_);
  bool is_synced = true;
  while (!is_stopping_ || !changes_.empty()) {
    const auto is_awaited = [this] { return is_stopping_ || !changes_.empty(); };
    if (is_synced) {
      wake_.wait(lock, is_awaited);
    } else if (!wake_.wait_for(lock, sync_interval, is_awaited)) {
      lock.unlock();
      sync();
      lock.lock();
      is_synced = true;
      continue;
    }
    Changes changes = std::exchange(changes_, {});
    is_writing_ = true;
    lock.unlock();
    const bool is_written = changes.empty() || write(changes);
    lock.lock();
    is_writing_ = false;
    is_synced = false;
    if (is_written) continue;
    changes_.merge(std::move(changes));  // newer ones of the same session stay
    if (is_stopping_) break;
    wake_.wait_for(lock, retry_interval, [this] { return is_stopping_; });
  }
  lock.unlock();
  file_.reset();  // a clean end synchronises
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
  return true;
}

void SqliteSessionStore::sync() {
  try {
    if (file_) file_->sync();
  } catch (const SqliteError&) {
    // The next write says what is wrong.
  }
}

}  // namespace slamgw
