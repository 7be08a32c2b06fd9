// SPDX-License-Identifier: Apache-2.0
#include <nlohmann/json.hpp>

#include "ctl/host/doctor.hpp"

#include <fmt/format.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/udp.hpp>
#include <cerrno>
#include <chrono>
#include <fstream>
#include <map>
#include <span>
#include <sstream>

#include "ctl/host/audit.hpp"
#include "ctl/show.hpp"
#include "daemon/config/rules.hpp"
#include "daemon/core/broker_link.hpp"
#include "daemon/core/parse_number.hpp"
#include "daemon/core/robot_names.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ctl {
namespace {

namespace fs = std::filesystem;
using boost::asio::ip::udp;
using nlohmann::json;

/// With less, the store soon has no room for a message.
constexpr std::uint64_t least_free_bytes = std::uint64_t{64} << 20;
/// A robot has one client; behind a forwarder there are some dozens, and these answer soon.
constexpr std::uint64_t crowd_of_one_address = 100;

std::string_view to_string(Health health) {
  switch (health) {
    case Health::well: return "ok";
    case Health::warning: return "warning";
    case Health::problem: return "problem";
    case Health::unknown: return "unknown";
  }
  return "unknown";
}

const std::string broker_page = "/usr/share/doc/slam-gateway/broker.md";
const std::string bluez_page = "/usr/share/doc/slam-gateway/bluez.md";

class Examination {
 public:
  explicit Examination(const HostFacts& facts)
      : facts_(facts), config_(facts.configuration.config) {}

  std::vector<Finding> run() {
    configuration();
    daemon();
    clock();
    disk();
    thread();
    ble();
    broker();
    rights();
    engine();
    fleet();
    store();
    retained();
    robots();
    sessions();
    return std::move(findings_);
  }

 private:
  void add(std::string step, Health health, std::string detail, std::string remedy = {}) {
    if (health == Health::well) remedy.clear();
    findings_.push_back({std::move(step), health, std::move(detail), std::move(remedy)});
  }

  void configuration() {
    const ParseResult& read = facts_.configuration;
    for (const Problem& problem : read.problems)
      if (facts_.closed_keys.contains(problem.key) &&
          problem.text.find("cannot be read") != problem.text.npos)
        add("configuration", Health::unknown,
            problem.key + " is not checked: you may not read its file",
            "type the command with sudo");
      else
        add("configuration", Health::problem, slamgw::to_string(problem),
            "fix that line, then: sudo slam-gatewayd --check-config");
    for (const Problem& warning : read.warnings)
      add("configuration", Health::warning, slamgw::to_string(warning));
    if (read.problems.empty()) add("configuration", Health::well, "read without problems");
  }

  void daemon() {
    if (facts_.status.is_null())
      return add("daemon", Health::problem, facts_.status_failure,
                 facts_.is_silent    ? "sudo systemctl restart slam-gateway"
                 : facts_.is_running ? "sudo slam-gatewayctl doctor"
                                     : "sudo journalctl -u slam-gateway -n 20 says why");
    const std::string version = text_at(facts_.status, "version");
    if (version != facts_.own_version)
      return add("daemon", Health::warning,
                 fmt::format("runs version {}, installed is {}", version, facts_.own_version),
                 "sudo systemctl restart slam-gateway");
    add("daemon", Health::well,
        fmt::format("version {}, up for {}", version,
                    show_seconds(count_at(facts_.status, "uptime_s"))));
  }

  void clock() {
    if (!facts_.is_clock_synchronised) return;
    if (*facts_.is_clock_synchronised) return add("clock", Health::well, "synchronised");
    add("clock", Health::warning, "is not synchronised: times in topics and logs may be wrong",
        "timedatectl; a Pi without network time starts in the past");
  }

  void disk() {
    const std::string& directory = config_.store.directory;
    if (!facts_.state_free_bytes)
      return add("disk", Health::problem, directory + " is not there",
                 "install -d -o slam-gateway -g slam-gateway -m 700 " + directory);
    const std::string free =
        fmt::format("{} free for {}", show_bytes(*facts_.state_free_bytes), directory);
    if (*facts_.state_free_bytes < least_free_bytes)
      return add("disk", Health::problem, free, "make room: df -h, journalctl --disk-usage");
    add("disk", Health::well, free);
  }

  void thread() {
    if (!config_.mqttsn.enabled) return add("thread", Health::well, "not enabled (mqttsn.enabled)");
    interfaces();
    if (facts_.taken_port)
      add("thread: port", Health::problem,
          fmt::format("another program has UDP port {}", *facts_.taken_port),
          fmt::format("sudo ss -ulpn 'sport = :{}' names it; when it has ended: sudo systemctl "
                      "restart slam-gateway",
                      *facts_.taken_port));
    if (!facts_.is_running) return link("thread", "thread");
    const bool is_there =
        !config_.mqttsn.names_interface() || find_interface(config_.mqttsn.interface) != nullptr;
    if (config_.mqttsn.multicast_group && is_there) multicast();
    link("thread", "thread");
    node();
    places();
    if (facts_.is_search_answered) search();
  }

