// SPDX-License-Identifier: Apache-2.0
#include "ctl/command_line.hpp"

#include <nlohmann/json.hpp>

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdlib>
#include <functional>
#include <iostream>
#include <optional>
#include <sstream>
#include <vector>

#include <unistd.h>

#include "ctl/show.hpp"
#include "ctl/terminal.hpp"
#include "daemon/config/rules.hpp"
#include "daemon/control/wire.hpp"
#include "daemon/core/bans.hpp"
#include "daemon/core/edit_distance.hpp"
#include "daemon/core/operator_order.hpp"
#include "daemon/core/parse_number.hpp"

namespace slamgw::ctl {
namespace {

std::optional<std::int16_t> parse_coordinate(std::string_view text) {
  if (text.starts_with('+')) text.remove_prefix(1);
  return parse_number<std::int16_t>(text);
}

constexpr int exit_arguments = 2;
/// The daemon reports a command's outcome within 30 s, and gives up on it 5 s later.
constexpr std::chrono::seconds outcome_patience{45};
/// A robot on BLE may first have to finish another conversation.
constexpr std::chrono::seconds ping_patience{30};
/// The daemon ends orders about the mesh within 180 s.
constexpr std::chrono::seconds order_patience{200};

struct Arguments {
  Order order;
  HostTask task;
  bool is_task = false;
  CLI::Option* socket = nullptr;
  std::string robot;
  std::string type;
  std::string payload;
  bool is_hex = false;
  std::string uuid;
  std::uint64_t minutes = 5;
  bool is_forced = false;
  int address = 0;
  bool is_confirmed = false;
  std::vector<std::string> left_behind;
  bool leaves_silent = false;
  bool is_status = false;
  bool is_measured = false;
  std::vector<std::uint64_t> ids;
  std::string topic;
  bool is_all = false;
};

/// Puts "--" before a payload like "-5,7", which CLI11 would take for an option.
std::vector<std::string> with_payload_marked(int argc, const char* const* argv) {
  std::vector<std::string> words(argv + 1, argv + argc);
  const auto send = std::find(words.begin(), words.end(), "send");
  if (send == words.end() || std::find(send, words.end(), "--") != words.end()) return words;
  const auto is_negative = [](const std::string& word) {
    return word.size() > 1 && word[0] == '-' && word[1] >= '0' && word[1] <= '9';
  };
  const auto payload = std::find_if(send, words.end(), is_negative);
  if (payload == words.end()) return words;
  std::rotate(payload, payload + 1, words.end());
  words.insert(words.end() - 1, "--");
  return words;
}

using Text = decltype(Order::text);

/// Adapts a function whose text is the same on each screen.
template <std::string (*text)(const nlohmann::json&)>
std::string on_any_screen(const nlohmann::json& answer, const Screen&) {
  return text(answer);
}

std::string one_node(const nlohmann::json& node, const Screen& screen) {
  return show::nodes(nlohmann::json::array({node}), screen);
}

/// Returns the callback of a verb that the daemon answers. Puts the given options into the request.
auto ask(Arguments& a, const std::string& command, Text text, Course course = Course::once,
         std::chrono::seconds patience = answer_patience) {
  return [&a, command, text, course, patience] {
    a.order.text = text;
    a.order.course = course;
    a.order.patience = patience;
    auto& request = a.order.request;
    request["command"] = command;
    if (!a.robot.empty()) request["robot"] = a.robot;
    if (!a.type.empty()) request["type"] = a.type;
    if (!a.uuid.empty()) request["uuid"] = a.uuid;
    if (a.is_forced) request["force"] = true;
    if (a.address != 0) request["address"] = a.address;
    if (!a.ids.empty()) request["ids"] = a.ids;
    if (!a.topic.empty()) request["topic"] = a.topic;
    if (a.is_all) request["all"] = true;
    if (course == Course::exported) request["payloads"] = true;
  };
}

void add_commands(CLI::App& app, Arguments& a) {
  app.add_subcommand("status", "Links, robots, messages, store and memory")
      ->callback(ask(a, "status", show::status));
  app.add_subcommand("robots", "A row for each robot")->callback(ask(a, "robots", show::robots));
  app.add_subcommand("fleet", "The gateways of this broker, and which robot is where")
      ->callback(ask(a, "fleet", show::fleet));
  CLI::App* mqttsn = app.add_subcommand("mqttsn", "The sessions of robots on Thread");
  mqttsn->require_subcommand(1);
  CLI::App* clients = mqttsn->add_subcommand(
      "clients", "State, address, topics, subscriptions, queue and timers of each session");
  clients->add_option("ROBOT", a.robot, "Only this robot, with all of its topics");
  clients->callback(ask(a, "mqttsn clients", show::clients));
  app.add_subcommand("reload", "Read the configuration again; names what needs a restart")
      ->callback(ask(a, "reload", on_any_screen<show::done>, Course::once, order_patience));
  CLI::App* forget =
      app.add_subcommand("forget", "Forget an offline robot, here and at the broker");
  forget->add_option("ROBOT", a.robot, "The robot's id")->required();
  forget->callback(ask(a, "forget", on_any_screen<show::done>, Course::once, order_patience));
  CLI::App* watch =
      app.add_subcommand("watch", "What happens to each message, as it happens, until Ctrl-C");
  watch->add_option("--robot", a.robot, "Only this robot");
  watch->add_option("--type", a.type, "Only messages of this type");
  watch->callback(ask(a, "watch", show::event, Course::watch));
  CLI::App* record =
      app.add_subcommand("record", "Robots' messages and commands into a file, until Ctrl-C");
  record->add_option("FILE", a.order.file, "New, or continued")->required();
  record->add_option("--robot", a.robot, "Only this robot");
  record->callback(ask(a, "watch", nullptr, Course::record));
}

void add_send(CLI::App& app, Arguments& a) {
  CLI::App* send = app.add_subcommand("send", "Send a command to a robot and print its outcome");
  send->add_option("ROBOT", a.robot, "The robot's id")->required();
  send->add_option("TYPE", a.type, "cmd, run, or any other type")->required();
  send->add_option("PAYLOAD", a.payload, "Text; for cmd: X,Y in cm")->required();
  send->add_flag("--hex", a.is_hex, "PAYLOAD is pairs of hex digits");
  send->callback([&a] {
    const auto payload = parse_payload(a.type, a.payload, a.is_hex);
    if (!payload) throw CLI::ValidationError("PAYLOAD", payload.error());
    a.order.text = show::outcome;
    a.order.course = Course::send;
    a.order.patience = outcome_patience;
    a.order.request = {{"command", "send"},
                       {"robot", a.robot},
                       {"type", a.type},
                       {"payload_hex", to_hex(*payload)}};
  });
}

void add_ping(CLI::App& app, Arguments& a) {
  CLI::App* ping = app.add_subcommand("ping", "Ask a robot for a sign of life, and time it");
  ping->add_option("ROBOT", a.robot, "The robot's id")->required();
  ping->add_option("-c,--count", a.order.count, "Number of pings, one a second")
      ->check(CLI::Range(1, 1'000'000))
      ->capture_default_str();
  ping->callback(ask(a, "ping", show::ping, Course::ping, ping_patience));
}

/// Adds an option for one of the robot's own values; `default` is sent as null.
void add_wish(CLI::App& config, Arguments& a, const char* option, const char* key, const char* what,
              std::function<nlohmann::json(const std::string&)> read) {
  config.add_option_function<std::string>(
      option,
      [&a, option, key, what, read = std::move(read)](const std::string& word) {
        const nlohmann::json value = word == "default" ? nlohmann::json() : read(word);
        if (value.is_discarded())
          throw CLI::ValidationError(option, "'" + word + "' is not allowed; " + what);
        a.order.request[key] = value;
      },
      what);
}

/// Parses a unicast or group address.
std::optional<std::uint16_t> parse_mesh_address(std::string_view text) {
  if (!text.starts_with("0x")) return std::nullopt;
  const auto address = parse_number<std::uint16_t>(text.substr(2), 16);
  const bool is_valid = address && NodeConfigOrder::Publication::is_valid(*address);
  return is_valid ? address : std::nullopt;
}

void add_ble_config(CLI::App& ble, Arguments& a) {
  const nlohmann::json none(nlohmann::json::value_t::discarded);
  CLI::App* config = ble.add_subcommand("config", "How a robot's node is configured; change it");
  config->add_option("ROBOT", a.robot, "The robot's id")->required();
  add_wish(*config, a, "--ttl", "ttl", "TTL of what it sends: 0, 2 to 127, or default",
           [none](const std::string& word) {
             const auto ttl = parse_number<std::uint64_t>(word);
             return ttl && *ttl != 1 && *ttl <= 127 ? nlohmann::json(*ttl) : none;
           });
  add_wish(*config, a, "--relay", "relay", "Whether it relays: on, off, or default",
           [none](const std::string& word) {
             return word == "on" || word == "off" ? nlohmann::json(word == "on") : none;
           });
  add_wish(*config, a, "--transmit", "transmit",
           "How it sends each packet, TIMESxMS: 1-8 times, 10, 20 ... 320 ms, as 3x20, or default",
           [none](const std::string& word) {
             const std::size_t by = word.find('x');
             const auto sends = parse_number<std::uint64_t>(std::string_view(word).substr(0, by));
             const auto ms =
                 by == word.npos ? std::nullopt : parse_number<std::uint64_t>(word.substr(by + 1));
             if (!sends || !ms || !Transmissions::is_valid(*sends, *ms)) return none;
             return nlohmann::json{{"sends", *sends}, {"interval_ms", *ms}};
           });
  constexpr std::uint16_t first_group = 0xc000;
  for (const char* const key : {"subscribe", "unsubscribe"})
    config->add_option_function<std::string>(
        fmt::format("--{}", key),
        [&a, key](const std::string& word) {
          const auto group = parse_mesh_address(word);
          if (!group || *group < first_group)
            throw CLI::ValidationError(fmt::format("--{}", key),
                                       "'" + word + "' is not a group, 0xc000-0xfeff");
          a.order.request[key] = *group;
        },
        std::string(key) == "subscribe" ? "Hear this group, 0xc000-0xfeff, beside ble_mesh.groups"
                                        : "Stop hearing this group");
  config->add_option_function<std::string>(
      "--publish",
      [&a](const std::string& word) {
        const std::size_t is = word.find('=');
        const std::string where = is == word.npos ? "" : word.substr(is + 1);
        const auto address = parse_mesh_address(where);
        if (is == 0 || (!address && where != "default"))
          throw CLI::ValidationError("--publish", "'" + word + "' is not MODEL=ADDRESS");
        a.order.request["publish"] = {{"model", word.substr(0, is)}, {"address", nullptr}};
        if (address) a.order.request["publish"]["address"] = *address;
      },
      "MODEL=ADDRESS: where a model publishes to, as sensor_update=0xc00a; or MODEL=default");
  config->callback(ask(a, "ble config", show::config, Course::once, order_patience));
}

constexpr const char* reset_board_warning =
    "reset-board makes the serial board forget its keys, addresses and sequence numbers for good. "
    "The daemon gives it the mesh's keys and addresses again at once; it sends from the next of "
    "the gateway's addresses, so that robots hear it. Say --yes if that is what you want";

constexpr const char* refresh_keys_warning =
    "refresh-keys gives the robots of the BLE mesh new keys, and waits for those that are switched "
    "off. Name stolen robots with --leave-behind: they get none, and are out of the mesh. For some "
    "seconds the gateway hears no robot. Say --yes if that is what you want";

void add_refresh_keys(CLI::App& ble, Arguments& a) {
  CLI::App* refresh = ble.add_subcommand("refresh-keys", "Give the mesh new keys");
  auto* const left = refresh->add_option("--leave-behind", a.left_behind,
                                         "This robot gets no new keys, and is out of the mesh");
  left->expected(1)->take_all()->type_name("ROBOT");
  auto* const silent = refresh->add_flag("--leave-behind-silent", a.leaves_silent,
                                         "Also leave behind robots that have not answered");
  auto* const status = refresh->add_flag("--status", a.is_status, "How far it has come");
  status->excludes(left)->excludes(silent);
  refresh->add_flag("--yes", a.is_confirmed, "Begin, or leave robots behind");
  refresh->callback([&a, order = ask(a, "ble refresh-keys", on_any_screen<show::refresh>,
                                     Course::once, order_patience)] {
    if (!a.is_confirmed && !a.is_status)
      throw CLI::ValidationError("refresh-keys", refresh_keys_warning);
    order();
    a.order.request["left_behind"] = a.left_behind;
    a.order.request["silent"] = a.leaves_silent;
    a.order.request["status"] = a.is_status;
  });
}

void add_ble_changes(CLI::App& ble, Arguments& a) {
  CLI::App* provision = ble.add_subcommand("provision", "Take a new robot into the mesh");
  provision->add_option("UUID", a.uuid, "As `ble scan` shows it")->required();
  provision->add_option("--id", a.robot, "The robot's name from then on")->required();
  provision->callback(ask(a, "ble provision", one_node, Course::once, order_patience));
  CLI::App* permit = ble.add_subcommand("permit-join", "Let new robots in, and show who joins");
  permit->add_option("--minutes", a.minutes, "For how long; 0 ends it")
      ->check(CLI::Range(0, 24 * 60))
      ->capture_default_str();
  permit->add_option("--id", a.robot, "One robot only, and its name from then on");
  permit->callback([&a, order = ask(a, "ble permit-join", show::joining, Course::joining)] {
    order();
    a.order.request["minutes"] = a.minutes;
  });
  CLI::App* remove = ble.add_subcommand("remove", "Remove a robot from the mesh");
  remove->add_option("ROBOT", a.robot, "The robot's id")->required();
  remove->add_flag("--force", a.is_forced, "Forget it even when it does not answer");
  remove->callback(
      ask(a, "ble remove", on_any_screen<show::removed>, Course::once, order_patience));
  CLI::App* import = ble.add_subcommand("import", "Import an existing mesh");
  import->add_option("FILE", a.order.file, "Its database: of Nordic's Python tool, or a mesh.json")
      ->required();
  import->callback(ask(a, "ble import", on_any_screen<show::done>, Course::once, order_patience));
  CLI::App* exported = ble.add_subcommand("export", "Let another gateway join this mesh");
  exported->add_option("FILE", a.order.file, "A new file, for `ble import` there; holds the keys")
      ->required();
  exported->add_option("--address", a.address, "It has joined already: the address that it got")
      ->check(CLI::Range(1, 0x7fff));
  exported->callback(
      ask(a, "ble export", on_any_screen<show::exported_mesh>, Course::mesh, order_patience));
  CLI::App* reset = ble.add_subcommand("reset-board", "Clear the serial board and set it up again");
  reset->add_flag("--yes", a.is_confirmed, "Robots may ignore the gateway for a while: do it");
  reset->callback([&a, order = ask(a, "ble reset-board", on_any_screen<show::done>, Course::once,
                                   order_patience)] {
    if (!a.is_confirmed) throw CLI::ValidationError("reset-board", reset_board_warning);
    order();
  });
}

void add_ble(CLI::App& app, Arguments& a) {
  CLI::App* ble = app.add_subcommand("ble", "Robots of the BLE mesh");
  ble->require_subcommand(1);
  ble->add_subcommand("scan", "New robots in reach")
      ->callback(ask(a, "ble scan", on_any_screen<show::devices>, Course::scan, order_patience));
  ble->add_subcommand("nodes", "Robots in the mesh")
      ->callback(ask(a, "ble nodes", show::nodes, Course::nodes));
  CLI::App* topology =
      ble->add_subcommand("topology", "How each robot's messages come here: relays and signal");
  topology->add_flag("--measure", a.is_measured, "Measure which robots hear which; takes a while");
  topology->callback([&a, shown = ask(a, "ble nodes", show::topology, Course::topology),
                      measured = ask(a, "ble measure-hearing", on_any_screen<show::hearing>,
                                     Course::hearing)] { a.is_measured ? measured() : shown(); });
  add_ble_config(*ble, a);
  add_ble_changes(*ble, a);
  add_refresh_keys(*ble, a);
}

void add_dead_letter_choice(CLI::App& command, Arguments& a, Text text, Course course) {
  auto* const ids = command.add_option("ID", a.ids, "Those with these ids (see `store list`)");
  auto* const topic = command.add_option("--topic", a.topic, "Those of this topic");
  auto* const all = command.add_flag("--all", a.is_all, "All of them");
  ids->excludes(topic)->excludes(all);
  topic->excludes(all);
  const std::string name = "store " + command.get_name();
  command.callback([&a, name, order = ask(a, name, text, course, order_patience)] {
    if (a.ids.empty() && a.topic.empty() && !a.is_all)
      throw CLI::ValidationError(name, "say which: ids, --topic or --all");
    order();
  });
}

void add_store(CLI::App& app, Arguments& a) {
  CLI::App* store =
      app.add_subcommand("store", "Dead letters: messages that the broker did not take");
  store->require_subcommand(1);
  const auto add_listing = [&](const char* name, const char* what, Course course) {
    CLI::App* listing = store->add_subcommand(name, what);
    listing->add_option("--topic", a.topic, "Only those of this topic");
    listing->callback(ask(a, "store list", nullptr, course));
  };
  add_listing("list", "A row for each: topic, reason, tries, age", Course::dead_letters);
  add_listing("export", "All there is of each, one JSON document a line", Course::exported);
  add_dead_letter_choice(
      *store->add_subcommand("resend", "Send them again, behind what is undelivered"), a,
      on_any_screen<show::resent>, Course::resent);
  add_dead_letter_choice(*store->add_subcommand("discard", "Forget them for good"), a,
                         on_any_screen<show::discarded>, Course::discarded);
}

std::string complaint_about_broker(const std::string& uri) {
  return parse_broker_uri(uri) ? "" : uri + " is not mqtt://host:port or mqtts://host:port";
}

/// Used in place of CLI::Range, which accepts "nan".
std::string complaint_about_speed(const std::string& factor) {
  const double number = std::strtod(factor.c_str(), nullptr);
  return number >= 0.001 && number <= 1000 ? "" : factor + " is not a factor from 0.001 to 1000";
}

void add_host_tasks(CLI::App& app, Arguments& a) {
  const auto add_to = [&a](CLI::App& group, const char* verb, HostTask::Kind kind,
                           const char* what) {
    CLI::App* task = group.add_subcommand(verb, what);
    CLI::Option* const configuration =
        task->add_option("--config", a.task.configuration, "The daemon's configuration")
            ->capture_default_str();
    task->callback([&a, kind, configuration] {
      a.is_task = true;
      a.task.kind = kind;
      a.task.is_by_socket = a.socket->count() > 0 && configuration->count() == 0;
    });
    return task;
  };
  const auto add = [&](const char* verb, HostTask::Kind kind, const char* what) {
    return add_to(app, verb, kind, what);
  };
  add("doctor", HostTask::Kind::doctor, "The way from radio to broker: what is well, what to do")
      ->add_option("ROBOT", a.task.robot, "What is known of this robot, and why it is silent");
  CLI::App* check =
      add("check", HostTask::Kind::check, "Watch a robot: what its firmware should do otherwise");
  check->add_option("ROBOT", a.task.robot, "The robot's id")->required();
  check->add_option("--minutes", a.task.minutes, "For how long")
      ->check(CLI::Range(1, 24 * 60))
      ->capture_default_str();
  const auto add_with_file = [&](const char* verb, HostTask::Kind kind, const char* what) {
    CLI::App* task = add(verb, kind, what);
    task->add_option("FILE", a.task.file, "The archive")->required();
    return task;
  };
  add_with_file("backup", HostTask::Kind::backup,
                "Configuration, credentials, mesh keys and kept messages into one file");
  add_with_file("restore", HostTask::Kind::restore, "Restore a backup, on this host or a new one")
      ->add_flag("--yes", a.task.is_confirmed, "Replace files without asking");
  CLI::App* replay = add("replay", HostTask::Kind::replay,
                         "Publish recorded messages of robots with the recorded timing");
  replay->add_option("FILE", a.task.file, "Made by record")->required();
  replay->add_option("--broker", a.task.broker, "mqtt://host:port; else the configuration's")
      ->check(complaint_about_broker);
  replay->add_option("--user", a.task.user, "At the broker; its password is asked for");
  replay->add_option("--speed", a.task.speed, "2: twice as fast")->check(complaint_about_speed);
  add("ban", HostTask::Kind::ban, "Refuse a robot or an address, until unban")
      ->add_option("WHO", a.task.who, "A robot's id, an address, or a network: fd00::/64")
      ->required()
      ->check([](const std::string& who) {
        return Bans::is_valid(who) ? "" : who + " is neither a robot's id nor an address";
      });
  add("unban", HostTask::Kind::unban, "Take back a ban")
      ->add_option("WHO", a.task.who, "As it was given to ban")
      ->required();
  add("audit", HostTask::Kind::audit, "Who asked the gateway for what, from the journal")
      ->add_option("--robot", a.task.robot, "Only what is about this robot");
  CLI::App* key = app.add_subcommand("key", "Robots' keys for DTLS");
  key->require_subcommand(1);
  add_to(*key, "list", HostTask::Kind::key_list, "Which robots have a key");
  add_to(*key, "add", HostTask::Kind::key_add, "Make a key for a robot and show it, once")
      ->add_option("ROBOT", a.task.who, "Its id or MQTT-SN client id")
      ->required();
  add_to(*key, "remove", HostTask::Kind::key_remove, "End the robot's key and connection")
      ->add_option("ROBOT", a.task.who, "As key add had it, or as key list shows it")
      ->required();
  add_with_file("report", HostTask::Kind::report, "What support needs to see, without secrets");
}

/// Refuses empty words: a variable of a script may be unset, and `watch --robot ""` must not mean
/// all robots.
void refuse_empty_words(CLI::App& app) {
  const auto complaint = [](const std::string& word) {
    return word.empty() ? "is empty; a text is needed" : "";
  };
  for (CLI::Option* const option : app.get_options())
    if (option->get_name() != "PAYLOAD") option->check(complaint);
  for (CLI::App* const verb : app.get_subcommands({})) refuse_empty_words(*verb);
}

std::string verbs_of(const CLI::App& app) {
  std::string names;
  for (const CLI::App* known : app.get_subcommands({}))
    names += (names.empty() ? "" : ", ") + known->get_name();
  return names;
}

/// Suggests the nearest verb; names all verbs if more than half of the word would have to change.
std::string suggestion(const CLI::App& app, const std::string& word) {
  constexpr std::size_t longest_compared = 64;
  std::string nearest;
  std::size_t least = std::string::npos;
  for (const CLI::App* known : app.get_subcommands({})) {
    const std::size_t distance = edit_distance(word.substr(0, longest_compared), known->get_name());
    if (distance < least) nearest = known->get_name();
    least = std::min(least, distance);
  }
  return 2 * least <= word.size() ? "did you mean " + nearest + "?" : "there are: " + verbs_of(app);
}

/// Names a missing or misspelt verb; CLI11 only says that a verb is required. The first word that
/// is neither an option nor an option's value is the verb; after a group such as `ble` or `store`,
/// the second such word is a verb too.
std::optional<std::string> complaint_about_verb(const CLI::App& app,
                                                const std::vector<std::string>& words) {
  const CLI::App* group = &app;
  std::string before;
  for (std::size_t i = 0; i < words.size(); ++i) {
    if (words[i].starts_with("-")) {
      if (words[i] == "--help" || words[i] == "-h" || words[i] == "--version") return std::nullopt;
      if (words[i] == "--socket" || words[i] == "--config" || words[i] == "--broker" ||
          words[i] == "--user")
        ++i;
      continue;
    }
    const auto known = group->get_subcommands(
        [&word = words[i]](const CLI::App* verb) { return verb->get_name() == word; });
    if (known.empty())
      return fmt::format("there is no command '{}{}'; {} (slam-gatewayctl {}--help)", before,
                         text_at({{"word", words[i]}}, "word"), suggestion(*group, words[i]),
                         before);
    if (known.front()->get_require_subcommand_min() == 0) return std::nullopt;
    group = known.front();
    before += words[i] + " ";
  }
  return "a command is missing; there are: " + verbs_of(*group) + " (slam-gatewayctl " + before +
         "--help)";
}

/// Returns an example for verbs whose arguments are easily mistaken.
const char* hint(const CLI::App& app) {
  if (app.got_subcommand("watch"))
    return "for example: slam-gatewayctl watch --robot NRF_5 --type update\n";
  if (app.got_subcommand("send")) return "for example: slam-gatewayctl send NRF_5 cmd 40,-20\n";
  return "";
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

std::variant<Order, HostTask, Exit> parse_command_line(int argc, const char* const* argv) {
  Arguments arguments;
  CLI::App app("Asks and directs the running slam-gatewayd", "slam-gatewayctl");
  arguments.socket =
      app.add_option("--socket", arguments.order.socket, "The daemon's control socket")
          ->capture_default_str();
  app.add_flag("--json", arguments.order.json, "One JSON document (watch: one a line)");
  app.set_version_flag("--version", "slam-gatewayctl " SLAMGW_VERSION);
  app.fallthrough();
  app.require_subcommand(1);
  add_commands(app, arguments);
  add_send(app, arguments);
  add_ping(app, arguments);
  add_ble(app, arguments);
  add_store(app, arguments);
  add_host_tasks(app, arguments);
  refuse_empty_words(app);
  try {
    std::vector<std::string> words = with_payload_marked(argc, argv);
    if (const auto complaint = complaint_about_verb(app, words)) {
      std::cerr << fit_to_terminal("slam-gatewayctl: " + *complaint + '\n', STDERR_FILENO);
      return Exit{exit_arguments};
    }
    std::reverse(words.begin(), words.end());  // CLI11 expects them in this order
    app.parse(words);
  } catch (const CLI::ParseError& error) {
    std::ostringstream out, complaint;
    const int status = app.exit(error, out, complaint) == 0 ? 0 : exit_arguments;
    std::cout << fit_to_terminal(out.str(), STDOUT_FILENO);
    std::cerr << fit_to_terminal(complaint.str(), STDERR_FILENO);
    if (status != 0) std::cerr << hint(app);
    return Exit{status};
  }
  if (!arguments.is_task) return arguments.order;
  arguments.task.socket = arguments.order.socket;
  arguments.task.json = arguments.order.json;
  return arguments.task;
}

}  // namespace slamgw::ctl
