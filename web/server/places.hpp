// SPDX-License-Identifier: Apache-2.0
// A bounded number of places for connections: who gets one, and which connection gives way. No
// client takes more than a share of them, so that it can't shut out the others. Pure.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>

#include "web/server/client.hpp"

namespace slamgw::web {

/// A place that is held until the last copy is gone. Its Places must outlive it.
using HeldPlace = std::shared_ptr<const std::uint64_t>;

class Places {
 public:
  enum class Room { free, share_is_taken, all_are_taken };

  explicit Places(std::size_t max) : max_(max) {}
  Places(const Places&) = delete;
  Places& operator=(const Places&) = delete;

  /// A quarter, but at least 2, because a browser needs more than one. Behind a reverse proxy all
  /// clients come from one address of loopback, which gets three quarters.
  std::size_t share_of(const Client& client) const;
  Room room_for(const Client& client) const;
  /// The caller has asked for room.
  HeldPlace take(const Client& client);
  /// `give_way`: of a connection that waits for a whole request; null once it has it.
  void set_waiting(const HeldPlace& place, std::function<void()> give_way);
  /// Takes the place of the connection that waits longest: of the client's own where its share is
  /// taken, else of all. False when none waits.
  bool make_room_for(const Client& client);

 private:
  struct Connection {
    Client client;
    std::uint64_t waits_since = 0;  ///< a number that grows
    std::function<void()> give_way{};
  };

  const std::size_t max_;
  std::uint64_t last_ = 0;  ///< number that was given to a place, or to a time
  std::map<std::uint64_t, Connection> connections_;
};

}  // namespace slamgw::web
