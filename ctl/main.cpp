// SPDX-License-Identifier: Apache-2.0
// slam-gatewayctl: turns arguments into a request, and the daemon's answer into text or JSON. Exit
// status: 0 done, 1 failed, 2 wrong arguments.
#include <fmt/format.h>
#include <unistd.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <iterator>
#include <limits>
#include <set>
#include <sstream>
#include <thread>
#include <utility>

#include "ctl/command_line.hpp"
#include "ctl/connection.hpp"
#include "ctl/host/archives.hpp"
#include "ctl/host/audit.hpp"
#include "ctl/host/doctor.hpp"
#include "ctl/host/recording.hpp"
#include "ctl/host/robot_check.hpp"
#include "ctl/host/robot_keys.hpp"
#include "ctl/show.hpp"
#include "ctl/terminal.hpp"
#include "daemon/config/io/load.hpp"
#include "daemon/config/rules.hpp"
#include "daemon/control/wire.hpp"
#include "daemon/core/utf8.hpp"

namespace {

using namespace slamgw::ctl;

constexpr int exit_failed = 1;
constexpr std::chrono::milliseconds joining_interval{500};
constexpr std::chrono::seconds ping_interval{1};

/// Returns whether NO_COLOR is set and not empty (https://no-color.org).
bool is_colour_unwanted() {
  const char* value = std::getenv("NO_COLOR");
  return value != nullptr && *value != '\0';
}

Screen this_screen() {
  const bool with_colour = isatty(STDOUT_FILENO) == 1 && !is_colour_unwanted();
  return {with_colour, std::chrono::system_clock::now()};
}

std::string text_of(const Order& order, const nlohmann::json& result) {
  if (order.json) return slamgw::control::to_line(result);
  return fit_to_terminal(order.text(result, this_screen()), STDOUT_FILENO);
}

std::ifstream open_file(const std::string& path) {
  std::error_code error;
  if (std::filesystem::is_directory(path, error))
    throw Failure(path + " is a directory; a file is needed");
  std::ifstream file(path, std::ios::binary);
  if (!file.is_open()) throw Failure(path + " can't be read: " + std::strerror(errno));
  return file;
}

/// Reads JSON and removes its white space, because it goes over the socket as one line.
std::string read_mesh(const std::string& path) {
  std::ifstream file = open_file(path);
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  const auto json = nlohmann::json::parse(text, nullptr, false);
  if (json.is_discarded()) throw Failure(path + " is not JSON");
  return json.dump();
}

/// Makes the file first, so that an address is handed out only if the file can be written.
int export_mesh(const Order& order) {
  if (std::filesystem::exists(order.file))
    throw Failure(order.file + " can't be made: File exists");
  ArchiveFile file(order.file);
  Connection connection(order.socket);
  const auto exported = connection.ask(order.request, order.patience);
  std::ofstream out(file.path(), std::ios::binary);
  out << exported.at("mesh").get<std::string>() << std::flush;
  if (!out.good()) throw Failure(order.file + " can't be written: is the disk full?");
  file.finish();
  std::cout << text_of(order, {{"file", order.file}, {"address", exported.at("address")}});
  return 0;
}

/// Prints all dead letters, a page at a time; with --json as one JSON document.
void print_dead_letters(Connection& connection, Order order) {
  const bool is_table = order.course == Course::dead_letters && !order.json;
  const bool is_document = order.course == Course::dead_letters && order.json;
  const char* separator = "";
  auto page = connection.ask(order.request);
  const std::string head = show::dead_letters_head(page);
  if (is_table) std::cout << head;
  if (order.course == Course::exported && page.at("letters").empty())
    std::cerr << "slam-gatewayctl: " << head;
  if (is_document) {
    std::cout << "{\"count\":" << page.value("count", 0) << ",\"bytes\":" << page.value("bytes", 0)
              << ",\"letters\":[";
  }
  while (page.value("more", false)) {
    const auto& letters = page.at("letters");
    if (is_table) std::cout << show::dead_letters(letters, this_screen());
    for (const auto& letter : letters) {
      if (is_document)
        std::cout << std::exchange(separator, ",\n") << slamgw::escape_unprintable(letter.dump());
      if (order.course == Course::exported) std::cout << slamgw::control::to_line(letter);
    }
    order.request["after"] = letters.back().at("id");
    page = connection.ask(order.request);
  }
  if (is_document) std::cout << "]}\n";
}

/// Warns when the robot was never heard: its name may be mistyped, and a watch would stay silent.
void warn_of_unheard(Connection& connection, const nlohmann::json& request) {
  const auto robot = request.find("robot");
  if (robot == request.end()) return;
  const auto heard = connection.ask({{"command", "robots"}, {"robot", *robot}});
  if (heard.empty())
    std::cerr
        << "slam-gatewayctl: no robot called '" << text_at(request, "robot")
        << "' has been heard; watching for it (slam-gatewayctl robots lists those that were)\n";
}

/// Names the other gateway that serves the robot, if any. Call when a command was refused here.
void name_other_gateway(Connection& connection, const std::string& robot) {
  const auto fleet = connection.ask({{"command", "fleet"}});
  const auto robots = fleet.find("robots");
  if (robots == fleet.end()) return;
  for (const auto& row : *robots) {
    const std::string gateway = text_at(row, "gateway");
    if (text_at(row, "robot") != robot || gateway == text_at(fleet, "gateway")) continue;
    if (!row.value("served", true)) continue;  // its gateway is silent
    std::cerr << fmt::format(
        "slam-gatewayctl: {} is served by gateway {}: send from that gateway's host, or publish to "
        "the robot's topic at the broker\n",
        robot, gateway);
  }
}

/// Returns the exit status: it fails when a named id or topic has no dead letter. The name may be
/// mistyped, or another operator was faster.
int status_of_letters(const nlohmann::json& request, std::uint64_t found) {
  std::size_t named = request.contains("topic") ? 1 : 0;
  if (const auto ids = request.find("ids"); ids != request.end())
    named = ids->get<std::set<std::uint64_t>>().size();
  if (found >= named) return 0;
  std::cerr << "slam-gatewayctl: "
            << (found == 0 ? "there is no such dead letter"
                           : fmt::format("{} of these dead letters are not there", named - found))
            << "; slam-gatewayctl store list shows all\n";
  return exit_failed;
}

/// Asks the daemon; on a terminal, shows how long the request has been waiting.
nlohmann::json ask_patiently(Connection& connection, const Order& order) {
  const char* what = order.course == Course::scan ? "listening for new robots" : "waiting";
  LastLine line;
  return connection.ask(order.request, order.patience, [&](std::chrono::milliseconds waited) {
    if (const auto seconds = std::chrono::floor<std::chrono::seconds>(waited); seconds.count() > 0)
      line.show(fmt::format("{}: {} s", what, seconds.count()));
  });
}

/// Describes BLE robots that are heard but are not among the nodes. `shown`: the answer that `ble
/// nodes`, `ble scan` or `ble topology` shows.
std::string foreign_robots(Connection& connection, Course course, const nlohmann::json& shown) {
  const auto robots = connection.ask({{"command", "robots"}});
  const auto none = nlohmann::json::array();
  if (show::foreign_robots(robots, none).empty()) return {};
  if (course == Course::nodes) return show::foreign_robots(robots, shown);
  if (course == Course::topology) return show::foreign_robots(robots, shown.at("nodes"));
  return show::foreign_robots(robots, connection.ask({{"command", "ble nodes"}}, answer_patience));
}

/// Shows which robots join until joining ends. With --json, prints an event a line.
int show_joining(Connection& connection, const Order& order) {
  auto news = connection.ask(order.request);
  if (!order.json)
    std::cout << fit_to_terminal(show::joining_head(news), STDOUT_FILENO) << std::flush;
  bool has_joined = false;
  LastLine line;
  while (news.value("seconds_left", 0) > 0 || news.value("under_way", 0) > 0) {
    line.show(show::joining_countdown(news));
    std::this_thread::sleep_for(joining_interval);
    news = connection.ask({{"command", "ble joining"}, {"after", news.at("last")}});
    line.clear();
    for (const auto& event : news.at("events")) {
      has_joined = has_joined || event.value("event", "") == "joined";
      std::cout << text_of(order, event) << std::flush;
    }
  }
  std::cout << (order.json ? slamgw::control::to_line({{"event", "ended"}})
                           : "new robots may not join any more\n");
  return has_joined || order.request.value("minutes", 0) == 0 ? 0 : exit_failed;
}

/// Returns a row for each node, nearest first; robots at an unknown distance are last.
nlohmann::json topology(Connection& connection, const nlohmann::json& nodes) {
  const auto robots = connection.ask({{"command", "robots"}});
  auto rows = nlohmann::json::array();
  for (const auto& node : nodes) {
    nlohmann::json row{{"robot", node.value("robot", "")}, {"address", node.value("address", "")}};
    for (const auto& robot : robots) {
      if (robot.value("id", "") != row.value("robot", "") || robot.value("mesh", "") != "ble")
        continue;
      for (const char* key : {"hops", "ttl", "rssi_dbm", "last_seen", "state"})
        if (robot.contains(key)) row[key] = robot[key];
    }
    if (!row.contains("state")) row["state"] = "not heard";
    rows.push_back(std::move(row));
  }
  const auto distance = [](const nlohmann::json& row) {
    const bool is_known = row.contains("hops") && row["hops"].is_number();
    return is_known ? row["hops"].get<int>() : std::numeric_limits<int>::max();
  };
  std::stable_sort(rows.begin(), rows.end(),
                   [&](const auto& a, const auto& b) { return distance(a) < distance(b); });
  return {{"nodes", std::move(rows)}};
}

volatile std::sig_atomic_t is_interrupted = 0;
struct Interrupted {};

/// Lets the first Ctrl-C end the repeated pings, with a summary; the second one ends the program.
void watch_for_interrupt() {
  struct sigaction action {};
  action.sa_handler = [](int) { is_interrupted = 1; };
  action.sa_flags = SA_RESETHAND;
  sigaction(SIGINT, &action, nullptr);
}

void throw_if_interrupted(std::chrono::milliseconds) {
  if (is_interrupted != 0) throw Interrupted();
}

void wait_until(std::chrono::steady_clock::time_point end) {
  constexpr std::chrono::milliseconds interval{50};
  while (std::chrono::steady_clock::now() < end) {
    throw_if_interrupted({});
    std::this_thread::sleep_for(interval);
  }
}

/// Waits until the measurement has ended; `begun` is the answer to the order.
nlohmann::json hearing(Connection& connection, const nlohmann::json& begun) {
  std::cerr << "the gateway measures " << count_at(begun, "robots")
            << " robots, one after the other, which takes about " << count_at(begun, "seconds_left")
            << " s\n";
  nlohmann::json news = begun;
  while (text_at(news, "state") == "running") {
    std::this_thread::sleep_for(joining_interval);
    news = connection.ask({{"command", "ble measure-hearing"}, {"status", true}});
  }
  if (text_at(news, "state") != "done") throw Failure(text_at(news, "why"));
  return news;
}

/// Pings once a second; with --json, prints a line for each ping.
int ping(Connection& connection, const Order& order) {
  std::uint64_t ended = 0;
  std::uint64_t answered = 0;
  watch_for_interrupt();
  try {
    while (true) {
      const auto next = std::chrono::steady_clock::now() + ping_interval;
      const auto answer = connection.ask(order.request, order.patience, throw_if_interrupted);
      answered += answer.value("answered", false) ? 1 : 0;
      std::cout << text_of(order, answer) << std::flush;
      if (++ended == order.count) break;
      wait_until(next);
    }
  } catch (const Interrupted&) {  // a ping that waits for its answer does not count
  }
  if (!order.json && order.count > 1 && ended > 0) std::cout << show::pings(ended, answered);
  return answered > 0 ? 0 : exit_failed;
}

/// Records until the daemon hangs up, or Ctrl-C. Writes each line at once, so that none is lost.
[[noreturn]] void record(Connection& connection, const Order& order) {
  warn_of_unheard(connection, order.request);
  std::ofstream file(order.file, std::ios::app | std::ios::binary);
  if (!file.is_open()) throw Failure(order.file + " can't be written: " + std::strerror(errno));
  connection.ask(order.request);
  std::cerr << "recording to " << order.file << " until Ctrl-C\n";
  while (true) {
    const auto event = connection.next_event();
    if (!is_recorded(event)) continue;
    if (text_at(event, "event") == "lost")
      std::cerr << "slam-gatewayctl: " << count_at(event, "lost") << " events were lost\n";
    file << slamgw::control::to_line(event) << std::flush;
    if (!file.good()) throw Failure(order.file + " can't be written: is the disk full?");
  }
}

/// Escapes characters that hide or deceive. Keeps line ends, because each problem is a line.
std::string printable_lines(const std::string& text) {
  std::istringstream lines(text);
  std::string out;
  for (std::string line; std::getline(lines, line);) out += slamgw::escape_unprintable(line) + '\n';
  return out;
}

int run(Order order) {
  if (order.course == Course::mesh) return export_mesh(order);
  if (order.course != Course::record && !order.file.empty())
    order.request["text"] = read_mesh(order.file);
  Connection connection(order.socket);
  if (order.course == Course::record) record(connection, order);
  if (order.course == Course::watch) warn_of_unheard(connection, order.request);
  if (order.course == Course::dead_letters || order.course == Course::exported) {
    print_dead_letters(connection, std::move(order));
    return 0;
  }
  if (order.course == Course::ping) return ping(connection, order);
  if (order.course == Course::joining) return show_joining(connection, order);
  const bool is_send = order.course == Course::send;
  auto result = ask_patiently(connection, order);
  if (order.course == Course::topology) result = topology(connection, result);
  if (order.course == Course::hearing) result = hearing(connection, result);
  if (order.course == Course::watch)
    while (true) std::cout << text_of(order, connection.next_event()) << std::flush;
  std::cout << text_of(order, result);
  const bool is_of_mesh = order.course == Course::scan || order.course == Course::nodes ||
                          order.course == Course::topology;
  if (is_of_mesh && !order.json)
    std::cout << fit_to_terminal(foreign_robots(connection, order.course, result), STDOUT_FILENO);
  if (result.contains("was_known"))
    return result.value("was_known", true) ? 0 : exit_failed;  // the name may be mistyped
  if (order.course == Course::discarded)
    return status_of_letters(order.request, count_at(result, "discarded"));
  if (order.course == Course::resent) {
    const std::uint64_t left = count_at(result, "left");
    const int status = status_of_letters(order.request, count_at(result, "resent") + left);
    return left == 0 ? status : exit_failed;
  }
  const std::string outcome = is_send ? result.value("outcome", "") : "";
  if (outcome == "refused") name_other_gateway(connection, text_at(order.request, "robot"));
  return !is_send || outcome == "delivered" || outcome == "sent" ? 0 : exit_failed;
}

std::string text_of(const HostTask& task, const std::vector<Finding>& findings) {
  if (task.json) return slamgw::control::to_line(to_json(findings));
  return fit_to_terminal(to_text(findings), STDOUT_FILENO);
}

int doctor(const Installation& installation, const HostTask& task) {
  std::vector<Finding> findings;
  if (task.robot.empty()) {
    findings = examine(gather_facts(installation, task.socket));
  } else {
    Connection connection(task.socket);
    findings = examine_robot(task.robot, gather_robot_facts(task.robot, connection),
                             installation.parsed());
  }
  std::cout << text_of(task, findings);
  return has_problem(findings) ? exit_failed : 0;
}

int check(const HostTask& task) {
  const std::chrono::minutes time(task.minutes);
  {
    Connection connection(task.socket);
    warn_of_unheard(connection, {{"robot", task.robot}});
  }
  std::cerr << fmt::format("watching {} for {} min\n", task.robot, task.minutes);
  const auto findings = judge_robot(watch_robot(task.robot, time, task.socket));
  std::cout << text_of(task, findings);
  return has_problem(findings) ? exit_failed : 0;
}

/// Makes a running daemon read the changed file; a daemon that starts later reads it then. Returns
/// the result in words.
std::string reload(const HostTask& task) {
  try {
    const auto answer = Connection(task.socket).ask({{"command", "reload"}});
    const std::string left = text_at(answer, "needs_restart");
    return left.empty() ? "" : "Only a restart of the gateway changes: " + left + "\n";
  } catch (const NotRunning&) {
    return "The gateway is not running; the change takes effect when it starts.\n";
  }
}

/// Changes the keys, and shows a new key even if the daemon then fails to reload.
int manage_keys(const Installation& installation, const HostTask& task) {
  const auto answer = slamgw::ctl::change_keys(installation, task);
  std::cout << (task.json ? slamgw::control::to_line(answer)
                          : slamgw::ctl::text_of_keys(answer, isatty(STDOUT_FILENO) == 1));
  if (task.kind != HostTask::Kind::key_list) std::cerr << reload(task);
  return 0;
}

/// Returns the service's credentials. Reads their source file, because only the service's process
/// can read the copy that systemd makes.
std::optional<slamgw::Credentials> service_credentials() {
  const auto credentials = slamgw::load_service_credentials();
  if (credentials) return *credentials;
  throw Failure(to_string(credentials.error()) + " (type sudo, or name a user with --user)");
}

slamgw::BrokerSettings broker_for(const Installation& installation, const HostTask& task) {
  const auto& [config, problems, warnings, notices, places, file] = installation.parsed();
  if (task.broker.empty()) {
    if (!problems.empty())
      throw Failure(to_string(problems.front()) + " (or name another broker with --broker)");
    slamgw::BrokerSettings broker = config.broker;
    if (installation.is_service() && !broker.credentials_file && task.user.empty())
      broker.credentials = service_credentials();
    return broker;
  }
  const auto uri =
      slamgw::parse_broker_uri(task.broker).value();  // the command line has checked it
  slamgw::BrokerSettings broker = problems.empty() ? config.broker : slamgw::BrokerSettings{};
  broker.host = uri.host;
  broker.port = uri.port;
  broker.tls = uri.tls;
  broker.others.clear();
  broker.credentials.reset();  // these are for the configuration's broker
  return broker;
}

int replay(const Installation& installation, const HostTask& task) {
  std::ifstream file = open_file(task.file);
  auto messages = read_recording(file, task.file);
  if (messages.empty()) throw Failure(task.file + " holds no message of a robot");
  slamgw::BrokerSettings broker = broker_for(installation, task);
  const bool is_user_typed = !task.user.empty();
  if (is_user_typed) {
    broker.credentials = {task.user, read_password(task.user)};
    broker.credentials_file.reset();
  }
  const std::chrono::duration<double> length = messages.back().after;
  std::cerr << fmt::format("publishing {} messages over {:.1f} s to {}:{}\n", messages.size(),
                           length.count() / task.speed, broker.host, broker.port);
  const Replayed done = replay(std::move(messages), std::move(broker), task.speed, is_user_typed);
  if (task.json) {
    std::cout << slamgw::control::to_line(
        {{"published", done.published}, {"refused", done.refused}});
  } else {
    std::cout << done.published << " messages published";
    if (done.refused > 0) std::cout << ", " << done.refused << " refused: " << done.why;
    std::cout << '\n';
  }
  return done.refused == 0 ? 0 : exit_failed;
}

/// Asks on standard error, because a program may read standard output.
bool may_replace(const std::string& files) {
  std::cerr << "restore replaces these files, and keeps them under another name:\n"
            << files << "Go on? [y/N] " << std::flush;
  std::string answer;
  std::getline(std::cin, answer);
  return answer == "y" || answer == "Y" || answer == "yes";
}

/// Returns the configuration's path; with --socket alone, asks the daemon that listens there.
std::string configuration_of(const HostTask& task) {
  const bool needs_none = task.kind == HostTask::Kind::check || task.kind == HostTask::Kind::audit;
  if (!task.is_by_socket || needs_none) return task.configuration;
  try {
    const auto status = Connection(task.socket).ask({{"command", "status"}});
    if (std::string named = string_at(status, "configuration"); !named.empty()) return named;
  } catch (const NotRunning&) {
  }
  throw Failure("no daemon at " + task.socket +
                " says which configuration it reads: name it with --config");
}

int run(const HostTask& task) {
  const Installation installation(configuration_of(task));
  std::string text;
  switch (task.kind) {
    case HostTask::Kind::doctor: return doctor(installation, task);
    case HostTask::Kind::check: return check(task);
    case HostTask::Kind::replay: return replay(installation, task);
    case HostTask::Kind::audit: {
      const auto entries = read_audit(task.robot);
      std::cout << (task.json ? slamgw::control::to_line(entries) : audit_text(entries));
      return 0;
    }
    case HostTask::Kind::backup: text = backup(installation, task.file); break;
    case HostTask::Kind::restore:
      text = recorded({"restore", {}}, [&] {
        return restore(installation, task.file, [&](const std::string& files) {
          return task.is_confirmed || may_replace(files);
        });
      });
      break;
    case HostTask::Kind::ban:
    case HostTask::Kind::unban:
      text = recorded({task.kind == HostTask::Kind::ban ? "ban" : "unban", task.who}, [&] {
        const bool is_ban = task.kind == HostTask::Kind::ban;
        const std::string done = change_bans(installation, task.who, is_ban);
        return done + reload(task);
      });
      break;
    case HostTask::Kind::key_list: return manage_keys(installation, task);
    case HostTask::Kind::key_add:
    case HostTask::Kind::key_remove:
      recorded({task.kind == HostTask::Kind::key_add ? "key add" : "key remove", task.who}, [&] {
        manage_keys(installation, task);
        return std::string();
      });
      return 0;
    case HostTask::Kind::report: text = report(installation, task.socket, task.file); break;
  }
  std::cout << (task.json ? slamgw::control::to_line({{"file", task.file}, {"text", text}}) : text);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  const auto parsed = parse_command_line(argc, argv);
  if (const auto* exit = std::get_if<Exit>(&parsed)) return exit->status;
  try {
    if (const auto* task = std::get_if<HostTask>(&parsed)) return run(*task);
    return run(std::get<Order>(parsed));
  } catch (const std::exception& error) {
    std::cout << std::flush;
    std::cerr << fit_to_terminal("slam-gatewayctl: " + printable_lines(error.what()),
                                 STDERR_FILENO);
    return exit_failed;
  }
}
