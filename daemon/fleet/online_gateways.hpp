// SPDX-License-Identifier: Apache-2.0
// The other gateways whose `state` on the broker says `online`, whether or not their beats are
// heard. Pure; part of Ownership.
#pragma once

#include <map>
#include <string>

#include "daemon/core/messages.hpp"
#include "daemon/core/time.hpp"
#include "daemon/fleet/peers.hpp"

namespace slamgw::fleet {

class OnlineGateways {
 public:
  struct State {
    std::string version;
    std::string since;
    TimePoint heard{};
    bool is_greeted = false;  ///< this gateway has published its own state again for it
  };

  void on_link_change() { brings_retained_ = false; }
  /// The broker has sent a retained state, be it this gateway's own.
  void on_retained() { brings_retained_ = true; }
  /// True when the gateway is online. What is no state counts as offline.
  bool on_state(const std::string& gateway, ByteView payload, TimePoint now);

  /// At most Peers::max_peers.
  const std::map<std::string, State>& all() const { return states_; }
  bool contains(const std::string& gateway) const { return states_.contains(gateway); }
  /// Some gateway has said within the last hour that it is online. One that is silent for longer is
  /// gone, or cut off.
  bool is_any_about(TimePoint now) const;
  /// True when some gateway takes no part and may not know of this one: that is so where the
  /// broker's nodes keep retained messages each for itself, or where no subscription with a
  /// wildcard brings them (RabbitMQ). True once for each.
  bool take_newcomers(const Peers& peers, TimePoint now);
  /// Since when the beats of all that are online have been heard: a gateway that has just come
  /// takes part a while later, and may have robots before that.
  TimePoint complete_since(const Peers& peers, TimePoint now) const;

 private:
  std::map<std::string, State> states_;
  bool brings_retained_ = false;  ///< the broker, to this connection
};

}  // namespace slamgw::fleet
