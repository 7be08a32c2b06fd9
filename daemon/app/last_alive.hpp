// SPDX-License-Identifier: Apache-2.0
// Keeps `<store.directory>/alive`, which shows when a gateway on this host was last online at the
// broker. Commands that waited at the broker for longer than a restart takes are refused
// (docs/fleet.md).
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/thread_pool.hpp>
#include <optional>
#include <string>

#include "daemon/core/time.hpp"
#include "daemon/runtime/timer.hpp"

namespace slamgw {

class LastAlive {
 public:
  static constexpr std::chrono::seconds interval{5};

  /// When a gateway was last online, and at which broker.
  struct Online {
    TimePoint time{};
    std::string uri;
  };

  /// Reads the file; call before the loop runs.
  LastAlive(boost::asio::io_context& io, const std::string& directory);

  /// Returns when and where the process before this one was last online, within `interval`. Returns
  /// nothing if that may be long ago: no such process, a reboot, or a clock set back.
  const std::optional<Online>& before_start() const { return before_start_; }
  /// Writes the file from now on, on a thread of its own. After a long time offline, or at another
  /// broker, it waits: until the robots' sessions are held, a process that ends leaves the old
  /// time.
  void on_broker_up(const std::string& uri);
  /// Leaves the file alone until the broker is back.
  void on_broker_down();
  /// Writes the file once more if it is being written, and waits until that is done.
  void stop();

 private:
  void read();
  void write();

  const std::string path_;
  std::optional<Online> before_start_;
  std::string broker_uri_;        ///< empty while the broker is offline
  std::optional<Online> online_;  ///< the newest that is known; nothing on a new host
  TimePoint write_from_{};
  Timer timer_;
  boost::asio::thread_pool disk_{1};
};

}  // namespace slamgw
