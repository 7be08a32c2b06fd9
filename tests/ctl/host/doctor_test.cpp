// SPDX-License-Identifier: Apache-2.0
// Findings of `slam-gatewayctl doctor` from given facts of a host.
#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "ctl/host/archives.hpp"
#include "ctl/host/doctor.hpp"
#include "ctl/show.hpp"

namespace slamgw::ctl {
namespace {

using nlohmann::json;

HostFacts healthy() {
  HostFacts facts;
  facts.own_version = "1.0";
  facts.status = {{"version", "1.0"},
                  {"uptime_s", 60},
                  {"broker", {{"state", "up"}, {"uri", "mqtt://h:1883"}, {"why", ""}}},
                  {"meshes", {{"thread", {{"state", "up"}, {"detail", "UDP [::]:47193"}}}}},
                  {"robots", {{"online", 2}, {"asleep", 0}, {"offline", 0}}},
                  {"store", {{"state", "working"}, {"depth", 0}, {"full", false}}}};
  facts.interfaces = {{"wpan0", true, {"fe80::1", "fd00::1"}, {"ff02::1", "ff03::1"}}};
  facts.is_search_answered = true;
  facts.is_clock_synchronised = true;
  facts.state_free_bytes = std::uint64_t{1} << 30;
  return facts;
}

std::string problems_of(const HostFacts& facts) {
  std::string steps;
  for (const Finding& finding : examine(facts)) {
    if (finding.health == Health::well) {
      EXPECT_EQ(finding.remedy, "") << finding.step;
      continue;
    }
    steps += finding.step + "; ";
    EXPECT_FALSE(finding.detail.empty()) << finding.step;
    if (finding.health == Health::problem) {
      EXPECT_FALSE(finding.remedy.empty()) << finding.step;
    }
  }
  return steps;
}

TEST(Doctor, FindsNoProblemOnHealthyHost) {
  EXPECT_EQ(problems_of(healthy()), "");
  EXPECT_FALSE(has_problem(examine(healthy())));
}

TEST(Doctor, NamesObstacleBetweenMeshdAndController) {
  HostFacts facts = healthy();
  facts.configuration.config.ble_mesh.enabled = true;
  facts.configuration.config.ble_mesh.radio = ble::RadioChoice::bluez;
  facts.status["meshes"]["ble"] = {{"state", "up"}, {"detail", "bluetooth-meshd"}};
  const BluetoothFacts good{.has_controller = true,
                            .is_blocked = false,
                            .meshd_version = "5.82-1.1",
                            .is_bluetoothd_active = false,
                            .is_meshd_active = true,
                            .meshd_command = "{ argv[]=bluetooth-meshd --io generic:hci0 ; }"};
  facts.bluetooth = good;
  EXPECT_EQ(problems_of(facts), "");
  const auto remedy_when = [&](auto change) {
    facts.bluetooth = good;
    change(facts.bluetooth);
    EXPECT_EQ(problems_of(facts), "ble: controller; ");
    for (const Finding& finding : examine(facts))
      if (finding.health == Health::problem) return finding.remedy;
    return std::string();
  };
  const auto says = [&](const char* words, auto change) {
    EXPECT_NE(remedy_when(change).find(words), std::string::npos) << words;
  };
  says("ls /sys/class/bluetooth", [](auto& bluetooth) { bluetooth.has_controller = false; });
  says("rfkill unblock", [](auto& bluetooth) { bluetooth.is_blocked = true; });
  says("apt install", [](auto& bluetooth) { bluetooth.meshd_version.clear(); });
  says("Debian 13", [](auto& bluetooth) { bluetooth.meshd_version = "5.66-1+deb12u2"; });
  says("mask --now bluetooth", [](auto& bluetooth) { bluetooth.is_bluetoothd_active = true; });
  says("bluez.md", [](auto& bluetooth) { bluetooth.meshd_command = "bluetooth-meshd"; });
  says("enable --now", [](auto& bluetooth) { bluetooth.is_meshd_active = false; });
}

TEST(Doctor, ReportsNodeWithoutThreadNetwork) {
  HostFacts facts = healthy();
  json& role = facts.status["meshes"]["thread"]["role"] = "router";
  EXPECT_EQ(problems_of(facts), "");
  for (const char* const without : {"detached", "disabled"}) {
    role = without;
    EXPECT_EQ(problems_of(facts), "thread: node; ") << without;
  }
}

TEST(Doctor, RemindsOfServingAllInterfaces) {
  HostFacts facts = healthy();
  facts.configuration.config.mqttsn.interface = "*";
  EXPECT_EQ(problems_of(facts), "thread: interface; ");
  EXPECT_FALSE(has_problem(examine(facts)));
  facts.configuration.config.mqttsn.listen = {"127.0.0.1:47193"};
  EXPECT_EQ(problems_of(facts), "") << "no network reaches it";
}

TEST(Doctor, ChecksOnlyThreadInterfacesWhileOneExists) {
  HostFacts facts = healthy();
  facts.interfaces.push_back({"eth0", true, {"192.0.2.7"}, {"ff02::1", "ff03::1"}});
  facts.interfaces[0].multicast_groups.clear();
  EXPECT_EQ(problems_of(facts), "thread: multicast; ") << "eth0 is not served";
  facts.interfaces[0].is_up = false;
  EXPECT_EQ(problems_of(facts), "thread: interface; thread: multicast; ");
  facts.interfaces.erase(facts.interfaces.begin());
  EXPECT_EQ(problems_of(facts), "") << "without one, all networks are served";
}

TEST(Doctor, NamesRestartOfHangingDaemon) {
  HostFacts facts = healthy();
  facts.status = nullptr;
  facts.status_failure = "slam-gatewayd does not answer at /run/slam-gateway/control.sock";
  facts.is_silent = true;
  facts.is_search_answered = false;
  EXPECT_EQ(problems_of(facts), "daemon; thread; thread: search; ");
  const std::string text = to_text(examine(facts));
  EXPECT_NE(text.find("sudo systemctl restart slam-gateway"), std::string::npos) << text;
  EXPECT_EQ(text.find("slam-gatewayctl doctor"), std::string::npos) << text;
  EXPECT_EQ(text.find("while the broker is away"), std::string::npos) << text;
  facts.is_silent = false;  // the user may lack access to the socket
  EXPECT_NE(to_text(examine(facts)).find("sudo slam-gatewayctl doctor"), std::string::npos);
}

TEST(Doctor, NamesEachBrokenStep) {
  HostFacts facts = healthy();
  facts.status = nullptr;
  facts.status_failure = "slam-gatewayd is not running";
  EXPECT_EQ(problems_of(facts), "daemon; thread; ");
  facts.interfaces.clear();
  facts.is_running = false;
  facts.taken_port = 47193;
  EXPECT_EQ(problems_of(facts), "daemon; thread: port; thread; ")
      << "no other step is judged without a daemon";

  facts = healthy();
  facts.own_version = "1.1";
  EXPECT_EQ(problems_of(facts), "daemon; ");

  facts = healthy();
  facts.configuration.config.mqttsn.interface = "wpan1";
  EXPECT_EQ(problems_of(facts), "thread: interface; ");
  facts.configuration.config.mqttsn.interface = "wpan0";
  EXPECT_EQ(problems_of(facts), "");
  facts.interfaces[0].multicast_groups = {"ff02::1"};
  EXPECT_EQ(problems_of(facts), "thread: multicast; ");
  facts.interfaces[0].addresses = {"fe80::1"};
  EXPECT_EQ(problems_of(facts), "thread: interface; thread: multicast; ");
  facts.interfaces[0].is_up = false;
  EXPECT_EQ(problems_of(facts), "thread: interface; thread: multicast; ");

  facts = healthy();
  facts.is_search_answered = false;
  EXPECT_EQ(problems_of(facts), "thread: search; ");
  facts.status["broker"]["state"] = "refusing";
  EXPECT_NE(to_text(examine(facts)).find("a search of our own was not answered"), std::string::npos)
      << "the gateway is connected";

  facts = healthy();
  facts.status["broker"] = {{"state", "down"}, {"uri", "mqtt://h:1883"}, {"why", "refused"}};
  facts.is_search_answered = false;
  EXPECT_EQ(problems_of(facts), "thread: search; broker; ");

  facts = healthy();
  facts.configuration.config.ble_mesh.enabled = true;
  facts.status["meshes"]["ble"] = {{"state", "down"}, {"detail", "there is no board"}};
  EXPECT_EQ(problems_of(facts), "ble: board; ");
  facts.status["meshes"]["ble"] = {
      {"state", "up"}, {"detail", "board"}, {"counters", {{"robots_deaf", 7}, {"mostly_deaf", 1}}}};
  EXPECT_EQ(problems_of(facts), "ble: robots; ");
  facts.status["meshes"]["ble"]["counters"] = {{"key_refresh_step", 1}, {"key_refresh_missing", 2}};
  EXPECT_EQ(problems_of(facts), "ble: keys; ");
  facts.status["meshes"]["ble"]["counters"]["key_refresh_missing"] = 0;
  EXPECT_EQ(problems_of(facts), "");

  facts = healthy();
  facts.status["meshes"]["thread"]["counters"] = {{"clients", 9000}, {"clients_unanswered", 8000}};
  EXPECT_EQ(problems_of(facts), "thread: clients; ");
  facts.status["meshes"]["thread"]["places"] = {
      {"most", {{"address", "fd00::7"}, {"clients", 8500}}},
      {"most_unproven", {{"address", "fd00::9"}, {"clients", 100}}}};
  EXPECT_EQ(problems_of(facts), "thread: clients; ");
  for (const Finding& finding : examine(facts)) {
    if (finding.health == Health::well) continue;
    EXPECT_NE(finding.remedy.find("ban fd00::7"), std::string::npos)
        << "these clients have answered";
  }
  facts.status["meshes"]["thread"]["places"] = nullptr;
  facts.status["meshes"]["thread"]["counters"]["clients"] = 8999;
  EXPECT_EQ(problems_of(facts), "");
  json& most = facts.status["meshes"]["thread"]["places"]["most_unproven"];
  most = {{"address", "fd00::/64"}, {"clients", 4000}};
  EXPECT_EQ(problems_of(facts), "") << "nothing was sent to these clients yet";
  most["address"] = "fd00::9";
  EXPECT_EQ(problems_of(facts), "thread: clients; ");

  facts = healthy();
  facts.status["retained"] = {
      {"topics", 4000}, {"max", 4096}, {"most", {{"robot", "r1"}, {"topics", 16}}}};
  EXPECT_EQ(problems_of(facts), "retained; ");

  facts = healthy();
  facts.status["store"]["full"] = true;
  facts.state_free_bytes = 1000;
  EXPECT_EQ(problems_of(facts), "disk; store; ");

  facts = healthy();
  facts.status["store"]["filled_by"] = {{"robot", "r1"}, {"bytes", 3}};
  EXPECT_EQ(problems_of(facts), "store: nearly full; ");
  facts.status["store"]["full"] = true;
  EXPECT_EQ(problems_of(facts), "store; ") << "other robots may find no room";
  facts.status["store"]["full"] = false;
  facts.status["store"].erase("filled_by");
  facts.status["messages"]["lost"] = 2;
  EXPECT_EQ(problems_of(facts), "store: lost messages; ");
  facts.status["messages"]["lost"] = 0;
  facts.status["store"]["dead_letters"] = 3;
  facts.status["robots"]["offline"] = 1;
  facts.is_clock_synchronised = false;
  EXPECT_EQ(problems_of(facts), "clock; store: dead letters; robots; ");
  EXPECT_FALSE(has_problem(examine(facts)));
  facts.status["store"]["dead_letters_nearly_full"] = true;
  EXPECT_TRUE(std::ranges::any_of(examine(facts), [](const Finding& finding) {
    return finding.detail.ends_with("robots that send much are not acknowledged");
  })) << "most dead letters are the gateway's own";
  facts.status["store"]["largest"] = {{"robot", "r1"}, {"bytes", 3}};
  EXPECT_TRUE(has_problem(examine(facts))) << "robots are not acknowledged";
}

json fleet_of(std::initializer_list<std::pair<const char*, const char*>> gateways) {
  json rows = json::array();
  for (const auto& [name, state] : gateways) rows.push_back({{"gateway", name}, {"state", state}});
  return {{"gateway", "room-a"}, {"gateways", std::move(rows)}, {"robots", json::array()}};
}

TEST(Doctor, ReportsOtherGateways) {
  HostFacts facts = healthy();
  facts.fleet = fleet_of({{"room-a", "alone"}});
  EXPECT_EQ(problems_of(facts), "");
  EXPECT_NE(to_text(examine(facts)).find("fleet: no other gateway"), std::string::npos);
  facts.fleet = fleet_of({{"room-a", "member"}, {"room-b", "member"}, {"room-c", "member"}});
  EXPECT_EQ(problems_of(facts), "");
  EXPECT_NE(to_text(examine(facts)).find("fleet: shares the broker with room-b, room-c"),
            std::string::npos);
  facts.fleet = fleet_of({{"room-a", "member"}, {"room-b", "gone"}});
  EXPECT_EQ(problems_of(facts), "fleet; ");
  EXPECT_FALSE(has_problem(examine(facts)));
  facts.fleet = fleet_of({{"room-a", "cut off"}, {"room-b", "gone"}});
  facts.status["broker"]["state"] = "down";
  EXPECT_EQ(problems_of(facts), "broker; ") << "the other problems follow from it";
}

TEST(Doctor, ReportsMissingRobotSessionsAndRights) {
  HostFacts facts = healthy();
  facts.configuration.config.topics.prefix = "lab/slam";
  facts.status["fleet"] = {{"sessions", 1}};
  EXPECT_EQ(problems_of(facts), "robots: sessions; ");
  const std::string text = to_text(examine(facts));
  EXPECT_NE(text.find("1 for 2 robots"), text.npos) << text;
  EXPECT_NE(text.find("lab-slam-robot-<id>"), text.npos) << text;
  EXPECT_NE(text.find("topic readwrite lab/slam/fleet/robots/#"), text.npos) << text;
  facts.status["meshes"]["thread"]["counters"]["clients_unanswered"] = 1;
  EXPECT_EQ(problems_of(facts), "") << "such a robot gets its session with its first command";
  facts.status["broker"]["state"] = "down";
  EXPECT_EQ(problems_of(facts), "broker; ") << "without a broker no robot has a session";
  facts = healthy();
  facts.status["fleet"] = {{"sessions", 3}};  // absent robots keep their sessions
  EXPECT_EQ(problems_of(facts), "");
}

TEST(Doctor, NamesDropInThatRaisesMosquittosFileLimit) {
  HostFacts facts = healthy();
  facts.configuration.config.broker.host = "127.0.0.1";
  facts.brokers.mosquitto_files = 1024;
  facts.status["robots"]["known"] = 3;
  EXPECT_EQ(problems_of(facts), "");
  std::string text = to_text(examine(facts));
  EXPECT_NE(text.find("room for 1014 connections; each robot has one, 3 are known"), text.npos)
      << text;
  facts.status["robots"]["known"] = 600;
  EXPECT_EQ(problems_of(facts), "broker: files; ");
  facts.brokers.has_others = true;
  EXPECT_EQ(problems_of(facts), "") << "RabbitMQ may be the broker";
  facts.brokers.has_others = false;
  text = to_text(examine(facts));
  EXPECT_NE(text.find("LimitNOFILE=65536"), text.npos) << text;
  EXPECT_FALSE(has_problem(examine(facts)));
  facts.status["robots"]["known"] = 1014;
  EXPECT_TRUE(has_problem(examine(facts)));
  facts.brokers.mosquitto_files = 65536;
  EXPECT_EQ(problems_of(facts), "");
  EXPECT_EQ(to_text(examine(facts)).find("LimitNOFILE"), std::string::npos);
  facts.brokers.mosquitto_files = 1024;
  facts.configuration.config.broker.host = "broker.example";
  EXPECT_EQ(problems_of(facts), "") << "the broker is elsewhere";
  facts.host_name = "broker.example";
  EXPECT_TRUE(has_problem(examine(facts)));
}

TEST(Doctor, ReportsUnsupportedEjabberdCluster) {
  HostFacts facts = healthy();
  facts.interfaces[0].addresses.emplace_back("192.0.2.1");
  facts.configuration.config.broker.host = "192.0.2.1";
  facts.brokers.has_ejabberd = true;
  EXPECT_EQ(problems_of(facts), "");
  EXPECT_NE(to_text(examine(facts)).find("one node works"), std::string::npos);
  facts.configuration.config.broker.others.push_back({"192.0.2.2", 1883, false});
  EXPECT_EQ(problems_of(facts), "broker: ejabberd; ");
}

TEST(Doctor, ReportsRobotsWhoseNameAnotherClientUses) {
  HostFacts facts = healthy();
  facts.status["robots"]["contested"] = 2;
  EXPECT_EQ(problems_of(facts), "robots: contested; ");
  RobotFacts of_one;
  of_one.robots = {{{"id", "r1"},
                    {"state", "online"},
                    {"contested", true},
                    {"why", "another client uses its name"}}};
  EXPECT_NE(to_text(examine_robot("r1", of_one, {})).find("another client uses its name"),
            std::string::npos);
}

/// Rights of the fleet are among the missing rights (StatusCollector::broker).
TEST(Doctor, NamesLineThatGrantsMissingRight) {
  HostFacts facts = healthy();
  const std::string grant = "topic readwrite p/fleet/#";
  facts.status["broker"]["missing_rights"] = {{{"what", "not heard"}, {"grant", grant}}};
  EXPECT_EQ(problems_of(facts), "broker: rights; ");
  EXPECT_NE(to_text(examine(facts)).find(grant), std::string::npos);
}

TEST(Doctor, SurvivesAnyAnswerOfTheDaemon) {
  HostFacts facts = healthy();
  for (const json& status :
       {json(5), json::array(), json::object(), json("x"),
        json{{"broker", 1}, {"store", {{"full", "x"}}}, {"meshes", {{"thread", 2}}}}}) {
    facts.status = facts.fleet = status;
    EXPECT_FALSE(to_text(examine(facts)).empty());
    facts.fleet = {{"gateways", status}};
    EXPECT_FALSE(to_text(examine(facts)).empty());
  }
  EXPECT_FALSE(examine_robot("r", {json(3), json(4), "x", json(5)}, {}).empty());
}

TEST(Doctor, ShowsStateOfOneRobot) {
  ParseResult configuration;
  configuration.config.robots = {{"r1", 0x100, std::nullopt}};
  RobotFacts facts;
  facts.robots = {{{"id", "r1"},
                   {"mesh", "ble"},
                   {"address", "0x0100"},
                   {"state", "offline"},
                   {"since", "2026-01-01T00:00:00Z"},
                   {"last_seen", "2026-01-01T00:00:00Z"},
                   {"why", "not heard for 30 s"},
                   {"messages", 7}}};
  const std::string text = to_text(examine_robot("r1", facts, configuration));
  EXPECT_NE(text.find("ble 0x0100"), text.npos);
  EXPECT_NE(text.find("offline since 2026-01-01T00:00:00Z: not heard for 30 s"), text.npos);
  EXPECT_NE(text.find("7 messages up"), text.npos);
  EXPECT_TRUE(has_problem(examine_robot("r2", facts, configuration)));
  facts.fleet_robots = {{{"robot", "r2"}, {"gateway", "room-b"}}};
  const auto elsewhere = examine_robot("r2", facts, configuration);
  EXPECT_FALSE(has_problem(elsewhere));
  EXPECT_NE(to_text(elsewhere).find("is served by gateway room-b"), std::string::npos);
}

TEST(Doctor, ReportsSubscriptionOfARobotThatTheBrokerRefuses) {
  RobotFacts facts;
  facts.robots = {{{"id", "r1"}, {"mesh", "thread"}, {"state", "online"}}};
  facts.fleet_robots = {{{"robot", "r1"}, {"gateway", "room-a"}}};
  EXPECT_FALSE(has_problem(examine_robot("r1", facts, {})));
  facts.fleet_robots[0]["refused"] = "the subscription to ntnu-slam/server/r1/+";
  const auto findings = examine_robot("r1", facts, {});
  EXPECT_TRUE(has_problem(findings));
  EXPECT_NE(to_text(findings).find("the broker refuses the subscription to ntnu-slam/server/r1/+"),
            std::string::npos);
}

TEST(Doctor, NamesReasonWhyRobotWasNeverHeard) {
  RobotFacts facts;
  facts.robots = json::array();
  facts.nodes = {{{"robot", "r1"},
                  {"address", "0x0100"},
                  {"state", "provisioned"},
                  {"problem", "it does not answer"}}};
  facts.refusal = "[fd00::1]:9 may not connect as 'r1' (CONNACK 0x03): another robot has this name";
  const std::string text = to_text(examine_robot("r1", facts, {}));
  EXPECT_NE(text.find("has address 0x0100 in the mesh, but is not configured: it does not answer"),
            text.npos)
      << text;
  EXPECT_NE(text.find("slam-gatewayctl ble remove r1 --force"), text.npos);
  EXPECT_NE(text.find("refused: " + facts.refusal), text.npos);
  EXPECT_EQ(text.find("ban:"), text.npos);
  ParseResult banning;
  banning.config.robots = {{"r1", std::nullopt, "NRF_5"}};
  for (const char* const banned : {"r1", "NRF_5"}) {
    banning.config.bans = {banned};
    EXPECT_NE(to_text(examine_robot("r1", facts, banning)).find("ban: is banned"), text.npos);
  }
  facts.nodes[0] = {{"robot", "r1"}, {"address", "0x0100"}, {"state", "configured"}};
  EXPECT_NE(to_text(examine_robot("r1", facts, {})).find("0x0100 in the mesh and is configured"),
            text.npos);
}

TEST(DoctorOfARobot, NamesBanByTheNameThatLiftsIt) {
  RobotName robot;
  robot.id = "r1";
  robot.mqttsn_client_id = "NRF_5";
  ParseResult configuration;
  configuration.config.robots = {robot};
  const auto text = [&] { return to_text(examine_robot("r1", {}, configuration)); };
  EXPECT_EQ(text().find("is banned"), std::string::npos);
  configuration.config.bans = {"NRF_5"};
  EXPECT_NE(text().find("sudo slam-gatewayctl unban NRF_5"), std::string::npos) << text();
  configuration.config.bans = {"r1"};
  EXPECT_NE(text().find("sudo slam-gatewayctl unban r1"), std::string::npos) << text();
}

/// A robot chooses its name, and an operator copies the command.
TEST(DoctorOfARobot, QuotesANameThatAShellWouldRun) {
  ParseResult configuration;
  configuration.config.bans = {"x;reboot"};
  const std::string text = to_text(examine_robot("x;reboot", {}, configuration));
  EXPECT_NE(text.find("sudo slam-gatewayctl unban 'x;reboot'\n"), std::string::npos) << text;
  EXPECT_EQ(shell_word("lego-1_a.b"), "lego-1_a.b");
  EXPECT_EQ(shell_word("it's $(id)"), "'it'\\''s $(id)'");
  EXPECT_EQ(shell_word(""), "''");
}

TEST(Report, HidesSecretsAndKeepsTheRest) {
  const std::string text = without_secrets(R"({// a comment
      "broker": {"uri": "mqtt://h", "credentials_file": "c.json", "password": "hush"},
      "robots": [{"id": "r1", "mqttsn_client_id": "c1"}],
      "ble_mesh": {"ttl": 7, "provisioning": {"static_oob": "00112233445566778899aabbccddeeff"}}})");
  EXPECT_EQ(text.find("hush"), text.npos);
  EXPECT_EQ(text.find("0011"), text.npos);
  for (const char* const shown : {"mqtt://h", "c.json", "r1", "c1", ": 7"})
    EXPECT_NE(text.find(shown), text.npos) << shown << " in " << text;
  EXPECT_EQ(without_secrets("{\"password\": \"hush\"").find("hush"), std::string::npos);
  EXPECT_EQ(without_secrets("\"hush\"").find("hush"), std::string::npos);
}

TEST(Report, HidesSecretsInListsGroupsAndAddresses) {
  const std::string text = without_secrets(R"({
      "broker": {"uri": ["mqtt://h", "mqtts://u:hush@h"]},
      "ble_mesh": {"groups": ["0xc002", "hush"], "provisioning": {"static_oob": null}},
      "token": ["hush", {"viewer": "hush", "role": ["hush"]}]})");
  EXPECT_EQ(text.find("hush"), text.npos) << text;
  EXPECT_NE(text.find("mqtt://h\""), text.npos) << text;
  EXPECT_NE(text.find("0xc002"), text.npos) << text;
  EXPECT_NE(text.find("null"), text.npos) << text;
}