  /// Judges the role that otbr-agent reports, if it runs.
  void node() {
    const std::string role = text_at(group_at(group_at(facts_.status, "meshes"), "thread"), "role");
    if (role == "disabled")
      return add("thread: node", Health::problem,
                 "Thread is switched off here, so no robot of the mesh is heard",
                 "sudo ot-ctl ifconfig up; sudo ot-ctl thread start");
    if (role == "detached")
      return add("thread: node", Health::problem,
                 "has no Thread network (detached), so no robot of the mesh is heard",
                 "after a start it may take two minutes; then: sudo ot-ctl dataset active; "
                 "journalctl -u otbr-agent");
    if (!role.empty()) add("thread: node", Health::well, "is attached as " + role);
  }

  void places() {
    const json& thread = group_at(group_at(facts_.status, "meshes"), "thread");
    const json& counters = group_at(thread, "counters");
    const json& places = group_at(thread, "places");
    const json& unproven = group_at(places, "most_unproven");
    const std::uint64_t clients = count_at(counters, "clients");
    const bool is_crowd = count_at(unproven, "clients") >= crowd_of_one_address &&
                          text_at(unproven, "address").find('/') == std::string::npos;
    if (10 * clients < 9 * config_.mqttsn.max_clients && !is_crowd) return;
    const auto where = [](const json& most) {
      return most.empty() ? ""
                          : fmt::format(" ({} of them at {})", count_at(most, "clients"),
                                        text_at(most, "address"));
    };
    const json& all = group_at(places, "most");
    const json& most =
        2 * count_at(unproven, "clients") >= count_at(all, "clients") ? unproven : all;
    add("thread: clients", Health::warning,
        fmt::format("{} of {} places are taken (mqttsn.max_clients){}, {} by clients that have not "
                    "answered anything{}: these give way to others",
                    clients, config_.mqttsn.max_clients, where(all),
                    count_at(counters, "clients_unanswered"), where(unproven)),
        most.empty() ? "slam-gatewayctl forget ROBOT, for robots that are gone"
                     : "if these clients are not robots: sudo slam-gatewayctl ban " +
                           text_at(most, "address") +
                           "; for robots that are gone: slam-gatewayctl forget ROBOT");
  }

  void retained() {
    const json& retained = group_at(facts_.status, "retained");
    const json& most = group_at(retained, "most");
    if (10 * count_at(retained, "topics") < 9 * count_at(retained, "max") || most.empty()) return;
    add("retained", Health::warning,
        fmt::format("robots have {} of {} retained topics, most of them {}: {}; further messages "
                    "are not retained",
                    count_at(retained, "topics"), count_at(retained, "max"), text_at(most, "robot"),
                    count_at(most, "topics")),
        "why does it retain so much? sudo slam-gatewayctl ban ROBOT; clear its topics at the "
        "broker");
  }

  const InterfaceFacts* find_interface(const std::string& name) const {
    const auto found = std::find_if(facts_.interfaces.begin(), facts_.interfaces.end(),
                                    [&](const InterfaceFacts& i) { return i.name == name; });
    return found == facts_.interfaces.end() ? nullptr : &*found;
  }

  void interfaces() {
    const mqttsn::Settings& settings = config_.mqttsn;
    if (settings.names_interface())
      return thread_interface(settings.interface, find_interface(settings.interface));
    if (settings.is_open_to_all())
      return add("thread: interface", Health::warning,
                 "every network of this host can reach MQTT-SN (mqttsn.interface is \"*\"), and "
                 "any host there can act as any robot",
                 "\"auto\" serves Thread and loopback only, \"wpan0\" that interface only");
    if (!settings.is_auto() || !settings.listens_widely()) return;
    for (const InterfaceFacts& each : facts_.interfaces) {
      if (mqttsn::is_thread_interface(each.name)) thread_interface(each.name, &each);
    }
    if (!has_thread())
      add("thread: interface", Health::well,
          "there is no Thread interface (wpan*), so all networks are served until there is one");
  }

  bool has_thread() const {
    return std::ranges::any_of(facts_.interfaces, [](const InterfaceFacts& each) {
      return mqttsn::is_thread_interface(each.name);
    });
  }

  /// Returns whether robots are expected there; with `auto`, robots do not search over loopback.
  bool is_for_robots(const std::string& interface) const {
    const mqttsn::Settings& settings = config_.mqttsn;
    if (settings.names_interface()) return interface == settings.interface;
    return !settings.is_auto() || !has_thread() || mqttsn::is_thread_interface(interface);
  }

