// SPDX-License-Identifier: Apache-2.0
// What slam-gatewayctl shows of the BLE mesh.
#include <fmt/format.h>

#include "ctl/show.hpp"
#include "ctl/text.hpp"

namespace slamgw::ctl::show {

using nlohmann::json;

std::string devices(const json& devices) {
  if (devices.empty()) return "no new robot is in reach\n";
  std::string out = pad("UUID", 33) + "RSSI SEEN " + pad("STATE", 8) + "ROBOT\n";
  for (const json& device : devices) {
    const std::string robot = text_at(device, "robot");
    out += fmt::format("{} {:>4} {:>3}s {} {}\n", pad(text_at(device, "uuid"), 32),
                       number_at(device, "rssi_dbm"), count_at(device, "heard_s_ago"),
                       pad(text_at(device, "state"), 7), robot.empty() ? "-" : cut_end(robot, 29));
  }
  return out;
}

std::string nodes(const json& nodes, const Screen& screen) {
  if (nodes.empty()) return "no robot is in the mesh yet\n";
  std::string out =
      pad("ROBOT", 17) + pad("ADDRESS", 8) + pad("UUID", 33) + pad("STATE", 12) + "\n";
  for (const json& node : nodes) {
    const std::string state = text_at(node, "state");
    const std::string problem = text_at(node, "problem");
    out += fmt::format("{} {} {} {}\n", pad(cut_end(text_at(node, "robot"), 16), 16),
                       pad(text_at(node, "address"), 7), pad(text_at(node, "uuid"), 32),
                       screen.paint(state, state));
    if (!problem.empty()) out += "  " + problem + "\n";
  }
  return out;
}

std::string removed(const json& node) {
  return fmt::format(
      "{} ({}) is out of the mesh; only this takes it in again: slam-gatewayctl ble provision {} "
      "--id {}\n",
      text_at(node, "robot"), text_at(node, "address"), text_at(node, "uuid"),
      text_at(node, "robot"));
}

std::string exported_mesh(const json& exported) {
  const std::string file = text_at(exported, "file");
  return fmt::format(
      "{} holds the mesh's keys, for one other gateway. There: set ble_mesh.address to {}, "
      "restart\nslam-gateway (if it has that address already, leave it), and: slam-gatewayctl ble "
      "import {}\n",
      file, text_at(exported, "address"), file);
}

std::string joining_head(const json& news) {
  const std::uint64_t seconds = count_at(news, "seconds_left");
  if (seconds == 0) return {};
  return fmt::format(
      "new robots may join for {}; Ctrl-C ends this display only, --minutes 0 ends joining\n",
      show_seconds(seconds));
}

std::string joining(const json& event, const Screen& screen) {
  const std::string what = text_at(event, "event");
  const std::string robot = text_at(event, "robot");
  const std::string why = text_at(event, "why");
  return fmt::format("{} {}{}{}\n", pad(text_at(event, "uuid"), 32),
                     screen.paint(what, pad(what, 10)), robot.empty() ? "" : " " + robot,
                     why.empty() ? "" : ": " + why);
}

std::string done(const json& done) {
  if (done.contains("nodes"))
    return fmt::format("imported: the mesh has {} robots\n", count_at(done, "nodes"));
  if (done.contains("cleared"))
    return "the serial board was cleared and is set up anew; robots may ignore the gateway until "
           "they were restarted\n";
  if (done.contains("forgotten")) {
    const auto was_known = done.find("was_known");
    return text_at(done, "forgotten") + " is forgotten" +
           (was_known != done.end() && *was_known == true
                ? "\n"
                : "; it was not known here; its retained presence is cleared once the broker "
                  "is connected\n");
  }
  if (done.contains("in_force")) {
    const std::string restart = text_at(done, "needs_restart");
    return "in force: " + text_at(done, "in_force") + "\n" +
           (restart.empty() ? "" : "only a restart changes: " + restart + "\n");
  }
  return "done\n";
}

}  // namespace slamgw::ctl::show
