// SPDX-License-Identifier: Apache-2.0
#include "ctl/show.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <vector>

#include "ctl/text.hpp"

namespace slamgw::ctl {

std::string Screen::paint(std::string_view state, std::string text) const {
  if (!with_colour) return text;
  const auto is = [state](std::string_view name) { return state == name; };
  std::string_view colour;
  if (is("up") || is("online") || is("delivered") || is("sent") || is("configured") || is("member"))
    colour = "32";
  if (is("asleep") || is("superseded") || is("provisioned") || is("repeat")) colour = "33";
  if (is("down") || is("offline") || is("timeout") || is("refused") || is("reserved") ||
      is("deaf") || is("contested") || is("refusing") || is("lost") || is("silent") ||
      is("cut off"))
    colour = "31";
  return colour.empty() ? text : fmt::format("\033[{}m{}\033[0m", colour, text);
}

namespace show {
namespace {

using nlohmann::json;

constexpr std::size_t screen_columns = 80;

// ---- the table of robots

enum Column : std::size_t {
  id,
  mesh,
  address,
  state,
  seen,
  up,
  down,
  repeats,
  rate,
  p99,
  rssi,
  queue,
  count
};
using Row = std::array<std::string, Column::count>;

std::string number_or_dash(const json& robot, const char* key, double scale) {
  const auto found = robot.find(key);
  if (found == robot.end() || !found->is_number()) return "-";
  return fmt::format("{:.0f}", found->get<double>() / scale);
}

std::string shown_state(const json& robot) {
  if (is_true(robot, "contested")) return "contested";
  return is_true(robot, "deaf") ? "deaf" : text_at(robot, "state");
}

Row robot_row(const json& robot, std::chrono::system_clock::time_point now) {
  return {text_at(robot, "id"),
          text_at(robot, "mesh"),
          text_at(robot, "address"),
          shown_state(robot),
          show_age(text_at(robot, "last_seen"), now),
          fmt::format("{}", count_at(robot, "messages")),
          fmt::format("{}", count_at(robot, "commands")),
          fmt::format("{}", count_at(robot, "repeats")),
          fmt::format("{:.1f}", number_at(robot, "rate_hz")),
          number_or_dash(robot, "latency_p99_us", 1000),
          number_or_dash(robot, "rssi_dbm", 1),
          fmt::format("{}", count_at(robot, "queue"))};
}

/// Ids keep their start and addresses their end, where they differ.
std::array<std::size_t, Column::count> fit(const std::vector<Row>& rows) {
  std::array<std::size_t, Column::count> widths{};
  for (const Row& row : rows)
    for (std::size_t i = 0; i < row.size(); ++i) widths[i] = std::max(widths[i], columns(row[i]));
  std::size_t total = Column::count - 1;
  for (const std::size_t width : widths) total += width;
  while (total > screen_columns) {
    std::size_t& widest = widths[id] > widths[address] ? widths[id] : widths[address];
    if (widest <= 4) break;
    --widest;
    --total;
  }
  return widths;
}

/// Why robots are offline, deaf or contested; of the first ten.
std::string absent_lines(const json& robots) {
  constexpr int most = 10;
  std::string out;
  int count = 0;
  for (const json& robot : robots) {
    const std::string why =
        is_true(robot, "contested") ? std::string(contested_words) : text_at(robot, "why");
    if (why.empty() || ++count > most) continue;
    out += fmt::format("{}: {}\n", text_at(robot, "id"), why);
  }
  if (count > most) out += fmt::format("({} more are offline, deaf or contested)\n", count - most);
  return out;
}

/// What robots were refused, if anything; the log names the robots and the reasons.
std::string refused_line(const json& counters) {
  constexpr std::pair<const char*, const char*> kinds[] = {
      {"connects_refused", "connections"},
      {"topics_refused", "topics"},
      {"wills_refused", "wills"},
      {"unconnected_refused", "messages of QoS -1"}};
  std::string text;
  for (const auto& [counter, words] : kinds) {
    if (const auto count = count_at(counters, counter); count > 0)
      text += fmt::format("{}{} {}", text.empty() ? "" : ", ", count, words);
  }
  return text.empty() ? "" : "          refused: " + text + "\n";
}

/// " (2 deaf, 1 contested)" of those that are online; nothing when all is well.
std::string troubled(const json& robots) {
  std::string words;
  for (const char* const trouble : {"deaf", "contested"})
    if (const std::uint64_t count = count_at(robots, trouble); count > 0)
      words += fmt::format("{}{} {}", words.empty() ? "" : ", ", count, trouble);
  return words.empty() ? "" : " (" + words + ")";
}

std::string deaf_line(const json& counters, const Screen& screen) {
  if (count_at(counters, "mostly_deaf") == 0) return "";
  return fmt::format(
      "          {} most robots do not hear the gateway; see slam-gatewayctl doctor\n",
      screen.paint("deaf", "deaf:"));
}

std::string mesh_line(std::string name, const json& mesh, const Screen& screen) {
  if (name == "ble") name = "BLE";
  if (!name.empty() && name[0] >= 'a' && name[0] <= 'z') name[0] -= 'a' - 'A';
  const std::string state = text_at(mesh, "state");
  const std::string detail = text_at(mesh, "detail");
  return pad(name, 10) + screen.paint(state, detail.empty() ? state : pad(state, 9)) + detail +
         "\n" + refused_line(group_at(mesh, "counters")) +
         deaf_line(group_at(mesh, "counters"), screen);
}

std::string payload_text(const json& event) {
  if (const json& update = group_at(event, "update"); !update.empty()) {
    std::string text =
        fmt::format("x={} y={} obstacles=", number_at(update, "x"), number_at(update, "y"));
    const auto obstacles = update.find("obstacles");
    if (obstacles == update.end() || obstacles->empty()) return text + "none";
    std::string separator;
    for (const json& obstacle : *obstacles) {
      text += fmt::format("{}{},{}", separator, number_at(obstacle, "x"), number_at(obstacle, "y"));
      separator = ";";
    }
    return text;
  }
  if (const json& cmd = group_at(event, "cmd"); !cmd.empty())
    return fmt::format("x={} y={}", number_at(cmd, "x"), number_at(cmd, "y"));
  if (event.contains("text")) return "'" + text_at(event, "text") + "'";
  return text_at(event, "payload");
}

/// What was said, how it came, and how it ended; parts that do not apply are left out.
std::string event_details(const json& event) {
  std::vector<std::string> parts;
  if (event.contains("payload")) parts.push_back(payload_text(event));
  if (event.contains("message_id"))
    parts.push_back(fmt::format("#{}", count_at(event, "message_id")));
  const auto dup = event.find("dup");
  if (dup != event.end() && *dup == true) parts.emplace_back("dup");
  if (event.contains("rssi_dbm"))
    parts.push_back(fmt::format("{} dBm", number_at(event, "rssi_dbm")));
  if (event.contains("hops")) parts.push_back(fmt::format("{} hops", count_at(event, "hops")));
  if (event.contains("outcome")) parts.push_back(text_at(event, "outcome"));
  if (event.contains("latency_us"))
    parts.push_back(fmt::format("after {:.1f} ms", number_at(event, "latency_us") / 1000));
  const std::string why = text_at(event, "why");
  return fmt::format("{}{}{}", fmt::join(parts, " "), why.empty() ? "" : ": ", why);
}

}  // namespace

std::string status(const json& status, const Screen& screen) {
  const json& broker = group_at(status, "broker");
  const json& meshes = group_at(status, "meshes");
  const json& robots = group_at(status, "robots");
  const json& traffic = group_at(status, "messages");
  const json& store = group_at(status, "store");
  std::string out =
      fmt::format("slam-gatewayd {}, gateway {}, up {}, {} memory\n", text_at(status, "version"),
                  text_at(status, "gateway"), show_seconds(count_at(status, "uptime_s")),
                  show_bytes(count_at(status, "memory_rss_bytes")));
  const std::string state = text_at(broker, "state");
  const std::string why = text_at(broker, "why");
  out += fmt::format("Broker    {} {} since {}\n", screen.paint(state, pad(state, 8)),
                     text_at(broker, "uri"), text_at(broker, "since"));
  if (!why.empty() && state != "up") out += fmt::format("                   {}\n", why);
  if (const auto rights = broker.find("missing_rights"); rights != broker.end())
    for (const json& right : *rights)
      out += fmt::format("          {} {}; grant: {}\n", screen.paint("refused", "no right:"),
                         text_at(right, "what"), text_at(right, "grant"));
  for (const auto& [name, mesh] : meshes.items()) out += mesh_line(name, mesh, screen);
  out += fmt::format("Robots    {} online{}, {} asleep, {} offline ({} known)\n",
                     count_at(robots, "online"), troubled(robots), count_at(robots, "asleep"),
                     count_at(robots, "offline"), count_at(robots, "known"));
  out +=
      fmt::format("Messages  {} in, {} out, {} dropped, {} stored, {} rejected\n",
                  count_at(traffic, "up"), count_at(traffic, "down"), count_at(traffic, "dropped"),
                  count_at(traffic, "stored"), count_at(traffic, "rejected"));
  if (const std::uint64_t count = count_at(traffic, "inbound_dropped"); count > 0)
    out += fmt::format("          {} of the broker's were lost: they came too fast\n", count);
  out +=
      fmt::format("Store     {} messages, {} of {}\n", count_at(store, "depth"),
                  show_bytes(count_at(store, "bytes")), show_bytes(count_at(store, "max_bytes")));
  if (const json& largest = group_at(store, "filled_by"); !text_at(largest, "robot").empty())
    out += fmt::format("          nearly full: {} has stored {}\n", text_at(largest, "robot"),
                       show_bytes(count_at(largest, "bytes")));
  if (const std::uint64_t count = count_at(store, "dead_letters"); count > 0)
    out += fmt::format("          {} dead letters: see slam-gatewayctl store list\n", count);
  if (const std::string trouble = text_at(store, "why"); !trouble.empty())
    out += fmt::format("          {} {}\n", screen.paint("down", text_at(store, "state")), trouble);
  return out;
}

std::string robots(const json& robots, const Screen& screen) {
  std::vector<Row> rows{
      {"ROBOT", "MESH", "ADDRESS", "STATE", "SEEN", "UP", "DOWN", "REP", "HZ", "P99", "RSSI", "Q"}};
  for (const json& robot : robots) rows.push_back(robot_row(robot, screen.now));
  if (rows.size() == 1) return "no robot has been heard yet\n";
  const auto widths = fit(rows);
  std::string out;
  for (const Row& row : rows) {
    const bool is_head = &row == &rows.front();
    std::string line = pad(cut_end(row[id], widths[id]), widths[id]);
    line += " " + pad(row[mesh], widths[mesh]);
    line += " " + pad(cut_start(row[address], widths[address]), widths[address]);
    const std::string padded = pad(row[state], widths[state]);
    line += " " + (is_head ? padded : screen.paint(row[state], padded));
    for (const Column column : {seen, up, down, repeats, rate, p99, rssi, queue})
      line += " " + pad_left(row[column], widths[column]);
    out += line + "\n";
  }
  return out + absent_lines(robots);
}

std::string event(const json& event, const Screen& screen) {
  const std::string kind = text_at(event, "event");
  const std::string time = text_at(event, "at");
  const std::string clock = time.size() >= 23 ? time.substr(11, 12) : time;  // milliseconds
  if (kind == "lost")
    return fmt::format("{} {} {} events: this terminal is too slow for all of them\n", clock,
                       screen.paint(kind, pad(kind, 12)), count_at(event, "lost"));
  const std::string mesh_name = text_at(event, "mesh");
  const std::string details = event_details(event);
  return fmt::format("{} {} {} {} {}{}{}\n", clock, screen.paint(kind, pad(kind, 12)),
                     pad(mesh_name.empty() ? "-" : mesh_name, 6), pad(text_at(event, "robot"), 12),
                     details.empty() ? text_at(event, "type") : pad(text_at(event, "type"), 6),
                     details.empty() ? "" : "  ", details);
}

std::string outcome(const json& outcome, const Screen& screen) {
  const std::string result = text_at(outcome, "outcome");
  const std::string why = text_at(outcome, "why");
  return fmt::format("{} after {} ms{}{}\n", screen.paint(result, result),
                     count_at(outcome, "after_ms"), why.empty() ? "" : ": ", why);
}

}  // namespace show
}  // namespace slamgw::ctl