  void thread_interface(const std::string& name, const InterfaceFacts* interface) {
    const char* const remedy =
        "systemctl status otbr-agent; sudo ot-ctl state (leader, router or child when it is "
        "attached)";
    if (!interface)
      return add("thread: interface", Health::problem, "there is no interface " + name, remedy);
    if (!interface->is_up)
      return add("thread: interface", Health::problem, name + " is down", remedy);
    const auto is_routable = [](const std::string& a) { return !a.starts_with("fe80"); };
    const auto address =
        std::find_if(interface->addresses.begin(), interface->addresses.end(), is_routable);
    if (address == interface->addresses.end())
      return add("thread: interface", Health::problem,
                 name + " has no address that robots of the mesh can reach", remedy);
    add("thread: interface", Health::well, name + " is up, " + *address);
  }

  void multicast() {
    const std::string& group = *config_.mqttsn.multicast_group;
    for (const InterfaceFacts& interface : facts_.interfaces) {
      const auto& groups = interface.multicast_groups;
      if (is_for_robots(interface.name) &&
          std::find(groups.begin(), groups.end(), group) != groups.end())
        return add("thread: multicast", Health::well,
                   fmt::format("{} is joined on {}", group, interface.name));
    }
    add("thread: multicast", Health::problem,
        fmt::format("{} is joined on no interface: robots that search find no gateway", group),
        "ip maddress; mqttsn.interface and mqttsn.multicast_group");
  }

  void search() {
    if (*facts_.is_search_answered)
      return add("thread: search", Health::well, "a search of our own was answered");
    if (facts_.status.is_null())
      return add("thread: search", Health::unknown, "a search of our own was not answered");
    const bool is_broker_up = is_broker_there(text_at(group_at(facts_.status, "broker"), "state"));
    add("thread: search", is_broker_up ? Health::problem : Health::warning,
        is_broker_up ? "a search of our own was not answered"
                     : "searches are not answered while the broker is away",
        is_broker_up ? "a firewall? sudo nft list ruleset; sudo ss -ulpn 'sport = :47193'" : "");
  }

  void ble() {
    if (!config_.ble_mesh.enabled)
      return add("ble", Health::well, "not enabled (ble_mesh.enabled)");
    const bool is_bluez = config_.ble_mesh.radio == ble::RadioChoice::bluez;
    if (is_bluez) bluetooth();
    link("ble", is_bluez ? "ble: bluetooth" : "ble: board");
    const json& mesh = group_at(group_at(facts_.status, "meshes"), "ble");
    const json& counters = group_at(mesh, "counters");
    if (count_at(counters, "mostly_deaf") > 0)
      add("ble: robots", Health::problem,
          fmt::format("{} do not hear the gateway: they repeat what it has acknowledged",
                      count_at(counters, "robots_deaf")),
          "switch them off and on, or wait until the gateway's sequence numbers have passed those "
          "that they remember");
    if (count_at(counters, "key_refresh_missing") > 0)
      add("ble: keys", Health::warning,
          "the refresh of the mesh's keys waits for " +
              counted(count_at(counters, "key_refresh_missing"), "robot", "robots"),
          "slam-gatewayctl ble refresh-keys --status names them: switch them on, or leave them "
          "behind");
  }

  /// Reports the first fault only, because the later ones follow from it.
  void bluetooth() {
    const BluetoothFacts& facts = facts_.bluetooth;
    const std::string& controller = config_.ble_mesh.controller;
    const auto problem = [this](std::string detail, std::string remedy) {
      add("ble: controller", Health::problem, std::move(detail), std::move(remedy));
    };
    if (!facts.has_controller)
      return problem("there is no Bluetooth controller " + controller,
                     "ls /sys/class/bluetooth; another one: ble_mesh.controller; dmesg | grep -i "
                     "bluetooth");
    if (facts.is_blocked)
      return problem(controller + " is blocked by rfkill", "sudo rfkill unblock bluetooth");
    if (facts.meshd_version.empty())
      return problem("bluetooth-meshd is not installed", "sudo apt install bluez-meshd");
    if (!is_meshd_new_enough(facts.meshd_version))
      return problem(fmt::format("bluez-meshd {} does not settle on a controller; 5.82 does",
                                 facts.meshd_version),
                     "Debian 13 has 5.82; or a serial board: ble_mesh.radio \"nordic\"");
    if (facts.is_bluetoothd_active)
      return problem("bluetooth.service holds " + controller + ", which meshd needs for itself",
                     "sudo systemctl mask --now bluetooth; sudo systemctl restart bluetooth-mesh");
    if (facts.meshd_command.find("generic:" + controller) == std::string::npos)
      return problem("bluetooth-mesh.service does not start meshd with --io generic:" + controller,
                     bluez_page + ", \"Set it up\"");
    if (!facts.is_meshd_active)
      return problem("bluetooth-mesh.service does not run",
                     "sudo systemctl enable --now bluetooth-mesh; journalctl -u bluetooth-mesh");
    add("ble: controller", Health::well,
        fmt::format("bluetooth-meshd {} has {}", facts.meshd_version, controller));
  }

  /// Version 5.66 opens its controller again and again on Linux 6.1 and 6.12; versions between 5.66
  /// and 5.82 were not tried.
  static bool is_meshd_new_enough(const std::string& version) {
    constexpr std::pair least{5, 82};
    std::pair<int, int> found;
    char dot = 0;
    std::istringstream(version) >> found.first >> dot >> found.second;
    return found >= least;
  }

