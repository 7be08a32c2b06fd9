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
#include <unordered_map>
#include <unordered_set>
#include <variant>
#include <vector>

#include "daemon/core/log_throttle.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/protocol_machine.hpp"
#include "daemon/core/rights_probe.hpp"
#include "daemon/core/subscribe_answer.hpp"
#include "daemon/fleet/claim_table.hpp"
#include "daemon/fleet/command_turns.hpp"
#include "daemon/fleet/fleet_topics.hpp"
#include "daemon/fleet/peers.hpp"
#include "daemon/fleet/roam_guard.hpp"
#include "daemon/fleet/settings.hpp"

namespace slamgw::fleet {

/// At the broker, now or never: nothing of it is of use later.
struct PublishNow {
  BrokerMessage message;
};
struct SubscribeFleet {
  std::string filter;
  Qos qos = Qos::at_least_once;
};
struct UnsubscribeFleet {
  std::string filter;
};
/// The robot is this gateway's from now on. `dead_owner`: may have left presence behind.
struct TakeOverRobot {
  std::string robot;
  std::string dead_owner;  ///< empty: it was nobody's, or its owner has made way
  Bytes session;           ///< what the former owner knew of it; may be empty
};
/// The robot is another gateway's: its session ends here without will, its presence is withdrawn.
/// Answered by on_given_up() with the session when `is_awaited`.
struct GiveUpRobot {
  std::string robot;
  Claim to;
  bool is_awaited = false;
};
struct CarryOut {
  BrokerMessage command;
};
struct EndCommand {
  std::string robot;
  std::string type;
  CommandResult result = CommandResult::refused;
  std::string why;
  Duration after{};  ///< since it came here; zero: it did not
};
/// Stored, if the broker is away.
struct TellOutcome {
  BrokerMessage message;
};
struct PublishWill {
  Report will;
};

using OwnershipAction =
    std::variant<PublishNow, SubscribeFleet, UnsubscribeFleet, TakeOverRobot, GiveUpRobot, CarryOut,
                 EndCommand, TellOutcome, PublishWill, Notice>;

/// A robot that has a session or was heard at this gateway.
struct LocalRobot {
  std::string robot;
  bool is_online = true;  ///< its claim beats that of a gateway where it is not
};
using LocalRobots = std::function<std::vector<LocalRobot>()>;

class Ownership {
 public:
  Ownership(FleetTopics topics, Settings settings, LocalRobots local_robots);

  void on_broker_link(bool is_up, const Now& now);
  /// What the broker says to a subscription, of the fleet or not.
  void on_subscribe_result(const std::string& filter, SubscribeAnswer answer, const Now& now);
  /// True when the message was the fleet's own business.
  bool on_broker_message(const BrokerMessage& message, const Now& now);
  /// As the message above, read already.
  void on_fleet_message(const FleetMessage& message, const Now& now);
  /// The robot was heard by radio here just now.
  void on_heard(const std::string& robot, const Now& now);
  /// A message for a robot from the broker, which only its owner may carry out.
  void on_command(BrokerMessage message, std::string robot, std::string type, const Now& now);
  /// The robot's keep-alive is over here.
  void on_will(Report will, const Now& now);
  /// Answers GiveUpRobot.
  void on_given_up(const std::string& robot, const Claim& to, Bytes session);
  /// What a command here has come to, `after` it came. Others tell it in this gateway's place when
  /// it was cut off, so it is held back meanwhile, and dropped when it is too late.
  void on_own_outcome(BrokerMessage outcome, Duration after, const Now& now);
  /// Another gateway has told the outcome of a command.
  void on_outcome(const std::string& gateway, const std::string& robot, const std::string& type,
                  const Now& now);

  std::optional<OwnershipAction> next_action() { return actions_.pop(); }
  std::optional<TimePoint> deadline() const;
  void on_deadline(const Now& now);

  enum class Phase : std::uint8_t {
    alone,    ///< nobody else is about: every robot is ours, nothing is said
    joining,  ///< listens to the others before it claims what it has
    member,
  };
  Phase phase() const { return phase_; }
  bool is_alone() const { return phase_ == Phase::alone; }
  /// Commands and wills wait here: others are about, or it is too early to know.
  bool is_shared() const { return phase_ != Phase::alone || is_looking_; }
  /// Presence, and what operators see: false when another living gateway has the robot.
  bool speaks_for(const std::string& robot, TimePoint now) const;
  /// Whether this gateway may act for the robot just now: owns it, and its lease lasts.
  bool may_act_for(const std::string& robot, TimePoint now) const;
  bool is_leased(TimePoint now) const { return now < leased_until_; }
  /// What the broker's access control list keeps this gateway from, as far as that shows.
  std::vector<MissingRight> missing_rights(TimePoint now) const;

  /// What another gateway's retained `state` says.
  struct State {
    std::string version;
    std::string since;
  };
  const std::map<std::string, State>& states() const { return states_; }
  const std::string& name() const { return me_; }

  struct Place {
    std::string gateway;
    WallTime since{};  ///< when this gateway learned of it
    bool is_alive = false;
  };
  std::optional<Place> place_of(const std::string& robot, TimePoint now) const;
  const ClaimTable& claims() const { return table_; }
  const Peers& peers() const { return peers_; }
  std::size_t owned() const { return held_.size(); }
  Counters counters() const;
  Life life() const { return life_; }

 private:
  static constexpr std::chrono::milliseconds objection_interval{1000};
  static constexpr std::chrono::seconds echo_patience{10};

