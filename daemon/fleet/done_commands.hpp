// SPDX-License-Identifier: Apache-2.0
// The commands that this gateway, or who handed a robot over to it, has dealt with lately: for
// gateways that have missed that word. Pure; part of Ownership.
#pragma once

#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/time.hpp"
#include "daemon/fleet/fleet_message.hpp"

namespace slamgw::fleet {

class DoneCommands {
 public:
  /// Two gateways hear one command within this time of each other. Of two equal ones that come
  /// closer together one may be taken for the other.
  static constexpr std::chrono::milliseconds heard_apart{500};

  struct Entry {
    std::string robot;
    DoneCommand command;
    TimePoint came{};
    bool is_own = true;  ///< this gateway has dealt with it
  };

  void add(Entry entry, TimePoint now);
  /// An equal one that came then.
  const Entry* find(std::uint64_t key, TimePoint came) const;
  /// The robot's, with their ages, the newest max_done_commands.
  std::vector<DoneCommand> of(const std::string& robot, TimePoint now) const;

 private:
  /// Longer than a command waits for somebody who takes it (CommandTurns::kept_for).
  static constexpr std::chrono::seconds kept_for{20};
  static constexpr std::size_t max_entries = 65536;

  std::deque<Entry> entries_;
};

}  // namespace slamgw::fleet