  void link(const char* mesh, const std::string& step) {
    if (facts_.status.is_null()) return add(step, Health::unknown, "the daemon does not answer");
    const json& facts = group_at(group_at(facts_.status, "meshes"), mesh);
    const std::string state = text_at(facts, "state");
    const std::string detail = text_at(facts, "detail");
    if (state == "up") return add(step, Health::well, detail);
    if (state == "disabled")
      return add(step, Health::warning, "enabled in the configuration, but not in the daemon",
                 "sudo systemctl restart slam-gateway");
    add(step, Health::problem, detail, "/usr/share/doc/slam-gateway/troubleshooting.md");
  }

  void broker() {
    if (facts_.status.is_null()) return;
    const json& broker = group_at(facts_.status, "broker");
    const std::string state = text_at(broker, "state");
    const std::string uri = text_at(broker, "uri");
    const std::string why = text_at(broker, "why");
    if (state == "up") {
      add("broker", Health::well, uri + " is connected");
    } else {
      add("broker", state == "down" ? Health::problem : Health::warning,
          fmt::format("{} is {}: {}", uri, state, why), broker_remedy(state, why));
    }
  }

  static std::string broker_remedy(const std::string& state, const std::string& why) {
    if (state == "refusing")
      return "the broker's access control list: /usr/share/doc/slam-gateway/broker.md";
    if (why.find("Connection refused") != why.npos)
      return "on the broker's host: systemctl status mosquitto; without a `listener` line it "
             "serves localhost only: /usr/share/doc/slam-gateway/broker.md";
    return "/usr/share/doc/slam-gateway/troubleshooting.md, broker.md";
  }

  void rights() {
    for (const json& right : list_at(group_at(facts_.status, "broker"), "missing_rights"))
      add("broker: rights", Health::problem, text_at(right, "what"),
          "in the broker's access control list: " + text_at(right, "grant"));
  }

  bool is_broker_local() const {
    const std::string& host = config_.broker.host;
    return host == "localhost" || host.starts_with("127.") || host == facts_.host_name ||
           std::ranges::any_of(facts_.interfaces, [&host](const InterfaceFacts& interface) {
             return std::ranges::find(interface.addresses, host) != interface.addresses.end();
           });
  }

  /// Reports limits of the broker, if it runs on this host and can be recognised.
  void engine() {
    if (facts_.status.is_null() || !is_broker_local()) return;
    if (facts_.brokers.has_ejabberd) {
      const bool has_others = !config_.broker.others.empty();
      add("broker: ejabberd", has_others ? Health::problem : Health::well,
          "a cluster refuses a robot's client id for good once it has moved between nodes; one "
          "node works",
          "one node, or a cluster of RabbitMQ or NATS: " + broker_page);
    }
    if (facts_.brokers.mosquitto_files && !facts_.brokers.has_others)
      mosquitto(*facts_.brokers.mosquitto_files);
  }

  void mosquitto(std::uint64_t files) {
    constexpr std::uint64_t own_files = 10;  // of Mosquitto 2.0.11 with one listener
    const std::uint64_t room = files - std::min(files, own_files);
    const std::uint64_t robots = count_at(group_at(facts_.status, "robots"), "known");
    const bool is_roomy = robots < room / 2;
    const Health health = is_roomy        ? Health::well
                          : robots < room ? Health::warning
                                          : Health::problem;
    add("broker: files", health,
        fmt::format("Mosquitto may open {} files, room for {} connections; each robot has one, {} "
                    "are known",
                    files, room, robots),
        fmt::format("for more: sudo systemctl edit mosquitto, with the lines [Service] and "
                    "LimitNOFILE={}; then restart it",
                    std::max<std::uint64_t>(65536, 4 * robots)));
  }

  /// This gateway is the first row (FleetMember::status). Without a broker all gateways are gone.
  void fleet() {
    if (text_at(group_at(facts_.status, "broker"), "state") == "down") return;
    const json& rows = list_at(facts_.fleet, "gateways");
    std::string members;
    for (const json& row : rows) {
      const std::string name = text_at(row, "gateway");
      const std::string state = text_at(row, "state");
      if (&row == &rows.front()) continue;
      if (state == "member") members += (members.empty() ? "" : ", ") + name;
      if (state == "gone")
        add("fleet", Health::warning, name + " has gone: others answer for its robots",
            "on its host: systemctl status slam-gateway; gone for good: "
            "/usr/share/doc/slam-gateway/fleet.md");
    }
    if (!members.empty())
      add("fleet", Health::well, "shares the broker with " + members);
    else if (rows.size() == 1)
      add("fleet", Health::well, "no other gateway is on this broker");
  }

