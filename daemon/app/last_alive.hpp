// SPDX-License-Identifier: Apache-2.0
// Keeps `<store.directory>/alive`: the file's modification time is when a gateway last ran here.
// Commands that waited at the broker for longer than a restart takes are refused (docs/fleet.md).
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/thread_pool.hpp>
#include <optional>
#include <string>

#include "daemon/core/time.hpp"

namespace slamgw {

class LastAlive {
 public:
  static constexpr std::chrono::seconds interval{5};

  /// Reads the file; call before the loop runs.
  LastAlive(boost::asio::io_context& io, const std::string& directory);

  /// Returns when the process before this one ended, within `interval`; nothing where none has run.
  std::optional<TimePoint> before_start() const { return before_start_; }
  /// Touches the file from now on, on a thread of its own.
  void start();
  /// Touches the file once more and waits until that is done.
  void stop();

 private:
  void touch();

  const std::string path_;
  std::optional<TimePoint> before_start_;
  boost::asio::steady_timer timer_;
  boost::asio::thread_pool disk_{1};
};

}  // namespace slamgw
