// SPDX-License-Identifier: Apache-2.0
// The thread of a store's file operations: a commit takes as long as the disk takes, and the loop
// must not wait for it. Jobs run one after the other in the order in which they were given; their
// results go back to the loop as reports. Owned and used by a store on the loop's thread; only the
// members that say so may be called on another thread.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/thread_pool.hpp>
#include <chrono>
#include <memory>
#include <utility>

namespace slamgw {

/// Times for which the stores wait for a disk.
struct StorePatience {
  /// Pause between attempts to open a log that could not be opened.
  std::chrono::milliseconds reopen{10000};
  /// Pause between attempts to read a failing disk.
  std::chrono::milliseconds check{1000};
  /// Longest delay of the start; after it the daemon continues without the store.
  std::chrono::milliseconds opening{10000};
  /// Data that the disk could not read for this time are lost.
  std::chrono::milliseconds unreadable{60000};
};

class StoreThread {
 public:
  explicit StoreThread(boost::asio::io_context& loop) : loop_(loop) {}
  ~StoreThread() { stop(); }
  StoreThread(const StoreThread&) = delete;
  StoreThread& operator=(const StoreThread&) = delete;

  /// Runs `job` on the store's thread.
  template <class Job>
  void run(Job&& job) {
    boost::asio::post(pool_, std::forward<Job>(job));
  }
  /// Runs `report` on the loop's thread; drops it when stop() was called first. Call on any thread.
  template <class Report>
  void report(Report&& report) {
    boost::asio::post(loop_,
                      [is_stopped = is_stopped_, what = std::forward<Report>(report)]() mutable {
                        if (!*is_stopped) what();
                      });
  }
  /// For timers whose handlers run on the store's thread.
  boost::asio::thread_pool& context() { return pool_; }

  /// Runs every job that was given before, and waits for that. Timers are dropped.
  void stop() {
    if (std::exchange(*is_stopped_, true)) return;
    run([this] { pool_.stop(); });
    pool_.join();
  }

 private:
  boost::asio::io_context& loop_;
  std::shared_ptr<bool> is_stopped_ = std::make_shared<bool>(false);  // the loop's thread only
  boost::asio::thread_pool pool_{1};
};

}  // namespace slamgw