  void store() {
    if (facts_.status.is_null()) return;
    const json& store = group_at(facts_.status, "store");
    const std::string state = text_at(store, "state");
    const json& most = group_at(store, "largest");
    const std::string filled_by = text_at(group_at(store, "filled_by"), "robot");
    if (is_true(store, "full"))
      add("store", Health::problem,
          (filled_by.empty() ? "is full: robots are not acknowledged"
                             : "is full or nearly so: robots are not acknowledged, at first only "
                               "those that have stored much") +
              (most.empty() ? "" : "; most of it by " + text_at(most, "robot")),
          "bring the broker back, or raise store.max_bytes");
    else if (state == "failing" || state == "absent")
      add("store", Health::problem, fmt::format("{}: {}", state, text_at(store, "why")),
          "/usr/share/doc/slam-gateway/troubleshooting.md");
    else
      add("store", Health::well,
          counted(count_at(store, "depth"), "message waits", "messages wait"));
    if (!filled_by.empty() && !is_true(store, "full"))
      add("store: nearly full", Health::warning, filled_by + " fills it; others still find room",
          "bring the broker back, and look why the robot sends so much");
    if (const auto lost = count_at(group_at(facts_.status, "messages"), "lost"); lost > 0)
      add("store: lost messages", Health::problem,
          counted(lost, "stored message was", "stored messages were") +
              " lost to damage since the start",
          "journalctl -u slam-gateway | grep lost; look at the disk: sudo dmesg | tail");
    const bool have_little_room = is_true(store, "dead_letters_nearly_full");
    if (const std::uint64_t dead = count_at(store, "dead_letters"); dead > 0)
      add("store: dead letters", have_little_room ? Health::problem : Health::warning,
          counted(dead, "message", "messages") + " that the broker would not take" +
              (have_little_room
                   ? "; there is nearly no room for more: on topics that the broker refuses, "
                     "robots that send much are not acknowledged" +
                         (most.empty() ? "" : "; " + text_at(most, "robot") + " has stored most")
                   : ""),
          "slam-gatewayctl store list; those of a topic go up by themselves once the broker takes "
          "it, "
          "others with store resend, or not at all with store discard");
  }

  void robots() {
    if (facts_.status.is_null()) return;
    const json& robots = group_at(facts_.status, "robots");
    const std::uint64_t offline = count_at(robots, "offline");
    add("robots", offline > 0 ? Health::warning : Health::well,
        fmt::format("{} online, {} asleep, {} offline", count_at(robots, "online"),
                    count_at(robots, "asleep"), offline),
        "slam-gatewayctl robots; slam-gatewayctl doctor ROBOT");
    if (const std::uint64_t contested = count_at(robots, "contested"); contested > 0)
      add("robots: contested", Health::problem,
          "another client uses " + counted(contested, "robot's name", "robots' names"),
          "slam-gatewayctl robots names them: are there two robots of one name? who may connect "
          "with their client ids: /usr/share/doc/slam-gateway/security.md");
  }

  /// Checks that the broker keeps a session for each robot: commands come over this session.
  void sessions() {
    const json& counters = group_at(facts_.status, "fleet");
    const json& robots = group_at(facts_.status, "robots");
    if (text_at(group_at(facts_.status, "broker"), "state") != "up") return;
    if (!counters.contains("sessions")) return;
    const std::uint64_t here = count_at(robots, "online") + count_at(robots, "asleep");
    const std::uint64_t held = count_at(counters, "sessions");
    // Thread clients that have not shown that they receive get no session before their first
    // command.
    const json& thread =
        group_at(group_at(group_at(facts_.status, "meshes"), "thread"), "counters");
    if (held + count_at(thread, "clients_unanswered") >= here)
      return add("robots: sessions", Health::well,
                 counted(held, "is", "are") + " held at the broker");
    const std::string& prefix = config_.topics.prefix;
    std::string root = prefix;
    std::ranges::replace(root, '/', '-');
    add("robots: sessions", Health::problem,
        fmt::format("the broker gives this gateway {} for {}: commands do not reach the others",
                    held, counted(here, "robot", "robots")),
        fmt::format("look again in 10 s; journalctl -u slam-gateway -p warning; at the broker: who "
                    "may use client ids {}-robot-<id>, topic readwrite {}/fleet/robots/#, its "
                    "limits of connections and open files",
                    root, prefix));
  }

