// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/disk_session_store.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cerrno>
#include <future>
#include <thread>
#include <utility>

namespace slamgw {
namespace {

constexpr std::uint32_t segment_bytes = 256u << 10;

Bytes encode(const std::string& id, ByteView content) {
  ByteWriter out;
  out.write_u16_le(static_cast<std::uint16_t>(id.size())).write(id).write(content);
  return out.take();
}

}  // namespace

DiskSessionStore::DiskSessionStore(boost::asio::io_context& io, const std::string& directory,
                                   Content content, std::function<void(Notice)> on_notice,
                                   StorePatience patience)
    : directory_(directory + "/" + content.folder),
      content_(std::move(content)),
      patience_(patience),
      on_notice_(std::move(on_notice)),
      retry_timer_(io),
      thread_(io),
      sync_timer_(thread_.context()) {}

DiskSessionStore::~DiskSessionStore() { stop(); }

std::vector<SessionStore::Session> DiskSessionStore::load() {
  std::promise<std::vector<Session>> loaded;
  thread_.run([&] { loaded.set_value(open_and_load()); });
  return loaded.get_future().get();
}

void DiskSessionStore::save(std::vector<Change> changes) {
  for (Change& change : changes) changes_[std::move(change.id)] = std::move(change.content);
  if (!is_writing_) write_changes();
}

bool DiskSessionStore::is_busy() const { return is_writing_ || !changes_.empty(); }

void DiskSessionStore::stop() {
  retry_timer_.cancel();
  if (!changes_.empty()) write_changes();
  thread_.run([this] {
    sync();
    log_.reset();
  });
  thread_.stop();
}

/// Writes all collected changes in one commit. Changes during the write go into the next commit.
void DiskSessionStore::write_changes() {
  is_writing_ = true;
  thread_.run([this, changes = std::exchange(changes_, {})]() mutable {
    const bool is_written = write(changes);
    thread_.report([this, is_written, changes = std::move(changes)]() mutable {
      on_written(is_written, std::move(changes));
    });
  });
}

void DiskSessionStore::on_written(bool is_written, Changes changes) {
  if (is_written) {
    is_writing_ = false;
    if (!changes_.empty()) write_changes();
  } else {
    changes_.merge(std::move(changes));  // a newer change of the same session stays
    retry_timer_.after(patience_.reopen, [this] { write_changes(); });
  }
  if (on_written_) on_written_(is_written);
}

/// Waits for a disk that fails for a moment: sessions are worth a longer start.
std::vector<SessionStore::Session> DiskSessionStore::open_and_load() {
  const auto give_up_at = std::chrono::steady_clock::now() + patience_.opening;
  std::vector<Session> loaded;
  while (!open(false, loaded) && is_disk_failing_ && std::chrono::steady_clock::now() < give_up_at)
    std::this_thread::sleep_for(patience_.check);
  // Sessions that the disk still cannot read are lost (Content::loss).
  if (!log_ && is_disk_failing_) open(true, loaded);
  if (!log_) report_failure();
  return loaded;
}

void DiskSessionStore::read_all(bool skips_unreadable, std::vector<Session>& loaded) {
  keys_.clear();
  loaded.clear();
  last_key_ = log_->last_key();
  for (auto key = log_->next(0); key; key = log_->next(*key)) {
    const auto record = log_->read(*key, skips_unreadable);
    ByteReader in(record ? ByteView(*record) : ByteView());
    const std::string id(as_text(in.read(in.read_u16_le())));
    const ByteView content = in.read_rest();
    if (!in.ok()) continue;
    keys_[id] = *key;
    loaded.push_back({id, Bytes(content.begin(), content.end())});
  }
  std::ranges::sort(loaded, {}, &Session::id);
}

bool DiskSessionStore::open(bool skips_unreadable, std::vector<Session>& loaded) {
  is_disk_failing_ = false;
  try {
    log_.emplace(directory_, segment_bytes);
    // Sessions on a read-only disk may be old: topic ids may have changed since.
    if (log_->is_read_only()) throw LogError(directory_, EROFS);
    const RecordLog::Summary summary = log_->open(skips_unreadable);
    read_all(skips_unreadable, loaded);
    if (summary.lost_at_most > 0)
      notice(Severity::error, fmt::format("{} {} in {} are damaged: {}", summary.lost_at_most,
                                          content_.name, summary.where, content_.loss));
    return true;
  } catch (const LogError& error) {
    log_.reset();
    is_disk_failing_ = error.is_io_error();
    why_closed_ = error.what();
    return false;
  }
}

void DiskSessionStore::report_failure() {
  if (std::exchange(why_reported_, why_closed_) == why_closed_) return;
  notice(Severity::warning, fmt::format("{} are not kept: {}. After a restart {}", content_.name,
                                        why_closed_, content_.loss));
}

void DiskSessionStore::notice(Severity severity, std::string text) {
  thread_.report([this, severity, what = std::move(text)] { on_notice_({severity, what, {}}); });
}

bool DiskSessionStore::write(const Changes& changes) {
  std::vector<Session> unused;
  if (!log_ && !open(false, unused)) {
    report_failure();
    return false;
  }
  try {
    log_->put_back_in_place();
    for (const auto& [id, content] : changes) {
      const auto known = keys_.find(id);
      if (content) {
        log_->put(known != keys_.end() ? known->second : keys_[id] = ++last_key_,
                  encode(id, *content));
      } else if (known != keys_.end()) {
        log_->erase(known->second);
      }
    }
    log_->commit(false);
    for (const auto& [id, content] : changes)
      if (!content) keys_.erase(id);  // not before the commit, which may fail and be repeated
  } catch (const LogError& error) {
    why_closed_ = error.what();
    report_failure();
    return false;
  }
  if (!std::exchange(why_reported_, {}).empty())
    notice(Severity::notice, content_.name + " are kept again");
  sync_later();
  return true;
}

/// Starts one synchronisation for all changes that are written within `sync_interval`.
void DiskSessionStore::sync_later() {
  if (std::exchange(is_sync_due_, true)) return;
  sync_timer_.after(sync_interval, [this] {
    if (is_sync_due_) sync();
  });
}

void DiskSessionStore::sync() {
  is_sync_due_ = false;
  if (!log_) return;
  try {
    if (log_->owes_erasures()) log_->commit(false);
    log_->synchronise();
    if (log_->owes_erasures()) sync_later();
  } catch (const LogError&) {
    // The next write shows whether the disk works.
  }
}

}  // namespace slamgw
