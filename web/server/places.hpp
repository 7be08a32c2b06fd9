// SPDX-License-Identifier: Apache-2.0
// A bounded number of places for connections: decides which client gets a place, and which
// connection loses its place for that. No client takes more than a share of the places, so that it
// can't shut out the others. Pure.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>

#include "web/server/client.hpp"

namespace slamgw::web {

/// A place that is held until the last copy is destroyed. Its Places must outlive it.
using HeldPlace = std::shared_ptr<const std::uint64_t>;

class Places {
 public:
  enum class Room { free, share_is_taken, all_are_taken };

  explicit Places(std::size_t max) : max_(max) {}
  Places(const Places&) = delete;
  Places& operator=(const Places&) = delete;

  /// Returns a quarter of the places, but at least 2, because a browser needs more than one. Behind
  /// a reverse proxy, all clients come from one loopback address, which gets three quarters.
  std::size_t share_of(const Client& client) const;
  Room room_for(const Client& client) const;
  /// Call only after room_for() or make_room_for() has found room.
  HeldPlace take(const Client& client);
  /// `on_replaced` closes a connection that waits for a whole request; null once the request is
  /// whole.
  void set_waiting(const HeldPlace& place, std::function<void()> on_replaced);
  /// Takes the place of the connection that waits longest: of the client's own connections if its
  /// share is taken, else of all. False when no connection waits.
  bool make_room_for(const Client& client);

 private:
  struct Connection {
    Client client;
    std::uint64_t waits_since = 0;  ///< a rising number, not a time
    std::function<void()> on_replaced{};
  };

  const std::size_t max_;
  std::uint64_t last_ = 0;  ///< last number that a place or `waits_since` got
  std::map<std::uint64_t, Connection> connections_;
};

}  // namespace slamgw::web