  const HostFacts& facts_;
  const Config& config_;
  std::vector<Finding> findings_;
};

std::string addresses_of(const RobotName& robot) {
  std::string text;
  if (robot.ble_address) text = fmt::format("ble 0x{:04x}", *robot.ble_address);
  if (robot.mqttsn_client_id)
    text +=
        (text.empty() ? "" : ", ") + fmt::format("MQTT-SN client id '{}'", *robot.mqttsn_client_id);
  return text;
}

/// The row whose `key` is that robot; null when there is none.
const json* row_of(const json& rows, const char* key, const std::string& robot) {
  const auto row = std::find_if(rows.begin(), rows.end(),
                                [&](const json& other) { return string_at(other, key) == robot; });
  return row == rows.end() ? nullptr : &*row;
}

Finding node_finding(const json& node) {
  const std::string state = text_at(node, "state");
  const std::string problem = text_at(node, "problem");
  const std::string where = "has address " + text_at(node, "address") + " in the mesh";
  if (state == "configured" && problem.empty())
    return {"ble: node", Health::well, where + " and is configured", {}};
  const char* const missing = state == "configured"    ? ""
                              : state == "provisioned" ? ", but is not configured"
                                                       : ", but did not finish joining";
  return {"ble: node", Health::warning, where + missing + (problem.empty() ? "" : ": " + problem),
          fmt::format("switch it on and bring it near; if that does not help: slam-gatewayctl ble "
                      "remove {} --force, and let it join again",
                      text_at(node, "robot"))};
}

// ---- facts about this host

constexpr int search_attempts = 3;
constexpr std::array<std::uint8_t, 3> searchgw{0x03, 0x01, 0x00};  // MQTT-SN 1.2 section 5.4.2
constexpr std::uint8_t gwinfo_type = 0x02;

/// Returns the output of `ip -j WORD`.
json ip_output(const char* word) {
  const ProgramResult shown = run_program({"ip", "-j", word});
  const auto list = json::parse(shown.output, nullptr, false);
  return shown.status == 0 && list.is_array() ? list : json::array();
}

std::vector<InterfaceFacts> read_interfaces() {
  std::map<std::string, InterfaceFacts> interfaces;
  for (const json& row : ip_output("address")) {
    InterfaceFacts& facts = interfaces[text_at(row, "ifname")];
    facts.name = text_at(row, "ifname");
    for (const json& flag : list_at(row, "flags")) facts.is_up |= flag == "UP";
    for (const json& address : list_at(row, "addr_info"))
      facts.addresses.push_back(text_at(address, "local"));
  }
  for (const json& row : ip_output("maddress"))
    for (const json& group : list_at(row, "maddr"))
      interfaces[text_at(row, "ifname")].multicast_groups.push_back(text_at(group, "address"));
  std::vector<InterfaceFacts> result;
  for (auto& [name, facts] : interfaces) result.push_back(std::move(facts));
  return result;
}

/// Reads the soft limit in `/proc/<process>/limits`: "Max open files   soft   hard   files".
std::optional<std::uint64_t> open_file_limit(const fs::path& process) {
  constexpr std::string_view title = "Max open files";
  std::ifstream file(process / "limits");
  for (std::string line; std::getline(file, line);) {
    if (!line.starts_with(title)) continue;
    std::uint64_t soft = 0;
    if (std::istringstream(line.substr(title.size())) >> soft) return soft;
  }
  return std::nullopt;
}

LocalBrokers find_brokers() {
  LocalBrokers brokers;
  std::error_code error;
  for (fs::directory_iterator entry("/proc", error), end; entry != end; entry.increment(error)) {
    std::ifstream file(entry->path() / "comm");
    std::string name;
    if (!std::getline(file, name)) continue;
    if (name == "mosquitto") {
      const auto files = open_file_limit(entry->path());
      if (files)
        brokers.mosquitto_files = std::min(*files, brokers.mosquitto_files.value_or(*files));
    }
    const bool is_erlang = name == "beam.smp";
    if (is_erlang || name == "nats-server") brokers.has_others = true;
    if (!is_erlang) continue;
    std::ifstream arguments(entry->path() / "cmdline");
    std::string text;
    std::getline(arguments, text);
    if (text.find("ejabberd") != text.npos) brokers.has_ejabberd = true;
  }
  return brokers;
}

std::string first_line(const std::vector<std::string>& command) {
  const ProgramResult shown = run_program(command);
  return shown.status == 0 ? shown.output.substr(0, shown.output.find('\n')) : "";
}

BluetoothFacts look_at_bluetooth(const std::string& controller) {
  BluetoothFacts facts;
  const fs::path device = fs::path("/sys/class/bluetooth") / controller;
  std::error_code error;
  facts.has_controller = fs::exists(device, error);
  for (fs::directory_iterator entry(device, error), end; entry != end; entry.increment(error)) {
    if (!entry->path().filename().string().starts_with("rfkill")) continue;
    for (const char* kind : {"soft", "hard"}) {
      std::ifstream file(entry->path() / kind);
      facts.is_blocked |= file.get() == '1';
    }
  }
  facts.meshd_version = first_line({"dpkg-query", "-W", "-f", "${Version}", "bluez-meshd"});
  const auto is_active = [](const char* unit) {
    return first_line({"systemctl", "is-active", unit}) == "active";
  };
  facts.is_bluetoothd_active = is_active("bluetooth");
  facts.is_meshd_active = is_active("bluetooth-mesh");
  facts.meshd_command = first_line({"systemctl", "show", "-P", "ExecStart", "bluetooth-mesh"});
  return facts;
}

/// Parses an entry of `mqttsn.listen`: ADDRESS:PORT or [ADDRESS]:PORT.
udp::endpoint endpoint_of(const std::string& listen) {
  const auto [host, port] = listen_parts(listen);
  boost::system::error_code error;
  return {boost::asio::ip::make_address(host, error), port};
}

/// Searches for the gateway over loopback, at the first entry for all interfaces.
std::optional<bool> search(const mqttsn::Settings& settings) {
  const auto listen = std::ranges::find_if(
      settings.listen, [](const std::string& each) { return each.starts_with("[::]:"); });
  if (!settings.enabled || settings.names_interface() || listen == settings.listen.end())
    return std::nullopt;
  boost::asio::io_context io;
  boost::system::error_code error;
  udp::socket socket(io);
  if (socket.open(udp::v6(), error)) return std::nullopt;
  const timeval second{1, 0};
  setsockopt(socket.native_handle(), SOL_SOCKET, SO_RCVTIMEO, &second, sizeof second);
  for (int i = 0; i < search_attempts; ++i) {
    const udp::endpoint target(boost::asio::ip::address_v6::loopback(),
                               endpoint_of(*listen).port());
    socket.send_to(boost::asio::buffer(searchgw), target, 0, error);
    std::array<std::uint8_t, 64> answer{};
    const ssize_t size = recv(socket.native_handle(), answer.data(), answer.size(), 0);
    if (size >= 3 && answer[1] == gwinfo_type) return true;
  }
  return false;
}

/// Returns the first port of these entries of `mqttsn.listen` that another program uses.
std::optional<std::uint16_t> taken_port(std::span<const std::string> entries) {
  boost::asio::io_context io;
  for (const std::string& listen : entries) {
    const udp::endpoint endpoint = endpoint_of(listen);
    boost::system::error_code error;
    udp::socket socket(io);
    if (socket.open(endpoint.protocol(), error) || !socket.bind(endpoint, error)) continue;
    if (error == boost::asio::error::address_in_use) return endpoint.port();
  }
  return std::nullopt;
}

/// Returns how many of the service's UDP sockets systemd keeps open between two starts
/// (FileDescriptorStoreMax=): those of the first entries of `mqttsn.listen`.
std::size_t count_kept_sockets() {
  return parse_number<std::size_t>(
             first_line({"systemctl", "show", "-P", "NFileDescriptorStore", service_unit}))
      .value_or(0);
}

/// Returns the first of the journal's JSON entries as `time: text`; empty when there is none.
std::string dated_line(const std::string& text) {
  const auto entry = nlohmann::json::parse(text.substr(0, text.find('\n')), nullptr, false);
  const std::string message = text_at(entry, "MESSAGE");
  return message.empty() ? "" : to_iso8601(time_of_entry(entry)) + ": " + message;
}

std::optional<bool> clock_state() {
  const std::string line = first_line({"timedatectl", "show", "-p", "NTPSynchronized", "--value"});
  return line.empty() ? std::nullopt : std::optional(line == "yes");
}

}  // namespace

