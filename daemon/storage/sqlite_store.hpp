// SPDX-License-Identifier: Apache-2.0
// The message store's shell: opens `messages.db` in `store.directory` and serves the outbox's
// requests on a thread of its own, where a commit may take as long as the disk takes; events come
// back through the loop. A damaged file is moved aside; without a usable one the daemon goes on
// without a store, and this tries again.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <functional>
#include <optional>
#include <string>

#include "daemon/delivery/message_store.hpp"
#include "daemon/mqtt/settings.hpp"
#include "daemon/storage/message_file.hpp"
#include "daemon/storage/store_thread.hpp"

namespace slamgw {

class SqliteStore {
 public:
  /// Between attempts to open the file.
  static constexpr std::chrono::seconds reopen_interval{10};

  /// `on_event` is called on the loop's thread, never from inside a call, and not after stop().
  SqliteStore(boost::asio::io_context& io, StoreSettings settings,
              std::function<void(StoreEvent)> on_event);
  ~SqliteStore();
  SqliteStore(const SqliteStore&) = delete;
  SqliteStore& operator=(const SqliteStore&) = delete;

  void start();
  /// Does what was asked before, closes the file, and waits for that: as long as the disk takes.
  void stop();

  /// The outbox has one write and one load under way; as many more may be from before an opening.
  void ask(WriteToStore write);
  void ask(LoadFromStore load);

 private:
  // On the store's thread:
  template <class Request>
  void serve(const Request& request);
  StoreEvent perform(const WriteToStore& write);
  StoreEvent perform(const LoadFromStore& load);
  void open();
  void try_to_open();
  void try_again_later();
  void go_without(const std::string& why);
  void move_aside(const std::string& why);
  void post(StoreEvent event);

  const StoreSettings settings_;
  const std::string path_;
  const std::function<void(StoreEvent)> on_event_;  // the loop's thread only

  // The store's thread only:
  std::optional<MessageFile> file_;
  std::uint64_t generation_ = 0;  // openings and absences so far (message_store.hpp)
  std::string why_absent_;        // as last said

  StoreThread thread_;
  boost::asio::steady_timer reopen_timer_;
};

}  // namespace slamgw
