// SPDX-License-Identifier: Apache-2.0
// The message store's shell: keeps a MessageLog in `store.directory` and serves the outbox's
// requests on the disk's thread, where a commit may take as long as the disk takes. Events come
// back through the loop. Damage loses only the records that it hit; a disk that fails for a moment
// loses nothing. While there is no usable log, the daemon goes on without a store, and the shell
// tries again.
//
// An open store (StoreOpened) stays open for the outbox: requests fail while the disk fails, and
// succeed when it works again.
#pragma once

#include <boost/asio/io_context.hpp>
#include <functional>
#include <optional>
#include <string>

#include "daemon/core/operator_order.hpp"
#include "daemon/delivery/message_store.hpp"
#include "daemon/mqtt/settings.hpp"
#include "daemon/runtime/timer.hpp"
#include "daemon/storage/message_log.hpp"
#include "daemon/storage/store_thread.hpp"

namespace slamgw {

class DiskStore {
 public:
  /// `on_event` is called on the loop's thread, never from inside a call, and not after stop().
  DiskStore(boost::asio::io_context& io, StoreSettings settings,
            std::function<void(StoreEvent)> on_event, StorePatience patience = {});
  ~DiskStore();
  DiskStore(const DiskStore&) = delete;
  DiskStore& operator=(const DiskStore&) = delete;

  void start();
  /// Finishes the earlier requests, closes the log, and waits for both as long as the disk takes.
  void stop();

  /// Queues a request of the outbox. At most one write and one load are under way.
  void ask(StoreRequest request);
  /// Carries out an operator's order. `done` is called once, on the loop's thread, or not at all
  /// when stop() comes first.
  void perform(StoreOrder order, OrderDone done);

 private:
  // On the disk's thread:
  template <class Request>
  void serve(const Request& request);
  void serve(const StoreOrder& order, const OrderDone& done);
  void open();
  void report_closed();
  void try_again_after(std::chrono::milliseconds time);
  bool is_given_up() const;
  void post(StoreEvent event);
  void notify(Severity severity, std::string text);

  const StoreSettings settings_;
  const StorePatience patience_;
  const std::function<void(StoreEvent)> on_event_;  // the loop's thread only

  // The disk's thread only:
  std::optional<MessageLog> log_;
  std::optional<TimePoint> closed_since_;   // time of the first attempt to open
  std::optional<TimePoint> failing_since_;  // time since which the disk fails to read
  std::string why_closed_;
  std::string why_reported_;  // as last logged

  StoreThread thread_;
  Timer timer_;  // the next attempt to open, or the next MessageLog::repair()
};

}  // namespace slamgw