std::vector<Finding> examine(const HostFacts& facts) { return Examination(facts).run(); }

std::vector<Finding> examine_robot(const std::string& robot, const RobotFacts& facts,
                                   const ParseResult& configuration) {
  const auto& named = configuration.config.robots;
  const auto configured = std::find_if(named.begin(), named.end(),
                                       [&](const RobotName& name) { return name.id == robot; });
  const std::string journal = "journalctl -u slam-gateway ROBOT_ID=" + shell_word(robot);
  std::vector<Finding> findings;
  const auto add = [&](const char* step, Health health, std::string detail,
                       std::string remedy = {}) {
    findings.push_back({step, health, std::move(detail), std::move(remedy)});
  };
  if (configured != named.end())
    add("configuration", Health::well, "is " + addresses_of(*configured));
  const Bans bans(configuration.config.bans);
  if (RobotNames(named, bans).is_banned(robot)) {
    const bool is_by_id = bans.has(robot) || configured == named.end();
    add("ban", Health::warning, "is banned, so the gateway does not hear it",
        "sudo slam-gatewayctl unban " +
            shell_word(is_by_id ? robot : configured->mqttsn_client_id.value_or(robot)));
  }
  if (const json* node = row_of(facts.nodes, "robot", robot))
    findings.push_back(node_finding(*node));
  if (!facts.refusal.empty()) add("refused", Health::warning, facts.refusal, journal);
  const json* const row = row_of(facts.robots, "id", robot);
  const json* const elsewhere = row_of(facts.fleet_robots, "robot", robot);
  if (row == nullptr && elsewhere != nullptr) {
    add("fleet", Health::well,
        fmt::format("is served by gateway {}; on its host: slam-gatewayctl doctor {}",
                    text_at(*elsewhere, "gateway"), shell_word(robot)));
    return findings;
  }
  if (row == nullptr) {
    add("heard", Health::problem,
        fmt::format("no robot '{}' was heard since the daemon started, on either mesh", robot),
        configured == named.end()
            ? "slam-gatewayctl robots lists who was; a robot's id is its MQTT-SN client id, "
              "ble-<address>, or what `robots` in the configuration says"
            : "is it switched on, in reach, provisioned (slam-gatewayctl ble nodes), and is its "
              "address or client id as above?");
    return findings;
  }
  const std::string state = text_at(*row, "state");
  const std::string why = text_at(*row, "why");
  const std::string type = text_at(*row, "last_type");
  add("heard", Health::well,
      fmt::format("last at {} on {} from {}{}", text_at(*row, "last_seen"), text_at(*row, "mesh"),
                  text_at(*row, "address"),
                  type.empty() ? "" : "; its last message was of type " + type));
  add("state", why.empty() ? Health::well : Health::problem,
      state + " since " + text_at(*row, "since") + (why.empty() ? "" : ": " + why),
      why.empty()                  ? ""
      : is_true(*row, "contested") ? journal + "; /usr/share/doc/slam-gateway/security.md"
                                   : journal);
  const std::string refused = elsewhere ? text_at(*elsewhere, "refused") : "";
  if (!refused.empty())
    add("commands", Health::problem,
        fmt::format("the broker refuses {}: commands may not reach the robot", refused),
        "the broker's access control list may lack it, or its log says why: " + broker_page);
  add("traffic", Health::well,
      fmt::format("{} up, {} down, {} for it",
                  counted(count_at(*row, "messages"), "message", "messages"),
                  counted(count_at(*row, "commands"), "command", "commands"),
                  counted(count_at(*row, "queue"), "waits", "wait")));
  return findings;
}

