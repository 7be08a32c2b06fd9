// SPDX-License-Identifier: Apache-2.0
// Which robots this gateway claims, owns and makes way for: the greatest claim wins, and the owner
// before must have made way or be dead. Pure; part of Ownership.
#pragma once

#include <map>
#include <optional>
#include <set>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "daemon/core/log_throttle.hpp"
#include "daemon/fleet/board_choice.hpp"
#include "daemon/fleet/membership.hpp"
#include "daemon/fleet/roam_guard.hpp"
#include "daemon/fleet/table_sweep.hpp"

namespace slamgw::fleet {

/// A robot that has a session or was heard at this gateway.
struct LocalRobot {
  std::string robot;
  bool is_online = true;  ///< its claim beats that of a gateway where it is not
};

class RobotClaims {
 public:
  explicit RobotClaims(Membership& membership) : membership_(membership) {}

  /// By radio, here.
  void on_heard(const std::string& robot, const Now& now);
  /// By a board that is not the only one to hear it.
  void on_heard_too(const std::string& robot, std::optional<SignalLevel> level, const Now& now);
  /// The core has forgotten the robot: what this gateway has heard and claimed of it goes, too.
  /// Other gateways notice by the digest. It is claimed again when it is heard again.
  void on_forgotten(const std::string& robot);
  void on_board(bool is_up, const Now& now);
  void on_hears(const std::string& sender, const Hears& hears, const Now& now);
  /// `sender` asks for a robot that was heard here: claims it if `sender` owns it.
  void on_question(const std::string& robot, const std::string& sender, const Now& now);
  void on_own_claim(const std::string& robot, std::uint64_t epoch, const Now& now);
  void on_claim(const std::string& robot, const Claim& claim, const std::string& from,
                const Now& now);
  void on_release(const std::string& sender, const Release& release, const Now& now);
  void on_table(const std::string& sender, Life life, const Table& table, const Now& now);
  /// Answers GiveUpRobot.
  void on_given_up(const std::string& robot, const Claim& to, Bytes session, TimePoint now);
  void on_deadline(const Now& now);

  /// A new life has claimed nothing yet.
  void begin_life();
  /// Claims at once what is here and nobody else has, and what has come here while this gateway
  /// joined; gives up what else others have taken over.
  void join(const std::vector<LocalRobot>& local, const Now& now);
  void forget_all();
  /// Claims of lives that were over at the last call already.
  void forget_the_dead(TimePoint now);
  void publish_table(const std::string& topic);

  bool is_held(const std::string& robot) const { return held_.contains(robot); }
  /// Since when the robot is this gateway's; nothing when it is not.
  std::optional<TimePoint> held_since(const std::string& robot) const;
  std::size_t held() const { return held_.size(); }
  bool is_busy() const { return !claiming_.empty() || !passing_.empty(); }
  /// False when another living gateway has the robot.
  bool speaks_for(const std::string& robot, TimePoint now) const;
  std::optional<TimePoint> heard_at(const std::string& robot) const;
  /// Whether a robot has become this gateway's since the last call.
  bool take_has_won() { return std::exchange(has_won_, false); }
  std::uint64_t roams_in() const { return roams_in_; }
  std::uint64_t roams_out() const { return roams_out_; }
  /// Claims for which there was no room.
  std::uint64_t not_kept() const { return not_kept_; }

 private:
  static constexpr std::chrono::milliseconds objection_interval{1000};

  using Gateways = std::map<std::string, Life>;

  /// A robot that this gateway has claimed and does not own yet.
  struct Claiming {
    std::uint64_t epoch = 0;
    TimePoint since{};
    TimePoint said{};
    unsigned times_said = 0;
    std::optional<TimePoint> echoed;
    Gateways awaited;  ///< who may serve the robot still
    std::set<std::string> released;
    bool was_released = false;  ///< somebody made way: no need to wait for rivals
    bool is_forgotten = false;  ///< since it was heard last: it is not kept when it is won
    Bytes session;
  };

