// SPDX-License-Identifier: Apache-2.0
// Gives each command its id, remembers the commands without an outcome, and ends commands that have
// waited for too long. So each command ends once and within 30 s (docs/topics.md, promise 6) even
// if its mesh never reports. Pure; part of Gateway.
#pragma once

#include <boost/multi_index/hashed_index.hpp>
#include <boost/multi_index/key.hpp>
#include <boost/multi_index/ordered_index.hpp>
#include <boost/multi_index_container.hpp>

#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "daemon/core/messages.hpp"

namespace slamgw {

/// A message under `<prefix>/server/<robot>/<type>`.
struct Command {
  CommandId id = CommandId::none;
  std::string robot;
  std::string type;
  std::optional<Mesh> carrier;         ///< nothing when no mesh knows the robot
  bool is_retained = false;            ///< its mesh may ignore it; then the command has no outcome
  std::chrono::milliseconds waited{};  ///< BrokerMessage::waited
  Sender sender{};
};

class CommandLedger {
 public:
  /// Limit of commands without an outcome, of all robots together.
  static constexpr std::size_t default_max_open = 65536;
  /// The meshes give up after 29 s at most; half a second is left for the way to the broker.
  static constexpr std::chrono::milliseconds patience{29500};

  explicit CommandLedger(std::size_t max_open = default_max_open) : max_open_(max_open) {}

  CommandId next_id() { return CommandId{++last_id_}; }
  /// Returns false when too many commands are open.
  bool open(Command command, TimePoint now);
  /// Removes and returns the command; nothing when it has ended before.
  std::optional<Command> end(CommandId id);
  std::size_t size() const { return open_.size(); }

  std::optional<TimePoint> deadline() const;
  /// Removes and returns the overdue commands.
  std::vector<Command> take_overdue(TimePoint now);

 private:
  struct Open {
    CommandId id = CommandId::none;
    TimePoint came{};
    Command command;
  };
  using OpenCommands = boost::multi_index_container<
      Open, boost::multi_index::indexed_by<
                boost::multi_index::hashed_unique<boost::multi_index::key<&Open::id>>,
                boost::multi_index::ordered_non_unique<boost::multi_index::key<&Open::came>>>>;
  OpenCommands::nth_index<1>::type& by_age() { return open_.get<1>(); }
  const OpenCommands::nth_index<1>::type& by_age() const { return open_.get<1>(); }

  std::size_t max_open_;
  std::uint64_t last_id_ = 0;
  OpenCommands open_;
};

/// Holds commands that no gateway has a session for. Such a robot may become known a moment later,
/// so each command waits for a while before it is refused. Pure; part of Gateway. Used only at the
/// first gateway of a broker by name.
class StrayCommands {
 public:
  /// For names that no robot has. With the 29 s that a mesh may take afterwards, a command still
  /// ends within 30 s.
  static constexpr std::chrono::milliseconds patience{500};
  /// A command is refused after this time at the latest: while the broker comes and goes, no
  /// gateway ever knows all robots.
  static constexpr std::chrono::milliseconds longest{25000};
  /// Beyond these bounds commands are refused at once, so invented names cost no more memory.
  static constexpr std::size_t max_waiting = 4096;
  static constexpr std::size_t max_octets = std::size_t{8} * 1024 * 1024;

  struct Stray {
    BrokerMessage message;
    std::string robot;
    TimePoint came{};
    bool awaits_session = false;  ///< its robot is this gateway's, so it waits for `longest`
  };

  /// Holds the command until `due`.
  void add(Stray stray, TimePoint due);
  /// Removes and returns a command that is due; beyond the bounds, the one that is due next.
  std::optional<Stray> take_due(TimePoint now);
  /// Removes and returns the commands for the robot `of`, or for all robots, oldest first.
  std::vector<Stray> take_all(std::string_view of = {});
  std::optional<TimePoint> deadline() const;

 private:
  bool is_full() const { return waiting_.size() > max_waiting || octets_ > max_octets; }

  std::multimap<TimePoint, Stray> waiting_;  // by `due`
  std::size_t octets_ = 0;                   // of all waiting payloads
};

}  // namespace slamgw
