// SPDX-License-Identifier: Apache-2.0
// The commands that the daemon answers: their options, and how each proceeds.
#include <fmt/format.h>
#include <unistd.h>
#include <nlohmann/json.hpp>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <functional>
#include <iostream>
#include <iterator>
#include <limits>
#include <optional>
#include <set>
#include <thread>
#include <utility>

#include "ctl/command_line.hpp"
#include "ctl/host/installation.hpp"
#include "ctl/host/recording.hpp"
#include "ctl/terminal.hpp"
#include "daemon/control/wire.hpp"
#include "daemon/core/parse_number.hpp"
#include "daemon/core/topic_scheme.hpp"
#include "daemon/core/utf8.hpp"

namespace slamgw::ctl {
namespace {

using nlohmann::json;

/// The daemon reports a command's outcome within 30 s, and gives up on it 5 s later.
constexpr std::chrono::seconds outcome_patience{45};
/// A robot on BLE may first have to finish another conversation.
constexpr std::chrono::seconds ping_patience{30};
/// The daemon ends orders about the mesh within 180 s, but for those that wait for its disk.
constexpr std::chrono::seconds order_patience{200};

constexpr std::chrono::milliseconds joining_interval{500};
constexpr std::chrono::seconds ping_interval{1};

/// Colours a terminal, unless NO_COLOR is set and not empty (https://no-color.org).
Screen this_screen() {
  const char* const unwanted = std::getenv("NO_COLOR");
  const bool with_colour = isatty(STDOUT_FILENO) == 1 && (!unwanted || *unwanted == '\0');
  return {with_colour, std::chrono::system_clock::now()};
}

void print(const Order& order, const json& result) {
  std::cout << (order.json ? control::to_line(result)
                           : fit_to_terminal(order.text(result, this_screen()), STDOUT_FILENO))
            << std::flush;
}

/// Reads JSON and removes its white space, because it goes over the socket as one line.
std::string read_mesh(const std::string& path) {
  std::ifstream file = open_file(path);
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  const auto mesh = json::parse(text, nullptr, false);
  if (mesh.is_discarded()) throw Failure(path + " is not JSON");
  return mesh.dump();
}

/// Names the other gateway that serves the robot, if any. Call when a command was refused here.
void name_other_gateway(Connection& daemon, const std::string& robot) {
  const auto fleet = daemon.ask({{"command", "fleet"}});
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
int status_of_letters(const json& request, std::uint64_t found) {
  std::size_t named = request.contains("topic") ? 1 : 0;
  if (const auto ids = request.find("ids"); ids != request.end())
    named = ids->get<std::set<std::uint64_t>>().size();
  if (found >= named) return 0;
  std::cerr << "slam-gatewayctl: "
            << (found == 0 ? "there is no such dead letter"
                           : counted(named - found, "of these dead letters is",
                                     "of these dead letters are") +
                                 " not there")
            << "; slam-gatewayctl store list shows all\n";
  return exit_failed;
}

/// Asks the daemon; on a terminal, shows how long the request has been waiting.
json ask_patiently(Connection& daemon, const Order& order, const char* what = "waiting") {
  LastLine line;
  return daemon.ask(order.request, order.patience, [&](std::chrono::milliseconds waited) {
    if (const auto seconds = std::chrono::floor<std::chrono::seconds>(waited); seconds.count() > 0)
      line.show(fmt::format("{}: {} s", what, seconds.count()));
  });
}

json ask_and_print(Connection& daemon, const Order& order) {
  json result = ask_patiently(daemon, order);
  print(order, result);
  return result;
}

/// Describes, for people, BLE robots that are heard but are not among the nodes. Asks for the nodes
/// if they are not given, and such a robot may exist.
void print_foreign(Connection& daemon, const Order& order, std::optional<json> nodes = {}) {
  if (order.json) return;
  const auto robots = daemon.ask({{"command", "robots"}});
  if (show::foreign_robots(robots, json::array()).empty()) return;
  if (!nodes) nodes = daemon.ask({{"command", "ble nodes"}});
  std::cout << fit_to_terminal(show::foreign_robots(robots, *nodes), STDOUT_FILENO);
}

/// Returns a row for each node, nearest first; robots at an unknown distance are last.
json distances(Connection& daemon, const json& nodes) {
  const auto robots = daemon.ask({{"command", "robots"}});
  auto rows = json::array();
  for (const auto& node : nodes) {
    json row{{"robot", node.value("robot", "")}, {"address", node.value("address", "")}};
    for (const auto& robot : robots) {
      if (robot.value("id", "") != row.value("robot", "") || robot.value("mesh", "") != "ble")
        continue;
      for (const char* key : {"hops", "ttl", "rssi_dbm", "last_seen", "state"})
        if (robot.contains(key)) row[key] = robot[key];
    }
    if (!row.contains("state")) row["state"] = "not heard";
    rows.push_back(std::move(row));
  }
  const auto distance = [](const json& row) {
    const bool is_known = row.contains("hops") && row["hops"].is_number();
    return is_known ? row["hops"].get<int>() : std::numeric_limits<int>::max();
  };
  std::stable_sort(rows.begin(), rows.end(),
                   [&](const auto& a, const auto& b) { return distance(a) < distance(b); });
  return {{"nodes", std::move(rows)}};
}

struct Interrupted {};

/// Takes Ctrl-C while pings are repeated, which then end with a summary.
class CtrlC {
 public:
  CtrlC() {
    sigemptyset(&signals_);
    sigaddset(&signals_, SIGINT);
    sigprocmask(SIG_BLOCK, &signals_, nullptr);
  }
  /// Throws Interrupted if Ctrl-C comes within this time, or came before.
  void wait(std::chrono::nanoseconds time) const {
    const auto rest = std::max(time, std::chrono::nanoseconds{0}).count();
    const timespec limit{rest / 1'000'000'000, rest % 1'000'000'000};
    if (sigtimedwait(&signals_, nullptr, &limit) == SIGINT) throw Interrupted();
  }

 private:
  sigset_t signals_{};
};

int answer(Connection& daemon, const Order& order) {
  ask_and_print(daemon, order);
  return 0;
}

int forget(Connection& daemon, const Order& order) {
  const json result = ask_and_print(daemon, order);
  return result.value("was_known", true) ? 0 : exit_failed;  // the name may be mistyped
}

int send(Connection& daemon, const Order& order) {
  const std::string outcome = string_at(ask_and_print(daemon, order), "outcome");
  if (outcome == "refused") name_other_gateway(daemon, text_at(order.request, "robot"));
  return outcome == "delivered" || outcome == "sent" ? 0 : exit_failed;
}

/// With --json, prints a line for each ping.
int ping(Connection& daemon, const Order& order) {
  std::uint64_t ended = 0;
  std::uint64_t answered = 0;
  const CtrlC ctrl_c;
  try {
    while (true) {
      const auto next = std::chrono::steady_clock::now() + ping_interval;
      const auto answer = daemon.ask(order.request, order.patience, [&](auto) { ctrl_c.wait({}); });
      answered += answer.value("answered", false) ? 1 : 0;
      print(order, answer);
      if (++ended == order.count) break;
      ctrl_c.wait(next - std::chrono::steady_clock::now());
    }
  } catch (const Interrupted&) {  // a ping that waits for its answer does not count
  }
  if (!order.json && order.count > 1 && ended > 0) std::cout << show::pings(ended, answered);
  return answered > 0 ? 0 : exit_failed;
}

int watch(Connection& daemon, const Order& order) {
  warn_of_unheard(daemon, string_at(order.request, "robot"));
  daemon.ask(order.request);
  while (true) print(order, daemon.next_event());
}

/// Writes each line at once, so that none is lost.
int record(Connection& daemon, const Order& order) {
  warn_of_unheard(daemon, string_at(order.request, "robot"));
  std::ofstream file = open_recording(order.file);
  daemon.ask(order.request);
  std::cerr << "recording to " << order.file << " until Ctrl-C\n";
  while (true) {
    const auto event = daemon.next_event();
    if (!is_recorded(event)) continue;
    if (text_at(event, "event") == "lost")
      std::cerr << "slam-gatewayctl: "
                << counted(count_at(event, "lost"), "event was", "events were") << " lost\n";
    file << control::to_line(event) << std::flush;
    if (!file.good()) throw Failure(order.file + " can't be written: is the disk full?");
  }
}

int scan(Connection& daemon, const Order& order) {
  print(order, ask_patiently(daemon, order, "listening for new robots"));
  print_foreign(daemon, order);
  return 0;
}

int nodes(Connection& daemon, const Order& order) {
  print_foreign(daemon, order, ask_and_print(daemon, order));
  return 0;
}

int topology(Connection& daemon, const Order& order) {
  const json nodes = ask_patiently(daemon, order);
  print(order, distances(daemon, nodes));
  print_foreign(daemon, order, nodes);
  return 0;
}

int hearing(Connection& daemon, const Order& order) {
  json news = ask_patiently(daemon, order);
  std::cerr << "the gateway measures " << counted(count_at(news, "robots"), "robot", "robots")
            << ", one after the other, which takes about " << count_at(news, "seconds_left")
            << " s\n";
  while (text_at(news, "state") == "running") {
    std::this_thread::sleep_for(joining_interval);
    news = daemon.ask({{"command", "ble measure-hearing"}, {"status", true}});
  }
  if (text_at(news, "state") != "done") throw Failure(text_at(news, "why"));
  print(order, news);
  return 0;
}

/// With --json, prints an event a line.
int joining(Connection& daemon, const Order& order) {
  auto news = daemon.ask(order.request);
  if (!order.json)
    std::cout << fit_to_terminal(show::joining_head(news), STDOUT_FILENO) << std::flush;
  bool has_joined = false;
  LastLine line;
  while (news.value("seconds_left", 0) > 0 || news.value("under_way", 0) > 0) {
    line.show(show::joining_countdown(news));
    std::this_thread::sleep_for(joining_interval);
    news = daemon.ask({{"command", "ble joining"}, {"after", news.at("last")}});
    line.clear();
    for (const auto& event : news.at("events")) {
      has_joined = has_joined || event.value("event", "") == "joined";
      print(order, event);
    }
  }
  std::cout << (order.json ? control::to_line({{"event", "ended"}})
                           : "new robots may not join any more\n");
  return has_joined || order.request.value("minutes", 0) == 0 ? 0 : exit_failed;
}

/// Makes the file first, so that an address is handed out only if the file can be written.
int export_mesh(Connection& daemon, const Order& order) {
  if (std::filesystem::exists(order.file))
    throw Failure(order.file + " can't be made: File exists");
  NewFile file(order.file);
  const auto exported = daemon.ask(order.request, order.patience);
  file.write(exported.at("mesh").get<std::string>());
  file.give_to_caller();
  file.finish();
  print(order, {{"file", order.file}, {"address", exported.at("address")}});
  return 0;
}

/// Calls `show` for each page of dead letters, of which `page` is the first.
void each_page(Connection& daemon, const Order& order, json page,
               const std::function<void(const json& letters)>& show) {
  json request = order.request;
  while (page.value("more", false)) {
    const auto& letters = page.at("letters");
    show(letters);
    request["after"] = letters.back().at("id");
    page = daemon.ask(request);
  }
}

int list_letters(Connection& daemon, const Order& order) {
  const json first = daemon.ask(order.request);
  if (!order.json) {
    std::cout << show::dead_letters_head(first, order.request.contains("topic"));
    each_page(daemon, order, first,
              [](const json& letters) { std::cout << show::dead_letters(letters, this_screen()); });
    return 0;
  }
  std::cout << "{\"count\":" << first.value("count", 0) << ",\"bytes\":" << first.value("bytes", 0)
            << ",\"letters\":[";
  each_page(daemon, order, first, [separator = ""](const json& letters) mutable {
    for (const auto& letter : letters)
      std::cout << std::exchange(separator, ",\n") << escape_unprintable(letter.dump());
  });
  std::cout << "]}\n";
  return 0;
}

int export_letters(Connection& daemon, const Order& order) {
  const json first = daemon.ask(order.request);
  if (first.at("letters").empty())
    std::cerr << "slam-gatewayctl: "
              << show::dead_letters_head(first, order.request.contains("topic"));
  each_page(daemon, order, first, [](const json& letters) {
    for (const auto& letter : letters) std::cout << control::to_line(letter);
  });
  return 0;
}

int resend_letters(Connection& daemon, const Order& order) {
  const json result = ask_and_print(daemon, order);
  const std::uint64_t left = count_at(result, "left");
  const int status = status_of_letters(order.request, count_at(result, "resent") + left);
  return left == 0 ? status : exit_failed;
}

int discard_letters(Connection& daemon, const Order& order) {
  const json result = ask_and_print(daemon, order);
  return status_of_letters(order.request, count_at(result, "discarded"));
}

// ---- the command line

using Ask = decltype(Order::ask);
using Text = decltype(Order::text);

/// A verb of the command line, in the group that its name begins with ("ble scan").
class Verb {
 public:
  Verb(CLI::App& app, Order& order, const std::string& name, const char* what)
      : order_(order), name_(name) {
    const std::size_t space = name.find(' ');
    CLI::App& group = space == name.npos ? app : *app.get_subcommand(name.substr(0, space));
    verb_ = group.add_subcommand(name.substr(space + 1), what);
  }

  CLI::App* operator->() const { return verb_; }

  /// Adds an option whose value becomes a member of the request.
  template <class Value = std::string>
  CLI::Option* value(const char* option, const char* key, const char* what) {
    const auto set = [&request = order_.request, key](const Value& value) { request[key] = value; };
    return verb_->add_option_function<Value>(option, set, what);
  }
  CLI::Option* flag(const char* option, const char* key, const char* what) {
    const auto set = [&request = order_.request, key] { request[key] = true; };
    return verb_->add_flag_callback(option, set, what);
  }
  void robot() { value("ROBOT", "robot", "The robot's id")->required(); }
  void file(const char* what) { verb_->add_option("FILE", order_.file, what)->required(); }

  /// Sets the request, whose command has the verb's name. `complete` may refuse the arguments, or
  /// change the request.
  void asks(Text text, Ask ask = answer, std::chrono::seconds patience = answer_patience,
            std::function<void()> complete = {}) {
    verb_->callback([&order = order_, name = name_, text, ask, patience, complete] {
      order.ask = ask;
      order.text = text;
      order.patience = patience;
      order.request["command"] = name;
      if (complete) complete();
    });
  }

 private:
  Order& order_;
  std::string name_;
  CLI::App* verb_;
};

/// Returns whether a flag was typed, but not as `--flag=false`.
bool is_on(const CLI::Option* flag) { return flag->count() > 0 && flag->as<bool>(); }

std::optional<std::int16_t> parse_coordinate(std::string_view text) {
  if (text.starts_with('+')) text.remove_prefix(1);
  return parse_number<std::int16_t>(text);
}

std::string one_node(const json& node, const Screen& screen) {
  return show::nodes(json::array({node}), screen);
}

struct NodeOption {
  const char* name;  ///< after its dashes, the name of the request's member
  const char* help;
};

constexpr NodeOption node_options[] = {
    {"--ttl", "TTL of what it sends: 0, 2 to 127, or default"},
    {"--relay", "Whether it relays: on, off, or default"},
    {"--transmit",
     "How it sends each packet, TIMESxMS: 1-8 times, 10, 20 ... 320 ms, as 3x20, or default"},
    {"--subscribe", "Hear this group, 0xc000-0xfeff, beside ble_mesh.groups"},
    {"--unsubscribe", "Stop hearing this group, 0xc000-0xfeff"},
    {"--publish",
     "MODEL=ADDRESS: where a model publishes to, as sensor_update=0xc00a; or MODEL=default"}};

/// Reads `default`, `on`, `off`, a number, or TIMESxMS; other words are texts. An address is always
/// hexadecimal: a decimal number is taken for none.
json value_of(const std::string& word, bool is_address) {
  if (word == "default") return nullptr;
  if (word == "on" || word == "off") return word == "on";
  const std::string_view text = word;
  if (is_address && !text.starts_with("0x")) return word;
  const auto number = is_address ? parse_number<std::uint64_t>(text.substr(2), 16)
                                 : parse_number<std::uint64_t>(text);
  if (number) return *number;
  const std::size_t by = text.find('x');
  if (by == text.npos) return word;
  const auto sends = parse_number<std::uint64_t>(text.substr(0, by));
  const auto ms = parse_number<std::uint64_t>(text.substr(by + 1));
  return sends && ms ? json{{"sends", *sends}, {"interval_ms", *ms}} : json(word);
}

void add_ble_config(CLI::App& app, Order& order) {
  Verb config(app, order, "ble config", "How a robot's node is configured; change it");
  config.robot();
  config.asks(show::config, answer, order_patience);
  for (const NodeOption& option : node_options) {
    const auto set = [&order, option](const std::string& word) {
      const std::string key = option.name + 2;
      const std::size_t is = word.find('=');
      json value = value_of(word, key.ends_with("subscribe"));
      if (key == "publish" && is != word.npos)
        value = {{"model", word.substr(0, is)}, {"address", value_of(word.substr(is + 1), true)}};
      const json request{{"command", "ble config"}, {"robot", "any"}, {key, value}};
      if (is == 0 || !control::parse_request(control::to_line(request)))
        throw CLI::ValidationError(option.name, "'" + word + "' is not allowed; " + option.help);
      order.request[key] = value;
    };
    config->add_option_function<std::string>(option.name, set, option.help);
  }
}

constexpr const char* reset_board_warning =
    "reset-board makes the BLE mesh's radio forget its keys, addresses and sequence numbers for "
    "good. The daemon gives it the mesh's keys and addresses again at once; it sends from the next "
    "of the gateway's addresses, so that robots hear it. Say --yes if that is what you want";

constexpr const char* refresh_keys_warning =
    "refresh-keys gives the robots of the BLE mesh new keys, and waits for those that are switched "
    "off. Name stolen robots with --leave-behind: they get none, and are out of the mesh. For some "
    "seconds the gateway hears no robot. Say --yes if that is what you want";

void add_refresh_keys(CLI::App& app, Order& order) {
  Verb refresh(app, order, "ble refresh-keys", "Give the mesh new keys");
  auto* const left = refresh.value<std::vector<std::string>>(
      "--leave-behind", "left_behind", "This robot gets no new keys, and is out of the mesh");
  left->expected(1)->take_all()->type_name("ROBOT");
  auto* const silent = refresh.flag("--leave-behind-silent", "silent",
                                    "Also leave behind robots that have not answered");
  auto* const status = refresh.flag("--status", "status", "How far it has come");
  status->excludes(left)->excludes(silent);
  refresh->add_flag("--yes", order.is_confirmed, "Begin, or leave robots behind");
  refresh.asks(show::refresh, answer, order_patience, [&order, status] {
    if (!order.is_confirmed && !is_on(status))
      throw CLI::ValidationError("refresh-keys", refresh_keys_warning);
    order.request.emplace("left_behind", json::array());
  });
}

void add_ble_changes(CLI::App& app, Order& order) {
  Verb provision(app, order, "ble provision", "Take a new robot into the mesh");
  provision.value("UUID", "uuid", "As `ble scan` shows it")->required();
  provision.value("--id", "robot", "The robot's name from then on")->required();
  provision.asks(one_node, answer, order_patience);
  Verb permit(app, order, "ble permit-join", "Let new robots in, and show who joins");
  permit.value<std::uint64_t>("--minutes", "minutes", "For how long; 0 ends it")
      ->check(CLI::Range(0, 24 * 60))
      ->default_str("5");
  permit.value("--id", "robot", "One robot only, and its name from then on");
  permit.asks(show::joining, joining, answer_patience,
              [&order] { order.request.emplace("minutes", 5); });
  Verb remove(app, order, "ble remove", "Remove a robot from the mesh");
  remove.robot();
  remove.flag("--force", "force", "Forget it even when it does not answer");
  remove.asks(show::removed, answer, order_patience);
  Verb imported(app, order, "ble import", "Import an existing mesh");
  imported.file("Its database: of Nordic's Python tool, or a mesh.json");
  imported.asks(show::done, answer, order_patience,
                [&order] { order.request["text"] = read_mesh(order.file); });
  Verb exported(app, order, "ble export", "Let another gateway join this mesh");
  exported.file("A new file, for `ble import` there; holds the keys");
  exported.value<int>("--address", "address", "It has joined already: the address that it got")
      ->check(CLI::Range(1, 0x7fff));
  exported.asks(show::exported_mesh, export_mesh, order_patience);
  Verb reset(app, order, "ble reset-board", "Clear the mesh's radio and set it up again");
  reset->add_flag("--yes", order.is_confirmed,
                  "The next of the gateway's addresses is used up: do it");
  reset.asks(show::done, answer, order_patience, [&order] {
    if (!order.is_confirmed) throw CLI::ValidationError("reset-board", reset_board_warning);
  });
}

void add_ble(CLI::App& app, Order& order) {
  app.add_subcommand("ble", "Robots of the BLE mesh")->require_subcommand(1);
  Verb(app, order, "ble scan", "New robots in reach").asks(show::devices, scan, order_patience);
  Verb(app, order, "ble nodes", "Robots in the mesh").asks(show::nodes, nodes);
  Verb distances(app, order, "ble topology",
                 "How each robot's messages come here: relays and signal");
  auto* const measure = distances->add_flag("--measure")
                            ->description("Measure which robots hear which; takes a while");
  distances.asks(show::topology, topology, answer_patience, [&order, measure] {
    order.request["command"] = is_on(measure) ? "ble measure-hearing" : "ble nodes";
    if (!is_on(measure)) return;
    order.text = show::hearing;
    order.ask = hearing;
  });
  add_ble_config(app, order);
  add_ble_changes(app, order);
  add_refresh_keys(app, order);
}

void add_letter_choice(CLI::App& app, Order& order, const char* name, const char* what, Text text,
                       Ask ask) {
  Verb verb(app, order, name, what);
  auto* const ids = verb.value<std::vector<std::uint64_t>>(
      "ID", "ids", "Those with these ids (see `store list`)");
  auto* const topic = verb.value("--topic", "topic", "Those of this topic");
  auto* const all = verb.flag("--all", "all", "All of them");
  ids->check([](const std::string& id) {  // CLI11 takes -1 and too large numbers for the largest
    return parse_number<std::uint64_t>(id) ? "" : "ids are numbers, as `store list` shows them";
  });
  ids->excludes(topic)->excludes(all);
  topic->excludes(all);
  verb.asks(text, ask, order_patience, [name, ids, topic, all] {
    if (ids->count() + topic->count() == 0 && !is_on(all))
      throw CLI::ValidationError(name, "say which: ids, --topic or --all");
  });
}

void add_store(CLI::App& app, Order& order) {
  app.add_subcommand("store", "Dead letters: messages that the broker did not take")
      ->require_subcommand(1);
  Verb list(app, order, "store list", "A row for each: topic, reason, tries, age");
  Verb exported(app, order, "store export", "All there is of each, one JSON document a line");
  for (Verb* const listing : {&list, &exported})
    listing->value("--topic", "topic", "Only those of this topic");
  list.asks(nullptr, list_letters);
  exported.asks(nullptr, export_letters, answer_patience, [&order] {
    order.request["command"] = "store list";
    order.request["payloads"] = true;
  });
  add_letter_choice(app, order, "store resend",
                    "Send them again, before messages that were stored later", show::resent,
                    resend_letters);
  add_letter_choice(app, order, "store discard", "Forget them for good", show::discarded,
                    discard_letters);
}

void add_send(CLI::App& app, Order& order) {
  Verb verb(app, order, "send", "Send a command to a robot and print its outcome");
  verb.robot();
  verb.value("TYPE", "type", "cmd, run, or any other type")->required();
  auto* const payload =
      verb->add_option("PAYLOAD", "Text; for cmd: X,Y in cm")->required()->type_name("TEXT");
  auto* const hex = verb->add_flag("--hex")->description("PAYLOAD is pairs of hex digits");
  verb.asks(show::outcome, send, outcome_patience, [&order, payload, hex] {
    const auto bytes =
        parse_payload(string_at(order.request, "type"), payload->as<std::string>(), is_on(hex));
    if (!bytes) throw CLI::ValidationError("PAYLOAD", bytes.error());
    order.request["payload_hex"] = to_hex(*bytes);
  });
}

}  // namespace

Result<Bytes, std::string> parse_payload(std::string_view type, std::string_view text,
                                         bool is_hex) {
  if (is_hex) {
    auto bytes = from_hex(text);
    if (!bytes) return std::string("with --hex it is pairs of hex digits, like 0a00ecff");
    return std::move(*bytes);
  }
  if (type != "cmd") return to_bytes(text);
  const std::size_t comma = text.find(',');
  const auto x = parse_coordinate(text.substr(0, comma));
  const auto y = comma == text.npos ? std::nullopt : parse_coordinate(text.substr(comma + 1));
  if (!x || !y) {
    return std::string(
        "for cmd it is X,Y (each -32768 to 32767 cm), like 120,-33; other bytes with --hex");
  }
  return ByteWriter().write_i16_le(*x).write_i16_le(*y).take();
}

std::ifstream open_file(const std::string& path) {
  std::error_code error;
  if (std::filesystem::is_directory(path, error))
    throw Failure(path + " is a directory; a file is needed");
  std::ifstream file(path, std::ios::binary);
  if (!file.is_open()) throw Failure(path + " can't be read: " + std::strerror(errno));
  return file;
}

void warn_of_unheard(Connection& daemon, const std::string& robot) {
  if (robot.empty()) return;
  const auto heard = daemon.ask({{"command", "robots"}, {"robot", robot}});
  if (heard.empty())
    std::cerr
        << "slam-gatewayctl: no robot called '" << escape_unprintable(robot)
        << "' has been heard; watching for it (slam-gatewayctl robots lists those that were)\n";
}

void add_daemon_commands(CLI::App& app, Order& order) {
  Verb(app, order, "status", "Links, robots, messages, store and memory").asks(show::status);
  Verb(app, order, "robots", "A row for each robot").asks(show::robots);
  Verb(app, order, "fleet", "The gateways of this broker, and which robot is where")
      .asks(show::fleet);
  app.add_subcommand("mqttsn", "The sessions of robots on Thread")->require_subcommand(1);
  Verb clients(app, order, "mqttsn clients",
               "State, address, topics, subscriptions, queue and timers of each session");
  clients.value("ROBOT", "robot", "Only this robot, with all of its topics");
  clients.asks(show::clients);
  Verb(app, order, "reload", "Read the configuration again; names what needs a restart")
      .asks(show::done);
  Verb forget_verb(app, order, "forget", "Forget an offline robot, here and at the broker");
  forget_verb.robot();
  forget_verb.asks(show::done, forget);
  Verb watch_verb(app, order, "watch", "What happens to each message, as it happens, until Ctrl-C");
  watch_verb.value("--robot", "robot", "Only this robot");
  watch_verb.value("--type", "type", "Only messages of this type")
      ->check([](const std::string& type) {
        return is_valid_level(type) ? ""
                                    : "is not a type, the last level of a topic, such as update";
      });
  watch_verb.asks(show::event, watch);
  Verb recorder(app, order, "record", "Robots' messages and commands into a file, until Ctrl-C");
  recorder.file("New, or continued");
  recorder.value("--robot", "robot", "Only this robot");
  recorder.asks(nullptr, record, answer_patience, [&order] { order.request["command"] = "watch"; });
  add_send(app, order);
  Verb ping_verb(app, order, "ping", "Ask a robot for a sign of life, and time it");
  ping_verb.robot();
  ping_verb->add_option("-c,--count", order.count, "Number of pings, one a second")
      ->check(CLI::Range(1, 1'000'000))
      ->capture_default_str();
  ping_verb.asks(show::ping, ping, ping_patience);
  add_ble(app, order);
  add_store(app, order);
}

}  // namespace slamgw::ctl