/// Operators send a report when the configuration is broken.
TEST(Report, HidesValuesOfMisspelledKeysAndOfAWrongKind) {
  for (const char* const broken :
       {R"({"broker": {"pasword": "hush"}})", R"({"broker.password": "hush"})",
        R"({"ble_mesh": {"provisioning": {"static_obb": "hush"}}})",
        R"({"ble_mesh": {"net_key": "hush"}})", R"({"r1": "hush"})",
        R"({"mqttsn": {"dtls": {"keys": {"r1": "hush"}}}})",
        R"({"mqttsn": {"dtls": {"keys_file": {"r1": "hush", "hush": 1}}}})",
        R"({"mqttsn": {"dtls": {"keys_file": "{\"r1\": \"hush\"}"}}})",
        R"({"broker": {"tls": {"key_file": "-----BEGIN KEY-----\nhush/\n"}}})",
        R"({"broker": "hush"})", R"({"robots": ["hush"]})", R"({"robots": {"id": "hush"}})",
        R"({"mqttsn": {"listen": "hush"}})", R"({"broker": {"keep_alive_s": "hush"}})",
        R"({"fleet": {"key": "hush"}})"}) {
    const std::string text = without_secrets(broken);
    EXPECT_EQ(text.find("hush"), text.npos) << text;
  }
}

}  // namespace
}  // namespace slamgw::ctl
