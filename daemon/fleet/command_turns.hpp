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
#include "daemon/fleet/fleet_message.hpp"
#include "daemon/fleet/taken_commands.hpp"

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
  /// A refusal stands when no other gateway takes the command for so long.
  static constexpr std::chrono::milliseconds refusal_settling{2500};
  /// Of two gateways that take a command the one that need not make way waits so long for its own
  /// Taken to come back. Then it does not know whether the other one has heard it, and refuses the
  /// command; who carries it out objects.
  static constexpr std::chrono::seconds contest_patience{1};
  /// An outcome may overtake its `Taken` by so much. Longer, and one that never had a `Taken` (of
  /// a retained command, of an operator) would pass for the next command's.
  static constexpr std::chrono::seconds early_kept_for{3};
  /// A broker delivers once more what was not acknowledged, after 30 s and after 60 s (NATS).
  static constexpr std::chrono::seconds delivered_again_for{70};
  /// A gateway that says that it ends a command does so in this time.
  static constexpr std::chrono::seconds ending_patience{5};
  static_assert(ending_patience > refusal_settling);
  /// Longer than any outcome takes (docs/topics.md, promise 6).
  static constexpr std::chrono::seconds outcome_patience{31};
  /// Not before that does a gateway publish an outcome in another one's place.
  static constexpr std::chrono::seconds in_place_after{28};
  /// Beyond these the oldest goes. As CommandLedger::default_max_open.
  static constexpr std::size_t max_waiting = 65536;
  static constexpr std::size_t max_waiting_octets = std::size_t{16} * 1024 * 1024;
  static constexpr std::size_t max_early_outcomes = 65536;

  struct Waiting {
    BrokerMessage message;
    /// The command's outcome from a former life. It waits for its turn, as a refusal does.
    std::optional<BrokerMessage> outcome;
    std::string robot;
    std::string type;
    std::uint64_t key = 0;
    TimePoint came{};
    Duration kept{};           ///< TakenCommands::Arrival
    std::uint64_t taking = 0;  ///< the id of our Taken that is under way; 0: none
    bool is_refusal = false;   ///< our Taken says that we only refuse it
    bool has_moved = false;    ///< to another gateway, the robot, while our Taken was under way
    unsigned copies = 0;       ///< of our Taken
    TimePoint taken{};         ///< when our Taken was first sent
    TimePoint last_sent{};     ///< our Taken
    std::optional<TimePoint>
        contested;                     ///< since when another gateway takes it too, and must yield
    std::optional<TimePoint> settles;  ///< our Taken came back: refused then
    bool was_taken = false;  ///< in a former life: others may have forgotten their copy since
    /// That took it and published no outcome. As a refusal, once the others were asked.
    std::string dead_owner{};
  };
  explicit CommandTurns(TakenCommands& commands) : commands_(commands) {}

  static std::uint64_t key_of(const BrokerMessage& command);

  /// Asked for each command that may come twice, before it is added: true for every second one of
  /// equal ones that come within TakenCommands::heard_apart of each other.
  bool is_copy(const BrokerMessage& command, TimePoint now);

  /// Asked for each command before it is added: another gateway has dealt with it already.
  bool take_missing_copy(const BrokerMessage& command, bool is_owner, TimePoint now);

  /// Asked for each command that the broker may have delivered before: such a one waits here or was
  /// taken lately.
  bool is_known(const BrokerMessage& command, TimePoint now) const;

  enum class Choice : std::uint8_t { wait, take, refuse, forget };
  using Choose = std::function<Choice(const Waiting&)>;
  /// Whether this gateway has owned the command's robot since it said that it takes it.
  using StillOwns = std::function<bool(const Waiting&)>;

  /// Asks at once; returns what is to be sent to all.
  /// `kept`: TakenCommands::Arrival.
  std::vector<Taken> add(BrokerMessage message, std::string robot, std::string type, Duration kept,
                         const Choose& choose, TimePoint now);
  /// Asks for each that is not being taken.
  std::vector<Taken> decide(const Choose& choose, TimePoint now);
  /// Each Taken that has not come back, to be sent again: it may have been lost. One of a robot
  /// that this gateway has lost meanwhile says from now on that the command is only refused: then
  /// the new owner, which may have taken it, objects.
  std::vector<Taken> repeat(const StillOwns& still_owns, TimePoint now);
  struct Taker {
    const std::string& gateway;
    Life life = 0;
    bool is_owner = false;  ///< of the command's robot, by now and as far as this gateway knows
  };
  /// Somebody else takes one. What this gateway must answer when the other one wants to refuse a
  /// command that somebody has taken, and `objects` says that this gateway speaks for it.
  std::optional<Taken> on_taken(const Taker& taker, const Taken& taken,
                                const std::string& own_gateway, const StillOwns& still_owns,
                                const TakenCommands::Matches& objects, TimePoint now);
  /// Who made way for this gateway has dealt with this command of the robot.
  void on_done(const std::string& gateway, Life life, const std::string& robot,
               const DoneCommand& done, TimePoint now);
  /// Our own `Taken` came back: this command is ours. Nothing when it is to be refused: then
  /// take_refused() has it later, unless somebody else says until then that he takes it.
  std::optional<Waiting> on_own_taken(const Taken& taken, const StillOwns& still_owns,
                                      TimePoint now);
  /// Those that nobody else has taken while their refusal settled.
  std::vector<Waiting> take_refused(TimePoint now);
  /// Those that had no room.
  std::vector<Waiting> take_dropped() { return std::exchange(dropped_now_, {}); }
  /// The outcomes that wait here.
  std::vector<BrokerMessage> take_outcomes();
  /// All that wait, in the order they came.
  std::vector<Waiting> take_all();
  /// A new life begins: what was being taken is to be taken again, or refused.
  void on_new_life();
  /// An outcome from a former life. False when it is not known which command it is of.
  bool add_outcome(const BrokerMessage& outcome, const std::string& robot, const std::string& type,
                   TimePoint came);
  /// A gateway has published an outcome, of what it has taken itself or in the place of a dead one.
  /// `began`: when it had carried out, or got, the command.
  void on_outcome(const std::string& gateway, const std::string& robot, const std::string& type,
                  TimePoint began, TimePoint now);
  /// Asks about each outcome that is missing: `end` it here, `forget` it, or `wait`.
  enum class Fate : std::uint8_t { wait, end, forget };
  /// Those to end wait here like refusals: somebody may have heard the outcome.
  void add_overdue(const std::function<Fate(const TakenCommands::Entry&)>& fate_of, TimePoint now);
  /// Nobody else is about whose outcomes could be missing.
  void forget_owed() {
    commands_.forget_owed();
    early_outcomes_.clear();
  }
  bool is_empty() const { return waiting_.empty(); }
  std::size_t size() const { return waiting_.size(); }
  std::uint64_t dropped() const { return dropped_; }

 private:
  /// How often a refusal is sent while it settles.
  static constexpr unsigned refusal_copies = 3;

  using Number = std::uint64_t;  // of a waiting command, in the order they came
  /// Its Taken comes later: a broker keeps no order between topics (NATS: each filter has a
  /// consumer of its own).
  struct EarlyOutcome {
    std::string gateway;
    std::string robot;
    std::string type;
    TimePoint began;
    TimePoint came;
  };

  static Taken to_taken(const Waiting& waiting, TimePoint now);
  void decide_one(std::map<Number, Waiting>::iterator each, const Choose& choose, TimePoint now,
                  std::vector<Taken>& messages);
  void begin_taking(std::map<Number, Waiting>::iterator each, bool is_refusal, TimePoint now,
                    std::vector<Taken>& messages);
  static void turn_to_refusal(Waiting& waiting, TimePoint now, std::vector<Taken>& messages);
  bool cancel(const Taker& taker, const Taken& taken, const std::string& own_gateway,
              const StillOwns& still_owns, TimePoint now);
  std::map<Number, Waiting>::iterator insert(Waiting waiting);
  Waiting remove(std::map<Number, Waiting>::iterator each);
  Waiting finish(std::map<Number, Waiting>::iterator each, bool is_ended, TimePoint now);
  std::optional<Taken> answer(const Taken& taken, const TakenCommands::Matches& objects,
                              TimePoint now) const;
  bool is_being_ended(const TakenCommands::Entry& owed, TimePoint now) const;
  std::optional<EarlyOutcome> take_early_outcome(const std::string& gateway, const Taken& taken,
                                                 TimePoint came);
  void forget_former_life(const std::string& gateway, Life life, std::uint64_t key, TimePoint came,
                          TimePoint now);
  bool has_copy(std::uint64_t key, TimePoint came) const;
  bool is_refusing(std::uint64_t key) const;
  bool remove_one(std::uint64_t key, const std::function<bool(const Waiting&)>& is_meant);
  void yield_refusal(const Taken& taken, TimePoint now);
  void forget_owed(std::uint64_t key, TimePoint came);
  void settle_early_outcomes(TimePoint now);
  void make_room();

  TakenCommands& commands_;
  std::map<Number, Waiting> waiting_;
  std::unordered_map<std::uint64_t, std::set<Number>> by_key_;  ///< of those that wait
  std::map<std::uint64_t, Number> taking_;                      ///< by the id of our Taken
  Number last_number_ = 0;
  std::size_t waiting_octets_ = 0;
  std::vector<Waiting> dropped_now_;
  std::unordered_map<std::uint64_t, TimePoint> firsts_;  ///< whose copies may be under way, by key
  std::deque<EarlyOutcome> early_outcomes_;
  std::uint64_t last_id_ = 0;
  std::uint64_t dropped_ = 0;
};

}  // namespace slamgw::fleet
