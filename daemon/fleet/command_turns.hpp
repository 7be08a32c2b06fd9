// SPDX-License-Identifier: Apache-2.0
// Commands that every gateway hears and only one may carry out. Each waits here until its robot's
// owner has said that it takes it, or until nobody has: `Taken` of one gateway cancels one equal
// command at all others, whichever comes first. Pure; part of Ownership, which decides who may.
#pragma once

#include <deque>
#include <functional>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "daemon/core/messages.hpp"
#include "daemon/fleet/fleet_message.hpp"

namespace slamgw::fleet {

class CommandTurns {
 public:
  /// Without an owner for so long, a command is refused.
  static constexpr std::chrono::seconds owner_patience{5};
  /// A living owner may not have got it: after so long somebody refuses it in its place.
  static constexpr std::chrono::seconds last_patience{8};
  static constexpr std::chrono::seconds repeat_interval{1};
  /// Then it is forgotten: nobody could take it.
  static constexpr std::chrono::seconds kept_for{12};
  /// What others took is remembered: a copy of a command may come later than that news.
  static constexpr std::chrono::seconds taken_kept_for{40};
  /// Longer than any outcome takes (contract section 6, promise 6).
  static constexpr std::chrono::seconds outcome_patience{31};
  /// Beyond these the oldest goes.
  static constexpr std::size_t max_waiting = 4096;
  static constexpr std::size_t max_waiting_octets = std::size_t{8} * 1024 * 1024;
  static constexpr std::size_t max_taken = 65536;

  struct Waiting {
    BrokerMessage message;
    std::string robot;
    std::string type;
    std::uint64_t key = 0;
    TimePoint came{};
    std::uint64_t taking = 0;  ///< the id of our Taken that is under way; 0: none
    bool is_refusal = false;   ///< we take it only to refuse it
    TimePoint said{};          ///< when our Taken went out last
    bool is_repeated = false;  ///< our Taken may have been lost
  };
  /// What a gateway has taken and not yet told an outcome of.
  struct Owed {
    std::string gateway;
    Life life = 0;
    std::string robot;
    std::string type;
    TimePoint taken{};
  };

  static std::uint64_t key_of(const BrokerMessage& command);

  void add(BrokerMessage message, std::string robot, std::string type, TimePoint now);
  enum class Choice : std::uint8_t { wait, take, refuse, forget };
  using Choose = std::function<Choice(const Waiting&)>;
  /// Asks for each that is not being taken; leaves what is to be said to all.
  std::vector<Taken> decide(const Choose& choose, TimePoint now);
  /// What was said and has not come back, to be said again: it may have been lost.
  std::vector<Taken> repeat(TimePoint now);
  /// Somebody else has taken one.
  void on_taken(const std::string& gateway, Life life, const Taken& taken,
                const std::string& own_gateway, TimePoint now);
  /// Our own `Taken` came back: this command is ours, unless a gateway of a lesser id took it too.
  std::optional<Waiting> on_own_taken(std::uint64_t id);
  /// All that wait, in the order they came.
  std::deque<Waiting> take_all() {
    waiting_octets_ = 0;
    return std::exchange(waiting_, {});
  }
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
  bool has_owed() const { return !owed_.empty(); }
  std::size_t size() const { return waiting_.size(); }
  std::uint64_t dropped() const { return dropped_; }

 private:
  struct Cancelled {
    std::uint64_t key = 0;
    TimePoint since{};
  };
  struct Heard {
    std::string gateway;
    Life life = 0;
    std::uint64_t id = 0;
    TimePoint at{};
  };
  bool cancel(std::uint64_t key, bool is_stronger);
  void make_room();
  void forget_old(TimePoint now);

  std::deque<Waiting> waiting_;  // in the order they came
  std::size_t waiting_octets_ = 0;
  std::deque<Cancelled> cancelled_;  // taken by others, and not heard here yet
  std::deque<Heard> heard_order_;
  std::set<std::tuple<std::string, Life, std::uint64_t>> heard_;
  std::deque<Owed> owed_;
  std::uint64_t last_id_ = 0;
  std::uint64_t dropped_ = 0;
};

}  // namespace slamgw::fleet
