// SPDX-License-Identifier: Apache-2.0
#include "ctl/show.hpp"

#include <nlohmann/json.hpp>

#include <fmt/format.h>
#include <locale.h>
#include <wchar.h>

#include <algorithm>
#include <array>
#include <boost/algorithm/string/replace.hpp>
#include <cctype>
#include <cstring>
#include <ctime>
#include <vector>

#include "daemon/core/utf8.hpp"

namespace slamgw::ctl {
namespace {

struct Character {
  std::size_t width = 1;  ///< the columns that a terminal gives it
  std::size_t end = 0;    ///< where the next character begins
};

/// Expects UTF-8, which text_at() ensures; in other text, each octet counts as one character.
Character character_at(std::string_view text, std::size_t at) {
  static const locale_t utf8 = newlocale(LC_CTYPE_MASK, "C.UTF-8", nullptr);
  const locale_t before = uselocale(utf8);
  wchar_t code = 0;
  std::mbstate_t state{};
  const std::size_t size = std::mbrtowc(&code, text.data() + at, text.size() - at, &state);
  const int width = size <= text.size() ? wcwidth(code) : 1;
  uselocale(before);
  if (size == static_cast<std::size_t>(-2)) return {1, text.size()};  // cut short
  return {static_cast<std::size_t>(std::max(width, 0)),
          at + (size <= text.size() ? std::max<std::size_t>(size, 1) : 1)};
}

}  // namespace

std::string string_at(const nlohmann::json& object, const char* key) {
  const auto found = object.find(key);
  return found == object.end() || !found->is_string() ? "" : found->get<std::string>();
}

std::string text_at(const nlohmann::json& object, const char* key) {
  return escape_unprintable(string_at(object, key));
}

double number_at(const nlohmann::json& object, const char* key) {
  const auto found = object.find(key);
  return found == object.end() || !found->is_number() ? 0.0 : found->get<double>();
}

std::uint64_t count_at(const nlohmann::json& object, const char* key) {
  const auto found = object.find(key);
  const bool is_count = found != object.end() && found->is_number_integer() && *found >= 0;
  return is_count ? found->get<std::uint64_t>() : 0;
}

bool is_true(const nlohmann::json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && *found == true;
}

const nlohmann::json& group_at(const nlohmann::json& object, const char* key) {
  static const nlohmann::json empty = nlohmann::json::object();
  const auto found = object.find(key);
  return found == object.end() || !found->is_object() ? empty : *found;
}

const nlohmann::json& list_at(const nlohmann::json& object, const char* key) {
  static const nlohmann::json empty = nlohmann::json::array();
  const auto found = object.find(key);
  return found == object.end() || !found->is_array() ? empty : *found;
}

std::size_t columns(std::string_view text) {
  std::size_t count = 0;
  for (std::size_t at = 0; at < text.size();) {
    const Character character = character_at(text, at);
    count += character.width;
    at = character.end;
  }
  return count;
}

std::string shell_word(const std::string& text) {
  const auto is_plain = [](unsigned char c) {
    return std::isalnum(c) != 0 || std::strchr("-_.:,@%+/", c) != nullptr;
  };
  if (!text.empty() && std::ranges::all_of(text, is_plain)) return text;
  return "'" + boost::algorithm::replace_all_copy(text, "'", "'\\''") + "'";
}

std::string cut_end(const std::string& text, std::size_t width) {
  if (columns(text) <= width) return text;
  std::size_t end = 0;
  for (std::size_t used = 0; end < text.size();) {
    const Character character = character_at(text, end);
    if (used += character.width; used > width - 1) break;
    end = character.end;
  }
  return text.substr(0, end) + "~";
}

std::string cut_start(const std::string& text, std::size_t width) {
  std::size_t left = columns(text);
  if (left <= width) return text;
  std::size_t begin = 0;
  while (left > width - 1) {
    const Character character = character_at(text, begin);
    left -= character.width;
    begin = character.end;
  }
  return "~" + text.substr(begin);
}

namespace {

/// Returns where the second column of text begins, after the first gap of two spaces. Without such
/// a column, returns two columns more than the line's own indent.
std::size_t hanging_indent(std::string_view line) {
  constexpr std::size_t farthest = 32;
  const std::size_t begin = line.find_first_not_of(' ');
  if (begin == line.npos) return 0;
  const std::size_t text = line.find_first_not_of(' ', line.find("  ", begin));
  return text <= farthest ? text : begin + 2;
}

/// Counts columns without escape sequences, which take none. Only colours use such sequences here.
std::size_t shown_columns(std::string_view text) {
  std::size_t count = 0;
  for (std::size_t escape = text.find('\033'); escape != text.npos; escape = text.find('\033')) {
    count += columns(text.substr(0, escape));
    text.remove_prefix(std::min(text.size(), text.find('m', escape) + 1));
  }
  return count + columns(text);
}

std::string wrap_line(std::string_view line, std::size_t width) {
  std::string out;
  const std::string indent(std::min(hanging_indent(line), width / 2), ' ');
  std::string taken;
  while (!line.empty()) {
    const std::size_t end = std::min(line.find(' ', line.find_first_not_of(' ')), line.size());
    const std::string_view word = line.substr(0, end);
    const bool has_word = taken.find_first_not_of(' ') != taken.npos;
    if (has_word && shown_columns(taken) + shown_columns(word) > width) {
      out += taken + '\n';
      taken = indent;
      taken += word.substr(std::min(word.find_first_not_of(' '), word.size()));
    } else {
      taken += word;
    }
    line.remove_prefix(end);
  }
  return out + taken;
}

}  // namespace

std::string wrap(const std::string& text, std::size_t width) {
  std::string out;
  for (std::size_t begin = 0; begin < text.size();) {
    const std::size_t end = std::min(text.find('\n', begin), text.size());
    const std::string_view line = std::string_view(text).substr(begin, end - begin);
    out += shown_columns(line) <= width ? std::string(line) : wrap_line(line, width);
    if (end < text.size()) out += '\n';
    begin = end + 1;
  }
  return out;
}

std::string pad(const std::string& text, std::size_t width) {
  return text + std::string(width - std::min(width, columns(text)), ' ');
}

std::string pad_left(const std::string& text, std::size_t width) {
  return std::string(width - std::min(width, columns(text)), ' ') + text;
}

std::string show_bytes(std::uint64_t bytes) {
  constexpr std::uint64_t unit = 1024;
  if (bytes < unit) return fmt::format("{} B", bytes);
  if (bytes < unit * unit) return fmt::format("{:.1f} KiB", static_cast<double>(bytes) / unit);
  return fmt::format("{:.1f} MiB", static_cast<double>(bytes) / (unit * unit));
}

std::string show_seconds(std::uint64_t seconds) {
  const std::uint64_t minutes = seconds / 60;
  const std::uint64_t hours = minutes / 60;
  if (minutes == 0) return fmt::format("{} s", seconds);
  if (hours == 0) return fmt::format("{} min {} s", minutes, seconds % 60);
  if (hours < 24) return fmt::format("{} h {} min", hours, minutes % 60);
  return fmt::format("{} d {} h", hours / 24, hours % 24);
}

std::string show_age(const std::string& time, std::chrono::system_clock::time_point now) {
  std::tm fields{};
  if (strptime(time.c_str(), "%Y-%m-%dT%H:%M:%S", &fields) == nullptr) return "";
  const auto then = std::chrono::system_clock::from_time_t(timegm(&fields));
  const auto age = std::chrono::duration_cast<std::chrono::seconds>(now - then).count();
  if (age < 60) return fmt::format("{}s", std::max<std::int64_t>(age, 0));
  if (age < 3600) return fmt::format("{}m", age / 60);
  if (age < 86400) return fmt::format("{}h", age / 3600);
  return fmt::format("{}d", age / 86400);
}

std::string Screen::paint(std::string_view state, std::string text) const {
  if (!with_colour) return text;
  const auto is = [state](std::string_view name) { return state == name; };
  std::string_view colour;
  if (is("up") || is("online") || is("delivered") || is("sent") || is("configured") || is("member"))
    colour = "32";
  if (is("asleep") || is("superseded") || is("provisioned") || is("repeat")) colour = "33";
  if (is("down") || is("offline") || is("timeout") || is("refused") || is("reserved") ||
      is("deaf") || is("contested") || is("refusing") || is("lost") || is("gone") || is("cut off"))
    colour = "31";
  return colour.empty() ? text : fmt::format("\033[{}m{}\033[0m", colour, text);
}

std::string counted(std::uint64_t count, std::string_view one, std::string_view many) {
  return fmt::format("{} {}", count, count == 1 ? one : many);
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

/// Returns whether the robot was heard since the daemon started: else its `last_seen` is 1970.
bool was_seen(const json& robot) { return !string_at(robot, "last_seen").starts_with("1970-"); }

Row robot_row(const json& robot, std::chrono::system_clock::time_point now) {
  return {text_at(robot, "id"),
          text_at(robot, "mesh"),
          text_at(robot, "address"),
          shown_state(robot),
          was_seen(robot) ? show_age(text_at(robot, "last_seen"), now) : "-",
          fmt::format("{}", count_at(robot, "messages")),
          fmt::format("{}", count_at(robot, "commands")),
          fmt::format("{}", count_at(robot, "repeats")),
          fmt::format("{:.1f}", number_at(robot, "rate_hz")),
          number_or_dash(robot, "latency_p99_us", 1000),
          number_or_dash(robot, "rssi_dbm", 1),
          fmt::format("{}", count_at(robot, "queue"))};
}

/// Returns a row for each mesh that the robot was on. The first row is the mesh that determines the
/// robot's state; the other rows leave out values of the robot as a whole.
std::vector<Row> robot_rows(const json& robot, std::chrono::system_clock::time_point now) {
  std::vector<Row> rows{robot_row(robot, now)};
  const json& meshes = group_at(robot, "meshes");
  if (meshes.size() < 2) return rows;
  const auto set_counts = [](Row& row, const json& there) {
    row[up] = fmt::format("{}", count_at(there, "messages"));
    row[down] = fmt::format("{}", count_at(there, "commands"));
    row[repeats] = fmt::format("{}", count_at(there, "repeats"));
  };
  for (const auto& [name, there] : meshes.items()) {
    if (!there.is_object()) continue;
    if (name == string_at(robot, "mesh")) {
      set_counts(rows.front(), there);
      continue;
    }
    Row row;
    row[mesh] = escape_unprintable(name);
    row[address] = text_at(there, "address");
    row[state] = text_at(there, "state");
    set_counts(row, there);
    rows.push_back(std::move(row));
  }
  return rows;
}

/// Returns the widths of the columns. If the table is too wide, narrows ids and addresses: ids keep
/// their start and addresses their end, where they differ from each other.
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

/// Says why robots are offline, deaf or contested; lists at most ten of them.
std::string absent_lines(const json& robots) {
  constexpr std::uint64_t most = 10;
  std::string out;
  std::uint64_t count = 0;
  for (const json& robot : robots) {
    const std::string why =
        is_true(robot, "contested") ? std::string(contested_words) : text_at(robot, "why");
    if (why.empty() || ++count > most) continue;
    out += fmt::format("{}: {}\n", text_at(robot, "id"), why);
  }
  if (count > most)
    out += fmt::format("({} offline, deaf or contested)\n",
                       counted(count - most, "more is", "more are"));
  return out;
}

/// Lists names that the table shows with escapes: such a name may be meant to deceive.
std::string deceptive_line(const json& robots) {
  constexpr std::size_t most = 5;
  std::vector<std::string> names;
  for (const json& robot : robots)
    if (text_at(robot, "id") != string_at(robot, "id")) names.push_back(text_at(robot, "id"));
  if (names.empty()) return "";
  const std::size_t count = names.size();
  names.resize(std::min(count, most));
  return fmt::format("{} made to look like another (\\u: escaped characters): {}{}\n",
                     counted(count, "name is", "names are"), fmt::join(names, ", "),
                     count > most ? ", ..." : "");
}

/// Counts requests of robots that were refused, if any; the log names the robots and the reasons.
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

/// Returns " (2 deaf, 1 contested)", counted among online robots; nothing when all is well.
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

std::string refresh_line(const json& counters) {
  const std::uint64_t step = count_at(counters, "key_refresh_step");
  if (step == 0) return "";
  return fmt::format(
      "          keys are refreshed, step {} of 3 lacks {}; see slam-gatewayctl ble refresh-keys "
      "--status\n",
      step, counted(count_at(counters, "key_refresh_missing"), "robot", "robots"));
}

/// Says why no robot on Thread is heard, if the border router reports a reason.
std::string role_line(const json& mesh, const Screen& screen) {
  const std::string role = text_at(mesh, "role");
  if (role != "detached" && role != "disabled") return "";
  return fmt::format("          {} this node has no Thread network; see slam-gatewayctl doctor\n",
                     screen.paint("down", role + ":"));
}

/// Says which addresses take most places for clients. Clients without an answer are counted only in
/// a crowd, because robots that only publish never answer.
std::string places_line(const json& places) {
  constexpr std::uint64_t crowd_of_unproven = 100;
  const std::uint64_t taken = count_at(places, "taken");
  if (taken == 0) return "";
  const auto crowd = [&](const char* key) {
    const json& most = group_at(places, key);
    return most.empty() ? ""
                        : fmt::format(" ({} of them at {})", count_at(most, "clients"),
                                      text_at(most, "address"));
  };
  std::string text = fmt::format("          {} of {} places taken{}", taken,
                                 count_at(places, "max"), crowd("most"));
  const std::uint64_t unproven = count_at(places, "unproven");
  if (unproven >= crowd_of_unproven || (unproven > 0 && 10 * taken >= 9 * count_at(places, "max")))
    text += fmt::format(", {} by clients that have not answered yet{}", unproven,
                        crowd("most_unproven"));
  return text + "\n";
}

std::string mesh_line(std::string name, const json& mesh, const Screen& screen) {
  if (name == "ble") name = "BLE";
  if (!name.empty() && name[0] >= 'a' && name[0] <= 'z') name[0] -= 'a' - 'A';
  const std::string state = text_at(mesh, "state");
  const std::string detail = text_at(mesh, "detail");
  return pad(name, 10) + screen.paint(state, detail.empty() ? state : pad(state, 9)) + detail +
         "\n" + role_line(mesh, screen) + places_line(group_at(mesh, "places")) +
         refused_line(group_at(mesh, "counters")) + deaf_line(group_at(mesh, "counters"), screen) +
         refresh_line(group_at(mesh, "counters"));
}

std::string payload_text(const json& event) {
  if (const json& update = group_at(event, "update"); !update.empty()) {
    std::string text =
        fmt::format("x={} y={} obstacles=", number_at(update, "x"), number_at(update, "y"));
    const json& obstacles = list_at(update, "obstacles");
    if (obstacles.empty()) return text + "none";
    std::string separator;
    for (const json& obstacle : obstacles) {
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

/// Describes the content, the radio and the outcome; leaves out parts that do not apply.
std::string event_details(const json& event) {
  std::vector<std::string> parts;
  if (event.contains("payload")) parts.push_back(payload_text(event));
  if (event.contains("message_id"))
    parts.push_back(fmt::format("#{}", count_at(event, "message_id")));
  if (is_true(event, "dup")) parts.emplace_back("dup");
  if (event.contains("rssi_dbm"))
    parts.push_back(fmt::format("{} dBm", number_at(event, "rssi_dbm")));
  if (event.contains("hops")) parts.push_back(counted(count_at(event, "hops"), "hop", "hops"));
  if (event.contains("outcome")) parts.push_back(text_at(event, "outcome"));
  const std::string address = text_at(event, "address");
  if (text_at(event, "mesh") == "ble" && address >= "0xc000")  // a group
    parts.push_back("to " + address);
  if (event.contains("latency_us"))
    parts.push_back(fmt::format("after {:.1f} ms", number_at(event, "latency_us") / 1000));
  const std::string why = text_at(event, "why");
  return fmt::format("{}{}{}", fmt::join(parts, " "), why.empty() ? "" : ": ", why);
}

// ---- the table of gateways

std::size_t widest(const json& rows, const char* key, std::size_t head) {
  constexpr std::size_t most = 24;
  std::size_t width = head;
  for (const json& row : rows) width = std::max(width, columns(text_at(row, key)));
  return std::min(width, most);
}

/// One line for each topic that the broker refuses.
std::string refused_topics(const json& refused, const Screen& screen) {
  std::string out;
  const json& listed = list_at(refused, "list");
  for (const json& topic : listed)
    out += fmt::format("          {} {}: {} ({})\n", screen.paint("refused", "refused:"),
                       text_at(topic, "topic"), text_at(topic, "why"),
                       counted(count_at(topic, "waiting"), "message waits", "messages wait"));
  if (const std::uint64_t topics = count_at(refused, "topics"); topics > listed.size())
    out += fmt::format("          and {}\n",
                       counted(topics - listed.size(), "more topic", "more topics"));
  return out;
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
  const std::string refused = refused_topics(group_at(broker, "refused"), screen);
  if (refused.empty() && !why.empty() && state != "up")
    out += fmt::format("                   {}\n", why);
  out += refused;
  for (const json& right : list_at(broker, "missing_rights"))
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
  out += fmt::format(
      "Store     {}, {} of {}\n", counted(count_at(store, "depth"), "message", "messages"),
      show_bytes(count_at(store, "bytes")), show_bytes(count_at(store, "max_bytes")));
  if (const json& largest = group_at(store, "filled_by"); !text_at(largest, "robot").empty())
    out += fmt::format("          nearly full: {} has stored {}\n", text_at(largest, "robot"),
                       show_bytes(count_at(largest, "bytes")));
  else if (const json& most = group_at(store, "largest"); !most.empty())
    out += fmt::format("          most by {}: {}\n", text_at(most, "robot"),
                       show_bytes(count_at(most, "bytes")));
  if (const std::uint64_t count = count_at(store, "dead_letters"); count > 0)
    out +=
        fmt::format("          {}, {}{}: see slam-gatewayctl store list\n",
                    counted(count, "dead letter", "dead letters"),
                    show_bytes(count_at(store, "dead_letter_bytes")),
                    is_true(store, "dead_letters_nearly_full") ? ", nearly no room for more" : "");
  if (const std::string trouble = text_at(store, "why"); !trouble.empty())
    out += fmt::format("          {} {}\n", screen.paint("down", text_at(store, "state")), trouble);
  const json& retained = group_at(status, "retained");
  if (const json& most = group_at(retained, "most"); !most.empty())
    out += fmt::format("Retained  {} of {} topics, most by {}: {}\n", count_at(retained, "topics"),
                       count_at(retained, "max"), text_at(most, "robot"), count_at(most, "topics"));
  return out;
}

std::string robots(const json& robots, const Screen& screen) {
  std::vector<Row> rows{{"ROBOT", "MESH", "ADDRESS", "STATE", "SEEN", "UP", "DOWN", "REP", "MSG/s",
                         "P99ms", "dBm", "QUEUE"}};
  std::vector<std::vector<Row>> groups;
  for (const json& robot : robots) groups.push_back(robot_rows(robot, screen.now));
  if (groups.empty()) return "no robot has been heard yet\n";
  std::stable_sort(groups.begin(), groups.end(), [](const auto& a, const auto& b) {
    return strverscmp(a.front()[id].c_str(), b.front()[id].c_str()) < 0;  // robot2 before robot10
  });
  for (std::vector<Row>& group : groups) std::ranges::move(group, std::back_inserter(rows));
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
    line.erase(line.find_last_not_of(' ') + 1);
    out += line + "\n";
  }
  return out + absent_lines(robots) + deceptive_line(robots);
}

std::string event(const json& event, const Screen& screen) {
  const std::string kind = text_at(event, "event");
  const std::string time = text_at(event, "at");
  const std::string clock = time.size() >= 23 ? time.substr(11, 12) : time;  // milliseconds
  if (kind == "lost")
    return fmt::format("{} {} {}: this terminal is too slow for all of them\n", clock,
                       screen.paint(kind, pad(kind, 12)),
                       counted(count_at(event, "lost"), "event", "events"));
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

std::string fleet(const json& fleet, const Screen& screen) {
  const json& gateways = list_at(fleet, "gateways");
  const json& robots = list_at(fleet, "robots");
  const std::size_t width = std::max(widest(gateways, "gateway", 7), widest(robots, "gateway", 7));
  std::string out = pad("GATEWAY", width) + " STATE   ROBOTS UP   VERSION\n";
  for (const json& gateway : gateways) {
    const std::string state = text_at(gateway, "state");
    const std::string age = show_age(text_at(gateway, "since"), screen.now);
    std::string line =
        fmt::format("{} {} {:>6} {} {}", pad(cut_end(text_at(gateway, "gateway"), width), width),
                    screen.paint(state, pad(state, 7)), count_at(gateway, "robots"), pad(age, 4),
                    text_at(gateway, "version"));
    line.erase(line.find_last_not_of(' ') + 1);
    out += line + "\n";
  }
  if (robots.empty()) return out;
  const std::size_t id = widest(robots, "robot", 5);
  out += fmt::format("\n{} {} SINCE\n", pad("ROBOT", id), pad("GATEWAY", width));
  for (const json& robot : robots) {
    const auto served = robot.find("served");
    std::string trouble;
    const bool is_here = text_at(robot, "gateway") == text_at(fleet, "gateway");
    if (served != robot.end() && *served == false)
      trouble = fmt::format(" ({})", is_here ? "no session at the broker"
                                             : screen.paint("down", "that gateway is gone"));
    if (is_true(robot, "contested"))
      trouble += fmt::format(" ({})", screen.paint("contested", std::string(contested_words)));
    out += fmt::format("{} {} {}{}\n", pad(cut_end(text_at(robot, "robot"), id), id),
                       pad(cut_end(text_at(robot, "gateway"), width), width),
                       show_age(text_at(robot, "since"), screen.now), trouble);
  }
  return out;
}

namespace {

std::string or_dash(std::string text) { return text.empty() ? "-" : text; }

std::string one_client(const json& client, const Screen& screen) {
  const auto line = [](std::string_view name, const std::string& value) {
    return fmt::format("{:<18} {}\n", name, value);
  };
  const auto time_of = [&](const char* member) {
    return fmt::format("{:.1f} s", static_cast<double>(count_at(client, member)) / 1000.0);
  };
  const std::string session_state = text_at(client, "state");
  std::string out = line("robot", text_at(client, "robot"));
  out += line("client id", text_at(client, "client_id"));
  out += line("state", screen.paint(session_state, session_state));
  out += line("address", or_dash(text_at(client, "address")));
  out += line("heard", time_of("heard_ms_ago") + " ago");
  out += line("keep-alive", fmt::format("{} s", count_at(client, "keep_alive_s")));
  if (client.contains("sleep_s"))
    out += line("sleeps", fmt::format("{} s", count_at(client, "sleep_s")));
  out += line("clean session", is_true(client, "clean_session") ? "yes" : "no");
  out += line("will", or_dash(text_at(client, "will")));
  if (session_state != "disconnected" && session_state != "lost")
    out += line("in flight",
                fmt::format("{}, repeated {}; next copy after {}", count_at(client, "in_flight"),
                            counted(count_at(client, "repeats"), "time", "times"),
                            time_of("repeat_after_ms")));
  out += line("not acknowledged", fmt::format("{} of its messages, before the broker has them",
                                              count_at(client, "unacknowledged_up")));
  for (const json& subscription : list_at(client, "subscriptions"))
    out += line("subscription",
                fmt::format("{} (QoS {}, {})", text_at(subscription, "filter"),
                            count_at(subscription, "qos"), text_at(subscription, "topic_id_type")));
  for (const json& topic : list_at(client, "topics"))
    out += line("topic id", fmt::format("{} {}{}", count_at(topic, "id"), text_at(topic, "name"),
                                        is_true(topic, "told") ? "" : " (not registered yet)"));
  for (const json& topic : list_at(client, "waiting"))
    out += line("waits", topic.is_string() ? topic.get<std::string>() : "-");
  return out;
}

}  // namespace

std::string clients(const json& clients, const Screen& screen) {
  if (!clients.is_array() || clients.empty()) return "no MQTT-SN client is known\n";
  if (clients[0].is_object() && clients[0].value("topics", json()).is_array())
    return one_client(clients[0], screen);
  const std::size_t id = widest(clients, "robot", 5);
  const std::size_t where = widest(clients, "address", 7);
  std::string out = fmt::format("{} {} {} HEARD KEEP TOPICS SUBS WAIT\n", pad("ROBOT", id),
                                pad("STATE", 12), pad("ADDRESS", where));
  for (const json& client : clients) {
    const std::string session_state = text_at(client, "state");
    const std::string heard = fmt::format("{}s", count_at(client, "heard_ms_ago") / 1000);
    const std::string keep = fmt::format("{}s", count_at(client, "keep_alive_s"));
    out += fmt::format("{} {} {} {:>5} {:>4} {:>6} {:>4} {:>4}\n",
                       pad(cut_end(text_at(client, "robot"), id), id),
                       screen.paint(session_state, pad(session_state, 12)),
                       pad(cut_start(text_at(client, "address"), where), where), heard, keep,
                       count_at(client, "topics"), count_at(client, "subscriptions"),
                       count_at(client, "waiting") + count_at(client, "in_flight"));
  }
  return out;
}

namespace {

std::string transmissions(const json& of) {
  return fmt::format("{}, {} ms apart", counted(count_at(of, "sends"), "time", "times"),
                     count_at(of, "interval_ms"));
}

std::string model_line(const json& model) {
  std::string out =
      fmt::format("  {} {}", text_at(model, "element"), pad(text_at(model, "name"), 22));
  if (!text_at(model, "publishes_to").empty())
    out += fmt::format("publishes to {}, TTL {}", text_at(model, "publishes_to"),
                       count_at(model, "publish_ttl"));
  std::string groups;
  for (const json& group : list_at(model, "subscribed_to"))
    groups += (groups.empty() ? "subscribed to " : ", ") + text_at({{"group", group}}, "group");
  return out + groups + '\n';
}

}  // namespace

std::string ping(const json& ping, const Screen& screen) {
  std::string out = text_at(ping, "robot") + " (" + text_at(ping, "mesh") + ") ";
  if (!is_true(ping, "answered")) {
    out += screen.paint("lost", "no answer") + ": " + text_at(ping, "why");
    if (ping.contains("last_heard_s"))
      out += fmt::format("; last heard {:.0f} s ago", number_at(ping, "last_heard_s"));
    return out + "\n";
  }
  out += fmt::format("answered after {:.1f} ms", number_at(ping, "after_ms"));
  if (count_at(ping, "copies") > 1)
    out += fmt::format(", asked {} times", count_at(ping, "copies"));
  if (ping.contains("hops")) out += ", " + counted(count_at(ping, "hops"), "hop", "hops");
  if (ping.contains("ttl")) out += fmt::format(", TTL left {}", count_at(ping, "ttl"));
  if (ping.contains("rssi_dbm")) out += fmt::format(", {:.0f} dBm", number_at(ping, "rssi_dbm"));
  return out + "\n";
}

std::string pings(std::uint64_t sent, std::uint64_t answered) {
  return fmt::format("{} sent, {} answered, {:.0f} % lost\n", sent, answered,
                     100.0 * static_cast<double>(sent - answered) / static_cast<double>(sent));
}

std::string config(const json& config, const Screen& screen) {
  const json& relay = group_at(config, "relay");
  const std::string state = text_at(relay, "state");
  std::string out = fmt::format(
      "{}  {}  UUID {}\n  TTL       {}\n  Relay     {}{}\n  Transmit  {}\n",
      text_at(config, "robot"), text_at(config, "address"), text_at(config, "uuid"),
      count_at(config, "ttl"), state, state == "on" ? ", each packet " + transmissions(relay) : "",
      "each packet " + transmissions(group_at(config, "transmit")));
  for (const json& model : list_at(config, "models")) out += model_line(model);
  const json& wanted = group_at(config, "wanted");
  if (!wanted.empty()) out += "  Kept for this robot alone: " + wanted.dump() + "\n";
  for (const json& warning : list_at(config, "warnings"))
    out += "  " + screen.paint("refused", text_at({{"text", warning}}, "text")) + "\n";
  const std::string problem = text_at(config, "problem");
  if (!problem.empty()) out += "  " + screen.paint("refused", problem) + "\n";
  return out;
}

std::string devices(const json& devices, const Screen&) {
  if (devices.empty()) return "no new robot is in reach\n";
  std::string out = pad("UUID", 33) + " dBm SEEN " + pad("STATE", 8) + "ROBOT\n";
  for (const json& device : devices) {
    const std::string robot = text_at(device, "robot");
    out += fmt::format("{} {:>4} {:>3}s {} {}\n", pad(text_at(device, "uuid"), 32),
                       number_or_dash(device, "rssi_dbm", 1), count_at(device, "heard_s_ago"),
                       pad(text_at(device, "state"), 7), robot.empty() ? "-" : cut_end(robot, 29));
  }
  return out;
}

std::string foreign_robots(const json& robots, const json& nodes) {
  constexpr std::size_t most = 5;
  std::vector<std::string> names;
  for (const json& robot : robots) {
    const auto is_this = [&](const json& node) {
      return string_at(node, "robot") == string_at(robot, "id");
    };
    if (text_at(robot, "mesh") == "ble" && text_at(robot, "state") == "online" &&
        std::none_of(nodes.begin(), nodes.end(), is_this))
      names.push_back(text_at(robot, "id"));
  }
  if (names.empty()) return "";
  const std::size_t count = names.size();
  names.resize(std::min(count, most));
  return fmt::format("{} heard that this gateway did not provision: {}{}\n",
                     counted(count, "robot is", "robots are"), fmt::join(names, ", "),
                     count > most ? ", ..." : "");
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

std::string topology(const json& topology, const Screen& screen) {
  const json& rows = list_at(topology, "nodes");
  if (rows.empty()) return "no robot is in the mesh yet\n";
  const std::size_t id = std::max<std::size_t>(widest(rows, "robot", 5), 5);
  std::string out = fmt::format("{} ADDRESS RELAYS  DBM SEEN STATE\n", pad("ROBOT", id));
  bool has_relayed = false;
  for (const json& row : rows) {
    const std::string state = text_at(row, "state");
    const bool is_relayed = count_at(row, "hops") > 0;
    has_relayed = has_relayed || is_relayed;
    out += fmt::format("{} {} {:>6} {:>4}{}{:>4} {}\n", pad(cut_end(text_at(row, "robot"), id), id),
                       pad(text_at(row, "address"), 7), number_or_dash(row, "hops", 1),
                       number_or_dash(row, "rssi_dbm", 1), is_relayed ? "*" : " ",
                       show_age(text_at(row, "last_seen"), screen.now), screen.paint(state, state));
  }
  return out + (has_relayed ? "* of the last relay, not of the robot\n" : "");
}

std::string hearing(const json& hearing, const Screen&) {
  const auto range = [](std::uint64_t least, std::uint64_t most) {
    return least == most ? fmt::format("{}", least) : fmt::format("{}-{}", least, most);
  };
  const json& rows = list_at(hearing, "rows");
  const std::size_t id = widest(rows, "listener", 1);
  std::string out;
  std::string source;
  for (const json& row : rows) {
    if (source != text_at(row, "source")) out += text_at(row, "source") + " is heard by\n";
    source = text_at(row, "source");
    const std::string heard = range(count_at(row, "heard"), count_at(row, "heard_at_most"));
    const auto min_hops = std::max<std::uint64_t>(count_at(row, "min_hops"), 1);
    const auto max_hops = count_at(row, "max_hops");
    out += fmt::format("  {} {:>3} of {}", pad(cut_end(text_at(row, "listener"), id), id), heard,
                       count_at(row, "sent"));
    if (max_hops == 1) out += ", direct";
    if (max_hops > 1)
      out +=
          fmt::format(", {} relay{}", range(min_hops - 1, max_hops - 1), max_hops > 2 ? "s" : "");
    out += '\n';
  }
  for (const json& robot : list_at(hearing, "silent"))
    out += text_at({{"robot", robot}}, "robot") + " left questions unanswered\n";
  return out.empty() ? "nothing was measured\n" : out;
}

std::string removed(const json& node, const Screen&) {
  const std::string keys = is_true(node, "was_reset")
                               ? "it has forgotten the mesh's keys"
                               : "it may still have the mesh's keys; if strangers may have it, "
                                 "give the others new ones: "
                                 "slam-gatewayctl ble refresh-keys";
  return fmt::format(
      "{} ({}) is out of the mesh; only this takes it in again: slam-gatewayctl ble provision {} "
      "--id {}\n{}\n",
      text_at(node, "robot"), text_at(node, "address"), text_at(node, "uuid"),
      shell_word(text_at(node, "robot")), keys);
}

std::string refresh(const json& refresh, const Screen&) {
  const std::string step = text_at(refresh, "step");
  if (step == "none") return "the mesh's keys are not being refreshed\n";
  const std::string_view words = step == "distributing" ? "1 of 3, robots get the new keys"
                                 : step == "switching"  ? "2 of 3, robots switch to the new keys"
                                                        : "3 of 3, robots forget the old keys";
  std::string out = fmt::format("key refresh: step {}; {} of {} robots have done it\n", words,
                                count_at(refresh, "refreshed"), count_at(refresh, "robots"));
  for (const json& robot : list_at(refresh, "missing")) {
    const std::string problem = text_at(robot, "problem");
    out += fmt::format("waits for {}{}{}\n", text_at(robot, "robot"), problem.empty() ? "" : ": ",
                       problem);
  }
  return out;
}

std::string exported_mesh(const json& exported, const Screen&) {
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

std::string joining_countdown(const json& news) {
  const std::uint64_t under_way = count_at(news, "under_way");
  return fmt::format("new robots may join for {}{}", show_seconds(count_at(news, "seconds_left")),
                     under_way == 0 ? "" : fmt::format("; {} on their way", under_way));
}

std::string joining(const json& event, const Screen& screen) {
  const std::string what = text_at(event, "event");
  const std::string robot = text_at(event, "robot");
  const std::string why = text_at(event, "why");
  return fmt::format("{} {}{}{}\n", pad(text_at(event, "uuid"), 32),
                     screen.paint(what, pad(what, 10)), robot.empty() ? "" : " " + robot,
                     why.empty() ? "" : ": " + why);
}

std::string done(const json& done, const Screen&) {
  if (done.contains("nodes"))
    return fmt::format("imported: the mesh has {}\n",
                       counted(count_at(done, "nodes"), "robot", "robots"));
  if (done.contains("cleared"))
    return "the radio was cleared, and sends from the gateway's next address; robots may ignore it "
           "only if all its addresses were used before (the log says so)\n";
  if (done.contains("forgotten")) {
    const std::string robot = text_at(done, "forgotten");
    if (is_true(done, "was_known")) return robot + " is forgotten\n";
    return "no robot called " + robot +
           " is known here (slam-gatewayctl robots lists them); what the broker retains under this "
           "name is removed\n";
  }
  if (done.contains("in_force")) {
    const std::string restart = text_at(done, "needs_restart");
    const std::string in_force = text_at(done, "in_force");
    return (in_force.empty() ? "no changes applied\n" : "applied: " + in_force + "\n") +
           (restart.empty() ? "" : "only a restart changes: " + restart + "\n");
  }
  return "done\n";
}

std::string dead_letters_head(const json& first_page, bool is_of_topic) {
  const std::uint64_t count = count_at(first_page, "count");
  if (count == 0) return "no dead letters\n";
  if (first_page.at("letters").empty())
    return fmt::format("no dead letters of this topic; of others: {}\n", count);
  return fmt::format("{}{}, {}{}\n{:>8} {:>4} {:>6} {:>5} TOPIC: REASON\n",
                     is_of_topic ? "of this topic, of " : "",
                     counted(count, "dead letter", "dead letters"),
                     show_bytes(count_at(first_page, "bytes")), is_of_topic ? " in all:" : "", "ID",
                     "AGE", "BYTES", "TRIES");
}

std::string dead_letters(const json& letters, const Screen& screen) {
  std::string out;
  for (const json& letter : letters) {
    out +=
        fmt::format("{:>8} {:>4} {:>6} {:>5} {}: {}\n", count_at(letter, "id"),
                    show_age(text_at(letter, "stored_at"), screen.now), count_at(letter, "bytes"),
                    count_at(letter, "tries"), text_at(letter, "topic"), text_at(letter, "reason"));
  }
  return out;
}

std::string resent(const json& done, const Screen&) {
  const std::uint64_t left = count_at(done, "left");
  std::string out =
      counted(count_at(done, "resent"), "dead letter is", "dead letters are") + " sent again\n";
  if (left > 0)
    out += counted(left, "remains", "remain") + ": the store fails (slam-gatewayctl status)\n";
  return out;
}

std::string discarded(const json& done, const Screen&) {
  return counted(count_at(done, "discarded"), "dead letter was", "dead letters were") +
         " discarded\n";
}

}  // namespace show
}  // namespace slamgw::ctl
