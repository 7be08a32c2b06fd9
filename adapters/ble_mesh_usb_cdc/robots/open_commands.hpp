// SPDX-License-Identifier: Apache-2.0
// The commands to robots that have no outcome yet, as `ble-commands.json` keeps them: one line of
// JSON. A daemon that was killed finds them there when it starts again, and reports their outcome.
// They are not sent again: the robot may have carried them out. Pure; CommandFile has the disk.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "daemon/core/messages.hpp"

namespace slamgw::ble {

struct OpenCommand {
  std::string robot;
  std::string type;
  TimePoint arrived{};
  bool is_sent = false;  ///< at least once over the mesh
  bool operator==(const OpenCommand&) const = default;
};

/// Ends with a newline. Times are kept by the wall clock, which goes on over a restart of the host.
std::string encode_open_commands(const std::vector<OpenCommand>& commands, const Now& now);
/// Reads the first line of `text`; what follows is of an earlier, longer one. Nothing when it is
/// damaged. A time ahead of `now` counts as `now`.
std::optional<std::vector<OpenCommand>> decode_open_commands(std::string_view text, const Now& now);
/// The outcome of a command that an earlier daemon had under way.
CommandOutcome outcome_after_restart(const OpenCommand& command, TimePoint now);

}  // namespace slamgw::ble
