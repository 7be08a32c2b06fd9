// SPDX-License-Identifier: Apache-2.0
// The message store's shell: opens `messages.db` in `store.directory` and serves the outbox's
// requests on a thread of its own, where a commit may take as long as the disk takes; events come
// back through the loop. A disk error alone does not count as damage. From a damaged file the shell
// saves everything that can be read and puts the file aside. Without a usable file the daemon goes
// on without a store, and the shell tries again.
//
// Once the outbox has got a store (StoreOpened), that store never ends for it: while its file
// cannot be used, requests fail, and when it can be used again they succeed.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/operator_order.hpp"
#include "daemon/delivery/message_store.hpp"
#include "daemon/mqtt/settings.hpp"
#include "daemon/storage/dead_letter_desk.hpp"
#include "daemon/storage/file_replacement.hpp"
#include "daemon/storage/message_file.hpp"
#include "daemon/storage/message_recovery.hpp"
#include "daemon/storage/store_file.hpp"
#include "daemon/storage/store_tally.hpp"
#include "daemon/storage/store_thread.hpp"

namespace slamgw {

class SqliteStore {
 public:
  /// `on_event` is called on the loop's thread, never from inside a call, and not after stop().
  SqliteStore(boost::asio::io_context& io, StoreSettings settings,
              std::function<void(StoreEvent)> on_event, StorePatience patience = {});
  ~SqliteStore();
  SqliteStore(const SqliteStore&) = delete;
  SqliteStore& operator=(const SqliteStore&) = delete;

  void start();
  /// Finishes the earlier requests, closes the file, and waits for both as long as the disk takes.
  void stop();

  /// The outbox has one write and one load under way; as many more may be from before an opening.
  void ask(WriteToStore write);
  void ask(LoadFromStore load);
  /// `done` is called on the loop's thread, once, or not at all when stop() comes first.
  void perform(StoreOrder order, OrderDone done);

 private:
  // On the store's thread:
  template <class Request>
  void serve(const Request& request);
  void perform(const WriteToStore& write);
  void perform(const LoadFromStore& load);
  void serve(const StoreOrder& order, const OrderDone& done);
  void on_request_failed(const SqliteError& error, bool is_load);
  void open();
  void try_to_open();
  void on_opened();
  void report_closed();
  void close_as_it_is();
  bool save_if_damaged(const SqliteError& why);
  void save(MessageRecovery& recovery, const std::string& why);
  void check_place();
  void put_back_in_place();
  void try_again_after(std::chrono::milliseconds time);
  void post(StoreEvent event);
  void notify(Severity severity, std::string text);

  const StoreSettings settings_;
  const StorePatience patience_;
  const std::string path_;
  const FileReplacement replacement_;
  const std::function<void(StoreEvent)> on_event_;  // the loop's thread only

  // The store's thread only:
  std::optional<StoreTally> tally_;
  std::optional<MessageFile> file_;
  DamageVerdict verdict_;
  std::uint64_t generation_ = 0;            // openings and absences so far (message_store.hpp)
  bool is_open_for_outbox_ = false;         // StoreOpened was the last of both
  std::uint64_t last_kept_row_ = 0;         // the outbox was informed that it is stored
  std::vector<std::uint64_t> unconfirmed_;  // rows of a failed write that were dead letters before
  std::optional<TimePoint> closed_since_;
  std::string why_closed_;
  std::string why_reported_;  // as last logged

  StoreThread thread_;
  boost::asio::steady_timer timer_;  // the next attempt to open, or the next check_place()
  DeadLetterDesk dead_letter_desk_;
};

}  // namespace slamgw
