// SPDX-License-Identifier: Apache-2.0
// Which gateway serves which robot, as one gateway sees it: claims with epochs of which the
// greatest wins, a lease that the owner checks by its own clock, and commands and wills that only
// the owner deals with (docs/fleet.md). A pure machine between the meshes, the core and the broker.
// While no other gateway is about, it says nothing and every robot is this gateway's.
#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/broker_link.hpp"
#include "daemon/core/log_throttle.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/rights_probe.hpp"
#include "daemon/fleet/fleet_subscriptions.hpp"
#include "daemon/fleet/membership.hpp"
#include "daemon/fleet/online_gateways.hpp"
#include "daemon/fleet/pending_wills.hpp"
#include "daemon/fleet/robot_claims.hpp"
#include "daemon/fleet/settings.hpp"
#include "daemon/fleet/shared_commands.hpp"

namespace slamgw::fleet {

using LocalRobots = std::function<std::vector<LocalRobot>()>;

class Ownership {
 public:
  Ownership(FleetTopics topics, Settings settings, LocalRobots local_robots);

  /// `is_session_kept`: the broker still has what an earlier connection has subscribed.
  void on_broker_link(bool is_up, const Now& now, bool is_session_kept = false);
  /// What the broker says to a subscription, of the fleet or not.
  void on_subscribe_result(const std::string& filter, SubscribeAnswer answer, const Now& now);
  /// True when the message is between gateways, and not for robots.
  bool on_broker_message(const BrokerMessage& message, const Now& now);
  /// As the message above, read already.
  void on_fleet_message(const FleetMessage& message, const Now& now);
  /// The robot was heard by radio here just now.
  void on_heard(const std::string& robot, const Now& now);
  /// As on_heard, of a robot in a mesh that boards of other gateways hear, too: it is claimed only
  /// when nobody serves it, or when this gateway should (BoardChoice).
  void on_heard_too(const std::string& robot, std::optional<SignalLevel> level, const Now& now);
  /// The core has forgotten the robot.
  void on_forgotten(const std::string& robot) { claims_.on_forgotten(robot); }
  /// This gateway's board in such a mesh works, or does not.
  void on_board(bool is_up, const Now& now) { claims_.on_board(is_up, now); }
  /// A message for a robot from the broker, which only its owner may carry out. `may_be_copy`:
  /// until this gateway is a member, two subscriptions may bring it, and a broker of MQTT 3.1.1
  /// does not tell which copy is of which.
  void on_command(BrokerMessage message, std::string robot, std::string type, const Now& now,
                  bool may_be_copy = false);
  /// The robot's keep-alive is over here.
  void on_will(Report will, const Now& now);
  /// Answers GiveUpRobot.
  void on_given_up(const std::string& robot, const Claim& to, Bytes session, const Now& now);
  /// The outcome of a command of this gateway, `after` the command came. Others may publish one in
  /// this gateway's place while it is cut off: it is held back until then, and dropped if they
  /// have.
  void on_own_outcome(BrokerMessage outcome, Duration after, const Now& now);
  /// The broker has acknowledged PublishOutcomeNow, or does not take it.
  void on_outcome_acknowledged(std::uint64_t id) { commands_.on_outcome_acknowledged(id); }
  void on_outcome_refused(std::uint64_t id) { commands_.on_outcome_refused(id); }
  /// The daemon stops: publishes the outcomes that were held back, and no further `online`.
  void on_stop();
  /// Another gateway has published the outcome of a command, `after` it had carried it out, or got
  /// it.
  void on_outcome(const std::string& gateway, const std::string& robot, const std::string& type,
                  const Now& now, Duration after = {});

  std::optional<OwnershipAction> next_action() { return membership_.actions.pop(); }
  std::optional<TimePoint> deadline() const;
  void on_deadline(const Now& now);

  using Phase = fleet::Phase;
  Phase phase() const { return membership_.phase; }
  bool is_alone() const { return membership_.phase == Phase::alone; }
  /// Commands and wills wait: other gateways are on this broker, or that is not known yet.
  bool is_shared() const { return !is_alone() || is_discovering_; }
  /// Other gateways may be on this broker, or may have published outcomes before this process
  /// began.
  bool may_be_shared() const {
    return settings_.enabled != Enabled::no && (!is_alone() || !has_discovered_);
  }
  /// Wills wait for answers of the other gateways or of the broker.
  bool holds_wills() const {
    return !is_alone() || (!is_stopping_ && (is_discovering_ || may_be_shared()));
  }
  bool is_holding_wills() const { return !wills_.is_empty(); }
  /// Presence, and what operators see: false when another living gateway has the robot.
  bool speaks_for(const std::string& robot, TimePoint now) const {
    return is_alone() || claims_.speaks_for(robot, now);
  }
  /// Whether the robot's presence may be published. But for `offline` not while other gateways may
  /// serve it unheard: TakeOverRobot follows when this gateway is to announce it. A gateway that
  /// may be alone announces a robot that `has_just_come` at once.
  bool may_announce(const std::string& robot, Presence presence, bool has_just_come,
                    TimePoint now) const;
  /// Whether this gateway may act for the robot just now: owns it, and its lease lasts.
  bool may_act_for(const std::string& robot, TimePoint now) const {
    return is_alone() || (membership_.may_act(now) && claims_.is_held(robot));
  }
  /// The same for a robot that other gateways hear, too: not before discovery has ended.
  bool may_serve(const std::string& robot, TimePoint now) const;
  bool is_leased(TimePoint now) const { return membership_.lease.is_valid(now); }
  /// How often this gateway has served nobody for a while, because its beats came back too late.
  std::uint64_t lease_lapses() const { return membership_.lease.lapses(); }
  /// What the broker's access control list keeps this gateway from, as far as that shows.
  std::vector<MissingRight> missing_rights(TimePoint now) const;

