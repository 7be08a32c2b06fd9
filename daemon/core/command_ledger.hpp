// SPDX-License-Identifier: Apache-2.0
// Gives each command its id, remembers those without an outcome, and ends those that have waited
// for too long. So each command ends once and within 30 s (docs/topics.md, promise 6) even if
// its mesh never reports. Pure; part of Gateway.
#pragma once

#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "daemon/core/messages.hpp"

namespace slamgw {

/// A message under `<prefix>/server/<robot>/<type>`.
struct Command {
  CommandId id = CommandId::none;
  std::string robot;
  std::string type;
  std::optional<Mesh> carrier;         ///< nothing when no mesh knows the robot
  bool is_retained = false;            ///< its mesh may ignore it; then it has no outcome
  std::chrono::milliseconds waited{};  ///< BrokerMessage::waited
};

class CommandLedger {
 public:
  /// As many as the meshes take together.
  static constexpr std::size_t default_max_open = 65536;
  /// The meshes give up after 29 s at most; half a second is left for the way to the broker.
  static constexpr std::chrono::milliseconds patience{29500};

  explicit CommandLedger(std::size_t max_open = default_max_open) : max_open_(max_open) {}

  CommandId next_id() { return CommandId{++last_id_}; }
  /// False when there are too many.
  bool open(Command command, TimePoint now);
  /// False when it has ended before.
  bool end(CommandId id);
  std::size_t size() const { return open_.size(); }

  std::optional<TimePoint> deadline() const;
  /// Ends overdue commands.
  std::vector<Command> take_overdue(TimePoint now);

 private:
  struct Entry {
    Command command;
    TimePoint came{};
  };

  std::size_t max_open_;
  std::uint64_t last_id_ = 0;
  std::map<CommandId, Entry> open_;
  std::set<std::pair<TimePoint, CommandId>> by_age_;
};

}  // namespace slamgw