  /// A robot that went on to a third gateway before the first had made way for this one. The third
  /// waits for this one, and this one for the first, whose session it passes on.
  struct Passing {
    Claim to;
    std::uint64_t epoch = 0;  ///< of this gateway's claim
    TimePoint since{};
    TimePoint said{};
    Gateways awaited;
    Bytes session;
    bool is_given_up = false;  ///< nothing of the robot is left here
    std::string former;        ///< as in formers_; empty when it has made way
  };

  /// The one place where another gateway's claim enters the table.
  void merge(const std::string& robot, const Claim& claim, const std::string& from, const Now& now);
  /// False, counted and told when there is no room.
  bool keep(const std::string& robot, const Claim& claim, const Now& now);
  void drop_own_claim(const std::string& robot);
  void on_lesser_claim(const std::string& robot, const Claim& claim, const Claim& row,
                       const std::string& from, const Now& now);
  void give_way(const std::string& robot, const Claim& to, TimePoint now);
  void begin_claim(const std::string& robot, std::uint64_t epoch, const Now& now);
  void note_predecessor(const std::string& robot, const Claim& before, const Claim& after);
  void withdraw_entries_of_predecessors(const std::string& robot, TimePoint now);
  void withdraw_entry_of_former(const std::string& robot, TimePoint now);
  void withdraw_entry(const std::string& robot, const std::string& gateway, TimePoint now);
  void withdraw_unknown_entry(const std::string& robot, const std::string& dead,
                              const std::string& claimant, TimePoint now);
  void name_owner(const std::string& robot, const Claim& claim, TimePoint now);
  bool is_among_first(const std::string& claimant, TimePoint now) const;
  void pass_on(const std::string& robot, TimePoint now);
  void on_passed(const std::string& sender, const Release& release, TimePoint now);
  void release(const std::string& robot, const Claim& to, const std::string& receiver,
               Bytes session, TimePoint now);
  void claim(const std::string& robot, const Now& now);
  void claim_unless_guarded(const std::string& robot, const Now& now);
  void claim_if_chosen(const std::string& robot, const Now& now);
  void choose_boards(const Now& now);
  bool has_come_here(const std::string& robot) const;
  void publish_claim(const std::string& robot, Claiming& claiming, TimePoint now);
  bool is_won(Claiming& claiming, TimePoint now) const;
  /// Who is dead, or was waited for long enough.
  void erase_void(Gateways& awaited, TimePoint since, TimePoint now) const;
  Duration patience_with(const std::string& gateway) const;
  void own(const std::string& robot, const Now& now);
  std::optional<std::uint64_t> next_epoch(const Claim* known, std::uint64_t first,
                                          TimePoint now) const;
  void begin_again(const std::string& robot, const Now& now);
  void drop_spent(const std::string& robot, const Claim& listed);

  Membership& membership_;
  std::unordered_map<std::string, TimePoint> held_;  ///< robots that this gateway owns, since when
  std::map<std::string, Claiming> claiming_;
  std::map<std::string, Passing> passing_;
  /// Who had a robot when this gateway claimed it, and has not made way: if it is dead, its
  /// presence entry is left behind. Kept when this gateway's life ends before it has won the robot.
  std::unordered_map<std::string, std::string> formers_;
  /// The owners of a robot before the one that the table names, of the last minutes. One that died
  /// while the next one claimed the robot, and died, too, has left its presence entry.
  std::unordered_map<std::string, std::vector<std::string>> predecessors_;
  std::unordered_map<std::string, TimePoint> heard_;
  std::map<std::string, TimePoint> objected_;
  std::vector<ClaimTable::Owner> dead_;  ///< that had claims at the last sweep
  TableSweep sweep_;
  RoamGuard guard_;
  BoardChoice boards_;
  LogThrottle restless_{std::chrono::minutes{1}};
  LogThrottle full_{std::chrono::minutes{1}};
  std::uint64_t not_kept_ = 0;
  /// The greatest epoch of this life's claims that were dropped. Others may know them still, and a
  /// lower claim would never replace them there.
  std::uint64_t dropped_epoch_ = 0;
  bool has_won_ = false;
  std::uint64_t roams_in_ = 0;
  std::uint64_t roams_out_ = 0;
};

}  // namespace slamgw::fleet