  const std::map<std::string, OnlineGateways::State>& states() const { return online_.all(); }
  const std::string& name() const { return membership_.me; }

  struct Place {
    std::string gateway;
    WallTime since{};  ///< when this gateway learned of it
    bool is_alive = false;
  };
  std::optional<Place> place_of(const std::string& robot, TimePoint now) const;
  const ClaimTable& claims() const { return membership_.table; }
  const Peers& peers() const { return membership_.peers; }
  std::size_t owned() const { return claims_.held(); }
  Counters counters() const;
  Life life() const { return membership_.lease.life(); }

 private:
  static constexpr std::chrono::seconds echo_patience{10};
  /// For a broker that gave back what this process wrote: it is more likely slow than forbidding.
  static constexpr std::chrono::seconds known_echo_patience{60};

  void end_discovery(TimePoint now);
  void decide_alone(TimePoint now);
  void take_over_local_robots();
  void wake_up(const Now& now);
  void fall_asleep(std::string why, TimePoint now);
  void on_foreign_life(const FleetMessage& message, TimePoint now);
  bool counts(const FleetMessage& message, TimePoint now) const;
  /// A broker that lets nothing through does not say so.
  bool is_unheard(TimePoint now) const {
    return !was_echoed_ && now - woken_ >= (has_been_echoed_ ? known_echo_patience : echo_patience);
  }
  void on_unheard(TimePoint now);
  void begin_life(TimePoint now);
  bool keep_company(TimePoint now);
  void send_beat(TimePoint now);
  Duration period() const;
  void on_own_beat(const Beat& beat, TimePoint now);
  void handle(const std::string& sender, Life life, const Beat& beat, const Now& now);
  void handle(const std::string& sender, Life life, const ClaimRobot& claim, const Now& now);
  void handle(const std::string& sender, Life life, const AskForSign& ask, const Now& now);
  void handle(const std::string& sender, Life life, const Heard& heard, const Now& now);
  void handle(const std::string& sender, Life life, const Taken& taken, const Now& now);
  void handle(const std::string& sender, Life life, const Release& release, const Now& now);
  void handle(const std::string& sender, Life life, const AskTable& ask, const Now& now);
  void handle(const std::string& sender, Life life, const Table& table, const Now& now);
  void handle(const std::string& sender, Life life, const Hears& hears, const Now& now);
  void decide_won(TimePoint now);
  /// When the table is full, most of what is missing has no room, but what is too much goes.
  void compare_digest(const std::string& gateway, Life life, bool was_away, TimePoint now);
  void publish_table_to_all(TimePoint now);
  bool is_in_step(TimePoint now) const;
  void on_other_gateway(const std::string& gateway, const Now& now);
  void on_gateway_state(const BrokerMessage& message, std::string_view gateway, const Now& now);
  void on_malformed(std::string_view sender, TimePoint now);
  bool is_busy() const;
  void finish_joining(const Now& now);
  void remember_others(bool are_about);
  void forget_the_dead(TimePoint now);

  Settings settings_;
  LocalRobots local_robots_;
  Membership membership_;
  FleetSubscriptions subscriptions_{membership_};
  RobotClaims claims_{membership_};
  SharedCommands commands_{membership_, claims_};
  PendingWills wills_{membership_, claims_};

  bool is_link_up_ = false;
  TimePoint link_lost_{};
  bool is_discovering_;                      ///< whether others are on this broker is not known yet
  std::optional<TimePoint> discovery_ends_;  ///< at the latest
  bool is_state_answered_ = false;           ///< the broker has answered the subscription to states
  bool has_discovered_ = false;              ///< in this process
  std::optional<TimePoint> rediscovery_due_;  ///< for gateways that are `online` and silent
  TimePoint next_beat_{};
  bool is_first_beat_ = true;  ///< on this connection
  TimePoint last_deadline_{};
  TimePoint woken_{};
  bool was_echoed_ = false;       ///< on this connection, in this life
  bool has_been_echoed_ = false;  ///< on any
  LogThrottle unheard_{std::chrono::hours{1}};
  bool is_muted_ = false;     ///< the broker does not let this gateway speak to others
  TimePoint last_company_{};  ///< when another gateway was last about
  OnlineGateways online_;

  bool is_stopping_ = false;  ///< `online` is not published any more
  std::optional<TimePoint> table_published_;
  std::optional<TimePoint> table_due_;  ///< several gateways have asked for it
  TimePoint forgotten_at_{};
  LogThrottle rivals_{std::chrono::minutes{1}};
  Life rival_ = 0;  ///< whose beat came last in this gateway's name
  LogThrottle malformed_throttle_;
  std::uint64_t malformed_ = 0;
  std::uint64_t void_claims_ = 0;  ///< of gateways or lives that do not live
};

}  // namespace slamgw::fleet
