// SPDX-License-Identifier: Apache-2.0
// Commands that every gateway hears and only one may carry out. Each waits here until its robot's
// owner has said that it takes it, or until nobody has: `Taken` of one gateway cancels one equal
// command at all others, whichever comes first. Pure; part of SharedCommands, which decides who
// may.
#pragma once

#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/fleet/done_commands.hpp"
#include "daemon/fleet/fleet_message.hpp"

namespace slamgw::fleet {

class CommandTurns {
 public:
  /// Without an owner for so long, a command is refused.
  static constexpr std::chrono::seconds owner_patience{5};
  /// A living owner may not have got it: after so long somebody refuses it in its place.
  static constexpr std::chrono::seconds last_patience{8};
  /// Who is to refuse it may not have got it either: then the next does, up to so many.
  static constexpr std::chrono::seconds refusal_turn{2};
  static constexpr int max_refusal_turns = 3;
  static constexpr std::chrono::seconds repeat_interval{1};
  /// Then it is forgotten: nobody could take it.
  static constexpr std::chrono::seconds kept_for =
      last_patience + (max_refusal_turns + 1) * refusal_turn;
  /// A refusal stands when nobody has said for so long that he takes the command.
  static constexpr std::chrono::milliseconds refusal_settling{2500};
  /// Of two gateways that take a command the one that must not make way waits so long for its own
  /// word to come back; if it was lost, the other one has not heard it.
  static constexpr std::chrono::seconds contest_patience{1};
  /// `Taken` may overtake its command by so much. Longer, and it would cancel the next equal one.
  static constexpr std::chrono::seconds cancelled_kept_for{12};
  /// The broker's copies of what others took come within this time.
  static constexpr std::chrono::seconds taken_kept_for{40};
  /// Longer than any outcome takes (contract section 6, promise 6).
  static constexpr std::chrono::seconds outcome_patience{31};
  /// Beyond these the oldest goes. As CommandLedger::default_max_open.
  static constexpr std::size_t max_waiting = 65536;
  static constexpr std::size_t max_waiting_octets = std::size_t{16} * 1024 * 1024;
  static constexpr std::size_t max_taken = 65536;

  struct Waiting {
    BrokerMessage message;
    std::string robot;
    std::string type;
    std::uint64_t key = 0;
    TimePoint came{};
    std::uint64_t taking = 0;  ///< the id of our Taken that is under way; 0: none
    bool is_refusal = false;   ///< our Taken says that we only refuse it
    unsigned copies = 0;       ///< of our Taken
    TimePoint taken{};         ///< when our Taken went out first
    TimePoint said{};          ///< and last
    std::optional<TimePoint>
        contested;                     ///< since when another gateway takes it too, and must yield
    std::optional<TimePoint> settles;  ///< our Taken came back: refused then
  };
  /// What a gateway has taken and not yet told an outcome of.
  struct Owed {
    std::string gateway;
    Life life = 0;
    std::uint64_t key = 0;
    std::string robot;
    std::string type;
    TimePoint taken{};
    TimePoint came{};  ///< the command, to that gateway
  };

  explicit CommandTurns(DoneCommands& done) : done_(done) {}

  static std::uint64_t key_of(const BrokerMessage& command);

  enum class Choice : std::uint8_t { wait, take, refuse, forget };
  using Choose = std::function<Choice(const Waiting&)>;
  /// Whether this gateway has owned the command's robot since it said that it takes it.
  using StillOwns = std::function<bool(const Waiting&)>;

