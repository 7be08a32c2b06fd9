// SPDX-License-Identifier: Apache-2.0
// Restores sessions from the store at start, and saves changed ones. Sessions are saved at once
// where an answer waits for that. Others are saved a few at a time, not faster than the store
// writes, so that a burst of changes costs the loop little. Owned by MqttsnAdapter.
#pragma once

#include <boost/asio/io_context.hpp>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "adapters/mqttsn_udp/sn_gateway.hpp"
#include "daemon/core/session_store.hpp"
#include "daemon/runtime/timer.hpp"

namespace slamgw::mqttsn {

class SessionKeeper {
 public:
  /// Delay of a write for which no answer waits, so that it contains more changes.
  static constexpr std::chrono::milliseconds interval{50};
  static constexpr std::size_t sessions_a_write = 256;
  /// A write that takes longer no longer holds answers back: robots repeat a request after 8 s.
  static constexpr std::chrono::seconds write_patience{1};

  /// `on_saved` passes the result of each write on to SnGateway::on_saved().
  SessionKeeper(boost::asio::io_context& io, SnGateway& gateway, SessionStore& store,
                std::function<void(bool is_saved)> on_saved);
  ~SessionKeeper() { store_.watch({}); }
  SessionKeeper(const SessionKeeper&) = delete;
  SessionKeeper& operator=(const SessionKeeper&) = delete;

  /// Restores the sessions. Call once, before the first datagram. Returns nothing when there was no
  /// session to restore.
  std::optional<Notice> restore(TimePoint now);
  /// Call when something may have changed; costs nothing when nothing has. Where answers wait, the
  /// sessions are saved after the present handler of the loop, so requests that come together share
  /// a write.
  void save_soon();
  /// Saves all sessions, also what changes too often to be saved each time.
  void stop();

 private:
  void watch_disk();
  void save_after(std::chrono::milliseconds delay);
  void save_some();
  void save_again_later(std::string id);
  void on_written(bool is_written);

  SnGateway& gateway_;
  SessionStore& store_;
  const std::function<void(bool is_saved)> on_saved_;
  Timer timer_;
  Timer patience_timer_;
  Timer later_timer_;
  std::vector<std::string> later_;  ///< client ids with commands that were too young
  bool is_stopping_ = false;
  bool is_armed_ = false;
  bool is_urgent_ = false;    // armed for answers
  bool is_watching_ = false;  // while answers wait
};

}  // namespace slamgw::mqttsn
