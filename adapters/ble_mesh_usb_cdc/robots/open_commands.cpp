// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/robots/open_commands.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>

namespace slamgw::ble {
namespace {

using std::chrono::duration_cast;
using std::chrono::milliseconds;

std::int64_t epoch_ms(WallTime time) {
  return duration_cast<milliseconds>(time.time_since_epoch()).count();
}

}  // namespace

std::string encode_open_commands(const std::vector<OpenCommand>& commands, const Now& now) {
  auto list = nlohmann::ordered_json::array();
  for (const OpenCommand& command : commands) {
    const auto age = duration_cast<milliseconds>(now.mono - command.arrived);
    list.push_back({{"robot", command.robot},
                    {"type", command.type},
                    {"arrived_ms", epoch_ms(now.wall) - age.count()},
                    {"sent", command.is_sent}});
  }
  return list.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
}

std::optional<std::vector<OpenCommand>> decode_open_commands(std::string_view text,
                                                             const Now& now) {
  const auto end = text.find('\n');
  if (end == std::string_view::npos) return std::nullopt;
  const auto list = nlohmann::json::parse(text.substr(0, end), nullptr, false);
  if (!list.is_array()) return std::nullopt;
  std::vector<OpenCommand> commands;
  for (const auto& entry : list) {
    const bool is_whole = entry.is_object() && entry.contains("robot") &&
                          entry["robot"].is_string() && entry.contains("type") &&
                          entry["type"].is_string() && entry.contains("arrived_ms") &&
                          entry["arrived_ms"].is_number_integer() && entry.contains("sent") &&
                          entry["sent"].is_boolean();
    if (!is_whole) return std::nullopt;
    const std::int64_t arrived_ms = entry["arrived_ms"];
    const milliseconds age{std::max<std::int64_t>(0, epoch_ms(now.wall) - arrived_ms)};
    commands.push_back({entry["robot"], entry["type"], now.mono - age, entry["sent"]});
  }
  return commands;
}

CommandOutcome outcome_after_restart(const OpenCommand& command, TimePoint now) {
  return {Mesh::ble,
          CommandId::none,
          command.robot,
          command.type,
          command.is_sent ? CommandResult::timeout : CommandResult::refused,
          duration_cast<milliseconds>(now - command.arrived),
          command.is_sent ? "slam-gatewayd was restarted before the robot answered"
                          : "slam-gatewayd was restarted before it was sent"};
}

}  // namespace slamgw::ble
