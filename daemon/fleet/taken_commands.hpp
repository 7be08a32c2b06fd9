// SPDX-License-Identifier: Apache-2.0
// The commands that some gateway has taken lately, as far as this one knows: who has, whether this
// gateway has got its own copy, and whether the outcome is known. Pure; part of Membership.
#pragma once

#include <algorithm>
#include <chrono>
#include <deque>
#include <functional>
#include <set>
#include <string>
#include <unordered_map>
#include <vector>

#include "daemon/core/time.hpp"
#include "daemon/fleet/fleet_message.hpp"

namespace slamgw::fleet {

class TakenCommands {
 public:
  /// Two gateways hear one command within this time of each other. Of two equal ones that come
  /// closer together one may be taken for the other.
  static constexpr std::chrono::milliseconds heard_apart{1000};
  static bool came_together(TimePoint one, TimePoint other) {
    return one - other < heard_apart && other - one < heard_apart;
  }
  /// When a command came to a gateway. Its broker may have `kept` it so long before, while that
  /// gateway was cut off.
  struct Arrival {
    TimePoint came{};
    Duration kept{};
    /// The broker may have got both in one moment.
    bool may_be_with(const Arrival& other) const {
      return came - kept < other.came + heard_apart && other.came - other.kept < came + heard_apart;
    }
  };
  /// For so long this gateway objects when another one that was cut off meanwhile wants to publish
  /// an outcome, too.
  static constexpr std::chrono::minutes kept_for{10};
  /// The next owner of a robot learns what was done in this time. Longer than it takes until the
  /// last refusal of a command is said and stands.
  static constexpr std::chrono::seconds handed_on_for{40};
  /// `Taken` may overtake its command by so much. Longer, and it would cancel the next equal one.
  static constexpr std::chrono::seconds copy_expected_for{12};
  /// The same, since the command came to its taker, at the gateway that owns the robot by now: the
  /// copy may have been lost, and nobody else carries out the next equal command.
  static constexpr std::chrono::seconds owner_expects_copy_for{3};

  struct Entry {
    std::string robot;
    DoneCommand command;    ///< with the id of its Taken
    TimePoint came{};       ///< to the gateway that took it
    std::string gateway{};  ///< which one that is; empty: this one
    Life life = 0;
    bool is_refusal = false;       ///< it is taken only to be refused
    bool is_ended = false;         ///< its outcome is published
    bool is_copy_missing = false;  ///< this gateway has not got the command yet
    TimePoint taken{};             ///< set by add(): when this gateway learned of it
    Duration kept{};               ///< as in Arrival

    bool is_own() const { return gateway.empty(); }
    bool is_of(const std::string& taker, Life its_life) const {
      return gateway == taker && life == its_life;
    }
    /// An outcome that counts from then is of this command. It names the type only, and two of one
    /// type may be under way to a robot.
    bool has_begun(TimePoint time) const { return apart_from(time) < heard_apart; }
    Duration apart_from(TimePoint time) const {
      const Duration from_came = std::chrono::abs(came - time);
      return is_refusal ? from_came : std::min(from_came, std::chrono::abs(taken - time));
    }
    bool is_copy(std::uint64_t key, TimePoint time) const {
      return command.key == key && came_together(came, time);
    }
    Arrival arrival() const { return {came, kept}; }
  };
  using Matches = std::function<bool(const Entry&)>;

  /// `is_owed`: another gateway is to publish its outcome.
  void add(Entry entry, bool is_owed, TimePoint now);
  /// The oldest of this key for which that holds.
  const Entry* find(std::uint64_t key, const Matches& matches) const;
  /// The oldest with an outcome owed for which that holds.
  const Entry* find_owed(const Matches& matches) const;
  /// Of those for which it holds, the one to which an outcome that counts from `began` fits best.
  const Entry* find_owed(const Matches& matches, TimePoint began) const;
  /// True when this gateway's copy of such a command was missing: it has come. `is_owner`: of the
  /// command's robot.
  bool take_missing_copy(std::uint64_t key, bool is_owner, TimePoint now);
  /// This gateway has published the outcome of such a command that came then.
  bool has_ended(const std::string& robot, const std::string& type, TimePoint came) const;
  /// This gateway's own that came then.
  const Entry* find_own(const std::string& robot, const std::string& type, TimePoint came) const;
  /// The robot's, with their ages, the newest max_taken_commands.
  std::vector<DoneCommand> of(const std::string& robot, TimePoint now) const;
  /// Somebody has published the outcome.
  void end(std::uint64_t key, TimePoint came);
  /// Its taker does not carry it out any more.
  void turn_to_refusal(std::uint64_t key, const Matches& matches);
  /// The broker has that gateway's outcome of a command that came then, of this one when it is
  /// empty. False when no such command without an outcome is known.
  bool end_of(const std::string& gateway, const std::string& robot, const std::string& type,
              TimePoint came);
  /// Outcomes that are owed no longer. Asks about the oldest first.
  void forget_owed(const Matches& matches);
  void forget_owed() { owed_.clear(); }

 private:
  static constexpr std::size_t max_entries = 65536;
  /// Of equal ones only so many are found, the newest: each search walks through them.
  static constexpr std::size_t max_equal = 512;
  using Number = std::uint64_t;  // of an entry, in the order of `taken`

  using Entries = std::deque<Entry>;
  Entries::const_iterator find_of(const std::string& gateway, const std::string& robot,
                                  const std::string& type, TimePoint came,
                                  const Matches& matches) const;
  Entry& at(Number number) { return entries_[number - first_number_]; }
  const Entry& at(Number number) const { return entries_[number - first_number_]; }
  void drop_oldest();

  Entries entries_;
  Number first_number_ = 0;  ///< of the entry at the front; the others follow
  std::unordered_map<std::uint64_t, std::vector<Number>> by_key_;
  std::set<Number> owed_;
};

}  // namespace slamgw::fleet
