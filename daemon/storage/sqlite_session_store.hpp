// SPDX-License-Identifier: Apache-2.0
// The shell of SessionFile: `sessions.db` in `store.directory`, written on a thread of its own. A
// damaged file is moved aside; without a usable one the daemon goes on, and this tries again.
#pragma once

#include <boost/asio/io_context.hpp>
#include <condition_variable>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/core/session_store.hpp"
#include "daemon/storage/session_file.hpp"

namespace slamgw {

class SqliteSessionStore final : public SessionStore {
 public:
  /// Between a failure and the next attempt.
  static constexpr std::chrono::seconds retry_interval{10};
  /// What a power cut may take back at most.
  static constexpr std::chrono::seconds sync_interval{5};

  /// `on_notice` is called on the loop's thread, not after stop().
  SqliteSessionStore(boost::asio::io_context& io, std::string directory,
                     std::function<void(Notice)> on_notice);
  ~SqliteSessionStore() override;

  std::vector<Session> load() override;
  void save(std::vector<Change> changes) override;
  bool is_busy() const override;
  /// Writes what is still to be written, once, and waits for that.
  void stop();

 private:
  using Changes = std::map<std::string, std::optional<Bytes>>;

  bool open();
  void move_aside(const std::string& why);
  void fail(const std::string& why);
  void notice(Severity severity, std::string text);

  // On the store's thread:
  void run();
  bool write(const Changes& changes);
  void sync();

  boost::asio::io_context& io_;
  const std::string directory_;
  const std::string path_;
  std::shared_ptr<std::function<void(Notice)>> on_notice_;  // loop only; emptied by stop()

  mutable std::mutex mutex_;
  std::condition_variable wake_;
  Changes changes_;           // under mutex_; the last of each session
  bool is_writing_ = false;   // under mutex_
  bool is_stopping_ = false;  // under mutex_
  std::thread thread_;

  // Before the thread starts, the loop's; then the thread's only:
  std::optional<SessionFile> file_;
  std::string why_failed_;  // as last said
};

}  // namespace slamgw
