// SPDX-License-Identifier: Apache-2.0
// Brings sessions from the store at start, and changed ones to it: a few at a time, not faster than
// the store writes, so that a burst of changes costs the loop little. Owned by MqttsnAdapter.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <string>

#include "adapters/mqttsn_udp/sn_gateway.hpp"
#include "daemon/core/session_store.hpp"

namespace slamgw::mqttsn {

class SessionKeeper {
 public:
  /// From a change to its writing: more will have changed by then. Also the rate of writes.
  static constexpr std::chrono::milliseconds interval{50};
  static constexpr std::size_t sessions_a_write = 256;

  SessionKeeper(boost::asio::io_context& io, SnGateway& gateway, SessionStore& store);

  struct Restored {
    Severity severity = Severity::info;
    std::string text;  ///< for the operator; empty when there was nothing to restore
  };
  /// Once, before the first datagram.
  Restored restore(TimePoint now);
  /// Something may have changed; costs nothing when it has not.
  void save_soon();
  /// Saves all sessions, also what changes too often to be saved each time.
  void stop();

 private:
  void save_some();

  SnGateway& gateway_;
  SessionStore& store_;
  boost::asio::steady_timer timer_;
  bool is_armed_ = false;
};

}  // namespace slamgw::mqttsn