  /// Asks at once; leaves what is to be said to all.
  std::vector<Taken> add(BrokerMessage message, std::string robot, std::string type,
                         const Choose& choose, TimePoint now);
  /// Asks for each that is not being taken.
  std::vector<Taken> decide(const Choose& choose, TimePoint now);
  /// What was said and has not come back, to be said again: it may have been lost.
  std::vector<Taken> repeat(TimePoint now);
  /// Somebody else takes one. What this gateway must answer: it has taken that command already, and
  /// the other one has missed it.
  std::optional<Taken> on_taken(const std::string& gateway, Life life, const Taken& taken,
                                const std::string& own_gateway, const StillOwns& still_owns,
                                TimePoint now);
  /// Who made way for this gateway has dealt with this command of the robot.
  void on_done(const std::string& gateway, Life life, const std::string& robot,
               const DoneCommand& done, TimePoint now);
  /// Our own `Taken` came back: this command is ours. Nothing when it is to be refused: then
  /// take_refused() has it later, unless somebody else says until then that he takes it.
  std::optional<Waiting> on_own_taken(std::uint64_t id, const StillOwns& still_owns, TimePoint now);
  /// Those that nobody else has taken while their refusal settled.
  std::vector<Waiting> take_refused(TimePoint now);
  /// Those that had no room.
  std::vector<Waiting> take_dropped() { return std::exchange(dropped_now_, {}); }
  /// All that wait, in the order they came.
  std::vector<Waiting> take_all();
  /// A new life begins: what was being taken is to be taken again.
  void on_new_life();
  /// A gateway has told an outcome, of what it has taken itself or in the place of a dead one.
  void on_outcome(const std::string& gateway, const std::string& robot, const std::string& type,
                  TimePoint now);
  /// Asks about each whose outcome is overdue: `tell` it here, `forget` it, or `wait`.
  enum class Fate : std::uint8_t { wait, tell, forget };
  std::vector<Owed> take_overdue(const std::function<Fate(const Owed&)>& fate_of, TimePoint now);
  /// Nobody else is about whose outcomes could be missing.
  void forget_owed() { owed_.clear(); }
  bool is_empty() const { return waiting_.empty(); }
  std::size_t size() const { return waiting_.size(); }
  std::uint64_t dropped() const { return dropped_; }

 private:
  /// How often a refusal is said while it settles.
  static constexpr unsigned refusal_copies = 3;

  using Number = std::uint64_t;  // of a waiting command, in the order they came
  struct Heard {
    std::string gateway;
    Life life = 0;
    std::uint64_t id = 0;
    TimePoint at{};
  };

  static Taken to_taken(const Waiting& waiting, TimePoint now);
  bool is_cancelled(std::uint64_t key);
  void decide_one(std::map<Number, Waiting>::iterator each, const Choose& choose, TimePoint now,
                  std::vector<Taken>& said);
  bool cancel(const std::string& gateway, const Taken& taken, const std::string& own_gateway,
              const StillOwns& still_owns, TimePoint now);
  Waiting remove(std::map<Number, Waiting>::iterator each);
  Waiting finish(std::map<Number, Waiting>::iterator each, TimePoint now);
  std::optional<Taken> answer(const Taken& taken, TimePoint now) const;
  bool is_news(const std::string& gateway, Life life, std::uint64_t id, TimePoint now);
  void owe(const std::string& gateway, Life life, const Taken& taken, TimePoint now);
  void make_room();
  void forget_old(TimePoint now);

  DoneCommands& done_;
  std::map<Number, Waiting> waiting_;
  std::unordered_map<std::uint64_t, std::set<Number>> by_key_;  ///< of those that wait
  std::map<std::uint64_t, Number> taking_;                      ///< by the id of our Taken
  Number last_number_ = 0;
  std::size_t waiting_octets_ = 0;
  std::vector<Waiting> dropped_now_;
  /// Taken by others, and not heard here yet: when, by key and in the order of time.
  std::unordered_map<std::uint64_t, std::deque<TimePoint>> cancelled_;
  std::deque<std::pair<TimePoint, std::uint64_t>> cancelled_order_;
  std::deque<Heard> heard_order_;
  std::set<std::tuple<std::string, Life, std::uint64_t>> heard_;
  std::deque<Owed> owed_;
  std::uint64_t last_id_ = 0;
  std::uint64_t dropped_ = 0;
};

}  // namespace slamgw::fleet
