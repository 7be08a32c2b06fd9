// SPDX-License-Identifier: Apache-2.0
// The message store's shell: opens `messages.db` in `store.directory` and serves the outbox's
// requests on a thread of its own, where a commit may take as long as the disk takes; events come
// back through the loop. A damaged file is moved aside; without a usable one the daemon goes on
// without a store, and this tries again.
#pragma once

#include <boost/asio/io_context.hpp>
#include <condition_variable>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <variant>

#include "daemon/delivery/message_store.hpp"
#include "daemon/mqtt/settings.hpp"
#include "daemon/storage/message_file.hpp"

namespace slamgw {

class SqliteStore {
 public:
  /// Between attempts to open the file.
  static constexpr std::chrono::seconds reopen_interval{10};
  /// The outbox has one write and one load under way; as many more may be from before an opening.
  static constexpr std::size_t max_requests = 4;

  /// `on_event` is called on the loop's thread, never from inside a call, and not after stop().
  SqliteStore(boost::asio::io_context& io, StoreSettings settings,
              std::function<void(StoreEvent)> on_event);
  ~SqliteStore();
  SqliteStore(const SqliteStore&) = delete;
  SqliteStore& operator=(const SqliteStore&) = delete;

  void start();
  /// Does what was asked before, closes the file, and waits for that: as long as the disk takes.
  void stop();

  void ask(WriteToStore write) { ask_any(std::move(write)); }
  void ask(LoadFromStore load) { ask_any(load); }

 private:
  using Request = std::variant<WriteToStore, LoadFromStore>;

  void ask_any(Request request);

  // On the store's thread:
  void run();
  std::optional<Request> next_request();
  void serve(const Request& request);
  StoreEvent perform(const WriteToStore& write);
  StoreEvent perform(const LoadFromStore& load);
  void open();
  void try_to_open();
  void go_without(const std::string& why);
  void move_aside(const std::string& why);
  void post(StoreEvent event);

  boost::asio::io_context& io_;
  const StoreSettings settings_;
  const std::string path_;
  std::shared_ptr<std::function<void(StoreEvent)>> on_event_;  // loop only; emptied by stop()

  std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<Request> requests_;  // under mutex_
  bool is_stopping_ = false;      // under mutex_
  std::thread thread_;

  // The store's thread only:
  std::optional<MessageFile> file_;
  std::uint64_t generation_ = 0;  // openings and absences so far (message_store.hpp)
  std::string why_absent_;        // as last said
};

}  // namespace slamgw