  /// A robot that this gateway has claimed and does not own yet.
  struct Claiming {
    std::string former;    ///< who is asked to make way
    bool is_bulk = false;  ///< claimed with a Table
    TimePoint since{};
    TimePoint said{};
    std::optional<TimePoint> echoed;
    std::map<std::string, Life> awaited;  ///< who may serve the robot still
    std::set<std::string> released;
    bool was_released = false;  ///< somebody made way: no need to wait for rivals
    Bytes session;
  };
  struct Question {
    std::vector<Report> wills;
    std::optional<TimePoint> asked;
    bool is_echoed = false;
  };

  void end_look(TimePoint now);
  void decide_alone(TimePoint now);
  void wake_up(const Now& now);
  void subscribe(const std::string& filter);
  void fall_asleep(std::string why, TimePoint now);
  /// A broker that lets nothing through does not say so.
  bool is_unheard(TimePoint now) const {
    return !was_ever_echoed_ && now - woken_ >= echo_patience;
  }
  void begin_life(TimePoint now);
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
  void on_own_beat(const Beat& beat, TimePoint now);
  void on_own_claim(const std::string& robot, std::uint64_t epoch, const Now& now);
  void on_own_taken(const Taken& taken, const Now& now);
  bool is_living(const Claim& claim, TimePoint now) const;
  bool is_mine(const Claim& claim) const { return claim.gateway == me_ && claim.life == life_; }
  /// The one place where another gateway's claim enters the table.
  void merge(const std::string& robot, const Claim& claim, const std::string& from, const Now& now);
  void on_lesser_claim(const std::string& robot, const Claim& claim, const Claim& row,
                       const std::string& from, const Now& now);
  void give_way(const std::string& robot, const Claim& to);
  void release(const std::string& robot, const Claim& to, const std::string& receiver,
               Bytes session);
  void claim(const std::string& robot, const Now& now);
  void claim_unless_guarded(const std::string& robot, const Now& now);
  void say_claim(const std::string& robot, Claiming& claiming, TimePoint now);
  void look_at_claims(const Now& now);
  bool is_won(Claiming& claiming, TimePoint now) const;
  void own(const std::string& robot, const Now& now);
  void compare_digest(const std::string& gateway, Life life, TimePoint now);
  void tell_table(const std::string& topic);
  bool is_in_step(TimePoint now) const;
  void on_other_gateway(const std::string& gateway, const Now& now);
  void on_gateway_state(const BrokerMessage& message, std::string_view gateway, const Now& now);
  void on_malformed(std::string_view sender, TimePoint now);
  bool is_busy() const;
  void finish_joining(const Now& now);
  void decide_commands(const Now& now);
  CommandTurns::Choice choose(const CommandTurns::Waiting& waiting, TimePoint now) const;
  int rank_for(const std::string& robot, TimePoint now) const;
  void look_at_questions(const Now& now);
  void ask_for_sign(const std::string& robot, Question& question, TimePoint now);
  bool is_answered(Question& question, const Now& now);
  void end_overdue_commands(TimePoint now);
  void tell_outcomes(TimePoint now);
  void forget_the_dead(TimePoint now);
  void publish(std::string topic, const Body& body, Qos qos);
  void tell_all(const Body& body) { publish(topics_.all(), body, Qos::at_least_once); }
  void notice(Severity severity, std::string text, const std::string& robot = {});

  FleetTopics topics_;
  Settings settings_;
  LocalRobots local_robots_;
  const std::string me_;

  Phase phase_ = Phase::alone;
  bool is_link_up_ = false;
  bool is_looking_;                  ///< it is not known yet whether others are about
  std::optional<TimePoint> looked_;  ///< then it is, as far as the broker tells
  bool is_state_answered_ = false;   ///< the broker has answered the subscription to states
  Life life_;
  TimePoint joined_{};  ///< when the first beat of this life came back, else its start
  bool has_echo_ = false;
  TimePoint leased_until_{};
  TimePoint dead_at_{};  ///< when others call this life dead
  TimePoint next_beat_{};
  TimePoint last_look_{};
  TimePoint woken_{};
  bool was_ever_echoed_ = false;
  bool is_muted_ = false;                ///< the broker does not let this gateway speak to others
  TimePoint last_company_{};             ///< when another gateway was last about
  std::map<std::string, State> states_;  ///< other gateways that are online; at most max_peers

  std::set<std::string> subscribed_;
  ClaimTable table_;
  Peers peers_;
  std::unordered_set<std::string> held_;  ///< robots that this gateway owns
  std::map<std::string, Claiming> claiming_;
  std::unordered_map<std::string, TimePoint> heard_;  ///< by radio, here
  std::map<std::string, TimePoint> objected_;
  std::map<std::string, Question> questions_;
  CommandTurns turns_;
  struct Untold {
    BrokerMessage outcome;
    TimePoint came{};
  };
  std::deque<Untold> untold_;  ///< outcomes that wait for the lease; at most max_untold
  TimePoint life_began_{};
  RoamGuard guard_;
  std::optional<TimePoint> table_told_;
  TimePoint forgotten_at_{};
  std::vector<std::string> stale_;  ///< rows of the dead at the last sweep
  LogThrottle restless_{std::chrono::minutes{1}};
  LogThrottle malformed_throttle_;
  std::uint64_t malformed_ = 0;
  std::uint64_t void_claims_ = 0;  ///< of gateways or lives that do not live
  std::uint64_t roams_in_ = 0;
  std::uint64_t roams_out_ = 0;
  ActionQueue<OwnershipAction> actions_;
};

}  // namespace slamgw::fleet