json to_json(const std::vector<Finding>& findings) {
  json list = json::array();
  for (const Finding& finding : findings)
    list.push_back({{"step", finding.step},
                    {"health", to_string(finding.health)},
                    {"detail", finding.detail},
                    {"remedy", finding.remedy}});
  return list;
}

std::string to_text(const std::vector<Finding>& findings) {
  std::string text;
  for (const json& finding : to_json(findings)) {
    text += fmt::format("{:<8} {}: {}\n", text_at(finding, "health"), text_at(finding, "step"),
                        text_at(finding, "detail"));
    if (const std::string remedy = text_at(finding, "remedy"); !remedy.empty())
      text += fmt::format("{:<8} -> {}\n", "", remedy);
  }
  return text;
}

bool has_problem(const std::vector<Finding>& findings) {
  return std::any_of(findings.begin(), findings.end(),
                     [](const Finding& finding) { return finding.health == Health::problem; });
}

HostFacts gather_facts(const Installation& installation, const std::string& socket) {
  HostFacts facts;
  facts.configuration = installation.parsed();
  for (const NamedFile& file : named_files(facts.configuration.config))
    if (access(file.path.c_str(), R_OK) != 0 && errno == EACCES) facts.closed_keys.insert(file.key);
  facts.own_version = SLAMGW_VERSION;
  try {
    Connection connection(socket);
    facts.status = connection.ask({{"command", "status"}});
    facts.fleet = connection.ask({{"command", "fleet"}});
  } catch (const NotRunning& failure) {
    facts.is_running = false;
    facts.status_failure = failure.what();
  } catch (const Silence& failure) {
    facts.is_silent = true;
    facts.status_failure = failure.what();
  } catch (const Failure& failure) {
    facts.status_failure = failure.what();
  }
  facts.interfaces = read_interfaces();
  std::array<char, 256> name{};  // POSIX's longest host name and a NUL
  if (gethostname(name.data(), name.size() - 1) == 0) facts.host_name = name.data();
  facts.brokers = find_brokers();
  const ble::Settings& ble = installation.parsed().config.ble_mesh;
  if (ble.enabled && ble.radio == ble::RadioChoice::bluez)
    facts.bluetooth = look_at_bluetooth(ble.controller);
  const mqttsn::Settings& mqttsn = installation.parsed().config.mqttsn;
  if (facts.is_running) {
    facts.is_search_answered = search(mqttsn);
  } else if (mqttsn.enabled) {
    const std::size_t kept = installation.is_service() ? count_kept_sockets() : 0;
    const std::span<const std::string> entries(mqttsn.listen);
    facts.taken_port = taken_port(entries.subspan(std::min(kept, entries.size())));
  }
  facts.is_clock_synchronised = clock_state();
  std::error_code error;
  const fs::space_info space = fs::space(installation.state(), error);
  if (!error) facts.state_free_bytes = space.available;
  return facts;
}

RobotFacts gather_robot_facts(const std::string& robot, Connection& daemon) {
  RobotFacts facts;
  facts.robots = daemon.ask({{"command", "robots"}});
  const auto fleet = daemon.ask({{"command", "fleet"}});
  if (const auto rows = fleet.find("robots"); rows != fleet.end()) facts.fleet_robots = *rows;
  try {
    facts.nodes = daemon.ask({{"command", "ble nodes"}});
  } catch (const Failure&) {  // without a BLE mesh there are no nodes
  }
  const ProgramResult lines =
      run_program({"journalctl", "-q", "--no-pager", "-u", "slam-gateway", "--since", "-1d", "-n",
                   "1", "-o", "json", "-g", "may not |refuse", "ROBOT_ID=" + robot});
  if (lines.status == 0) facts.refusal = dated_line(lines.output);
  return facts;
}

}  // namespace slamgw::ctl
