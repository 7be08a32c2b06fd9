// SPDX-License-Identifier: Apache-2.0
// Which gateway serves which robot, as one gateway sees it: claims with epochs of which the
// greatest wins, a lease that the owner checks by its own clock, and commands and wills that only
// the owner deals with (docs/fleet.md). A pure machine between the meshes, the core and the broker.
// While no other gateway is about, it says nothing and every robot is this gateway's.
#pragma once

#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "daemon/core/log_throttle.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/rights_probe.hpp"
#include "daemon/core/subscribe_answer.hpp"
#include "daemon/fleet/membership.hpp"
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
  /// This gateway's board in such a mesh works, or does not.
  void on_board(bool is_up, const Now& now) { claims_.on_board(is_up, now); }
  /// A message for a robot from the broker, which only its owner may carry out.
  void on_command(BrokerMessage message, std::string robot, std::string type, const Now& now);
  /// The robot's keep-alive is over here.
  void on_will(Report will, const Now& now);
  /// Answers GiveUpRobot.
  void on_given_up(const std::string& robot, const Claim& to, Bytes session, const Now& now);
  /// What a command here has come to, `after` it came. Others tell it in this gateway's place when
  /// it was cut off, so it is held back meanwhile, and dropped when it is too late.
  void on_own_outcome(BrokerMessage outcome, Duration after, const Now& now);
  /// The daemon ends: outcomes that were held back are for the store.
  void on_stop() { commands_.tell_all_outcomes(); }
  /// Another gateway has told the outcome of a command.
  void on_outcome(const std::string& gateway, const std::string& robot, const std::string& type,
                  const Now& now);

  std::optional<OwnershipAction> next_action() { return membership_.actions.pop(); }
  std::optional<TimePoint> deadline() const;
  void on_deadline(const Now& now);

  using Phase = fleet::Phase;
  Phase phase() const { return membership_.phase; }
  bool is_alone() const { return membership_.phase == Phase::alone; }
  /// Commands and wills wait here: others are about, or it is too early to know.
  bool is_shared() const { return !is_alone() || is_looking_; }
  /// Others may be about, or have told outcomes before this process began.
  bool may_be_shared() const {
    return settings_.enabled != Enabled::no && (!is_alone() || !has_looked_);
  }
  /// Presence, and what operators see: false when another living gateway has the robot.
  bool speaks_for(const std::string& robot, TimePoint now) const {
    return is_alone() || claims_.speaks_for(robot, now);
  }
  /// Whether this gateway may act for the robot just now: owns it, and its lease lasts.
  bool may_act_for(const std::string& robot, TimePoint now) const {
    return is_alone() || (membership_.may_act(now) && claims_.is_held(robot));
  }
  /// The same for a robot that other gateways hear, too: not before it is known who is about.
  bool may_serve(const std::string& robot, TimePoint now) const;
  bool is_leased(TimePoint now) const { return membership_.lease.is_valid(now); }
  /// What the broker's access control list keeps this gateway from, as far as that shows.
  std::vector<MissingRight> missing_rights(TimePoint now) const;

  /// What another gateway's retained `state` says.
  struct State {
    std::string version;
    std::string since;
    TimePoint heard{};
  };
  const std::map<std::string, State>& states() const { return states_; }
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

  struct Question {
    std::vector<Report> wills;
    std::optional<TimePoint> asked;
    std::optional<TimePoint> echoed;
  };

  void end_look(TimePoint now);
  void decide_alone(TimePoint now);
  void wake_up(const Now& now);
  void subscribe(const std::string& filter);
  void fall_asleep(std::string why, TimePoint now);
  void unsubscribe_stale();
  void on_foreign_life(const FleetMessage& message, TimePoint now);
  /// A broker that lets nothing through does not say so.
  bool is_unheard(TimePoint now) const {
    return !was_ever_echoed_ && now - woken_ >= echo_patience;
  }
  void begin_life(TimePoint now);
  bool keep_company(TimePoint now);
  void send_beat(TimePoint now);
  Duration period() const;
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
  void compare_digest(const std::string& gateway, Life life, TimePoint now);
  bool is_in_step(TimePoint now) const;
  void on_other_gateway(const std::string& gateway, const Now& now);
  void on_gateway_state(const BrokerMessage& message, std::string_view gateway, const Now& now);
  void on_malformed(std::string_view sender, TimePoint now);
  bool is_busy() const;
  void finish_joining(const Now& now);
  void look_at_questions(const Now& now);
  void ask_for_sign(const std::string& robot, Question& question, TimePoint now);
  bool is_answered(Question& question, const Now& now);
  void forget_the_dead(TimePoint now);

  Settings settings_;
  LocalRobots local_robots_;
  Membership membership_;
  RobotClaims claims_{membership_};
  SharedCommands commands_{membership_, claims_};

  bool is_link_up_ = false;
  bool is_looking_;                  ///< it is not known yet whether others are about
  std::optional<TimePoint> looked_;  ///< then it is, as far as the broker tells
  bool is_state_answered_ = false;   ///< the broker has answered the subscription to states
  bool has_looked_ = false;          ///< in this process
  bool is_session_kept_ = false;     ///< the broker may have subscriptions of an earlier process
  std::optional<TimePoint> look_again_;  ///< for gateways that are `online` and silent
  TimePoint next_beat_{};
  TimePoint last_look_{};
  TimePoint woken_{};
  bool was_ever_echoed_ = false;
  bool is_muted_ = false;                ///< the broker does not let this gateway speak to others
  TimePoint last_company_{};             ///< when another gateway was last about
  std::map<std::string, State> states_;  ///< other gateways that are online; at most max_peers

  std::set<std::string> subscribed_;
  std::map<std::string, Question> questions_;
  std::optional<TimePoint> table_told_;
  TimePoint forgotten_at_{};
  LogThrottle rivals_{std::chrono::minutes{1}};
  Life rival_ = 0;  ///< whose beat came last in this gateway's name
  LogThrottle malformed_throttle_;
  std::uint64_t malformed_ = 0;
  std::uint64_t void_claims_ = 0;  ///< of gateways or lives that do not live
};

}  // namespace slamgw::fleet
