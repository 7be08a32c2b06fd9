// SPDX-License-Identifier: Apache-2.0
// The subscriptions by which this gateway hears the other gateways, and which of them the broker
// has answered on this connection. Pure; part of Ownership. The core makes them at the broker, and
// again at each connection.
#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <string>

#include "daemon/core/broker_link.hpp"
#include "daemon/fleet/membership.hpp"

namespace slamgw::fleet {

class FleetSubscriptions {
 public:
  /// A subscription that the broker has not answered for so long no longer counts as missing.
  static constexpr std::chrono::seconds answer_patience{60};

  explicit FleetSubscriptions(Membership& membership) : membership_(membership) {}

  /// `is_session_kept`: the broker still has what an earlier connection has subscribed.
  void on_link_up(bool is_session_kept, TimePoint now);
  void on_link_down() { is_session_kept_ = false; }
  void on_answer(const std::string& filter, SubscribeAnswer answer);

  void subscribe(const std::string& filter, TimePoint now);
  /// To all that other gateways say, and to all commands. A gateway that `was_alone` asks for the
  /// commands once more, so that the core looks again at robots' own filters.
  void subscribe_to_others(bool was_alone, TimePoint now);
  /// `keeps_beats`: others that speak again are still heard.
  void unsubscribe_from_others(bool keeps_beats);
  /// Ends what an earlier process has subscribed and this one has not, once for each connection: a
  /// broker that kept the session would send commands for other gateways' robots.
  void unsubscribe_stale();

  /// The broker has granted or refused each subscription but that to states. Until then claims,
  /// releases, outcomes or commands may be lost.
  bool are_answered(TimePoint now) const;
  bool is_session_kept() const { return is_session_kept_; }

 private:
  enum class Answer : std::uint8_t {
    missing,  ///< on this connection
    granted,
    closes_connection,  ///< nobody asks again
  };

  Membership& membership_;
  std::map<std::string, Answer> answers_;  ///< by filter, of those that were not refused
  TimePoint asked_{};                      ///< when the newest of them was sent
  bool is_session_kept_ = false;
};

}  // namespace slamgw::fleet
