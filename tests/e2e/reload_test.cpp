// SPDX-License-Identifier: Apache-2.0
// SIGHUP: settings that take effect at once, settings that need a restart, and files that are
// refused.
#include <gtest/gtest.h>

#include <signal.h>
#include <sys/stat.h>
#include <unistd.h>
#include <algorithm>

#include <algorithm>
#include <set>
#include <thread>

#include "tests/e2e/device.hpp"
#include "tests/e2e/gateway_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;
using sim::sn::Type;

json configuration_for(const Mosquitto& broker) { return {{"broker", {{"uri", broker.uri()}}}}; }

TEST(Reload, RenamesRobotsOnBothMeshesWithoutRestart) {
  Mosquitto broker;
  json configuration = configuration_for(broker);
  configuration["ble_mesh"]["enabled"] = true;
  GatewayProcess gateway(configuration);
  SimulatorProcess board({"ble", "--tty", gateway.tty(), "--robots", "2"});
  SimulatorProcess robots({"thread", "--gateway", gateway.mqttsn_address(), "--robots", "1",
                           "--topic-prefix", "ntnu-slam"});
  ASSERT_TRUE(eventually([&] {
    return gateway.logs("ble-0100 update") && gateway.logs("ble-0101 update") &&
           gateway.logs("robot1 update");
  })) << gateway.log();
  Subscriber named(broker, "ntnu-slam/robot/lego/update");
  Subscriber presence(broker, "ntnu-slam/gateway/test/robots/+", "%t %p");
  const std::size_t before = gateway.log().size();

  gateway.reload([](json& wanted) {
    wanted["robots"] = {{{"id", "lego"}, {"ble_address", "0x0100"}}};
  });

  EXPECT_TRUE(eventually([&] { return !named.lines().empty(); })) << gateway.log();
  const auto says = [&](const std::string& robot, const std::string& state) {
    return eventually([&] {
      for (const std::string& line : presence.lines()) {
        const std::size_t space = line.find(' ');
        const json document = json::parse(line.substr(space + 1), nullptr, false);
        if (line.substr(0, space).ends_with("/" + robot) && document.is_object() &&
            document["state"] == state)
          return true;
      }
      return false;
    });
  };
  EXPECT_TRUE(says("ble-0100", "offline"));
  EXPECT_TRUE(says("lego", "online"));
  const std::string since = gateway.log().substr(before);
  for (const char* disturbance :
       {"only a restart changes", "ble link down", "ble-0101 is offline", "robot1 is offline"})
    EXPECT_EQ(since.find(disturbance), std::string::npos) << since;
  EXPECT_EQ(gateway.ctl({"send", "lego", "cmd", "10,-20"})["outcome"], "delivered");
  EXPECT_EQ(gateway.ctl({"send", "robot1", "cmd", "10,-20"})["outcome"], "delivered");
}

TEST(Reload, BanEndsSessionAndLastsUntilItIsRemoved) {
  Mosquitto broker;
  json configuration = configuration_for(broker);
  configuration["ble_mesh"]["enabled"] = true;
  GatewayProcess gateway(configuration);
  SimulatorProcess board({"ble", "--tty", gateway.tty(), "--robots", "2"});
  const auto ban = [&](const std::string& verb, const std::string& who) {
    return gateway.ctl({verb, "--config", gateway / "gateway.json", who});
  };
  Device evil(gateway.mqttsn_address());
  const auto connect = sim::sn::connect("evil", 60, sim::sn::flag_clean_session);
  EXPECT_EQ(evil.insist(connect, Type::connack).return_code, sim::sn::accepted);

  const auto is_unknown = [](const json& done) {
    return done.value("text", "").find("No robot of this name is known") != std::string::npos;
  };
  const json done = ban("ban", "evil");
  EXPECT_TRUE(done.is_object() && !is_unknown(done)) << gateway.log();
  EXPECT_TRUE(is_unknown(ban("ban", "evl"))) << "the name may be mistyped";
  evil.expect(Type::disconnect);
  evil.send(connect);
  EXPECT_EQ(evil.expect(Type::connack).return_code, 3);
  EXPECT_TRUE(gateway.logs("may not connect as 'evil' (CONNACK 0x03): it is banned"))
      << gateway.log();
  gateway.process().send_signal(SIGTERM);
  EXPECT_EQ(gateway.process().wait(), 0);
  gateway.start();
  EXPECT_EQ(evil.insist(connect, Type::connack).return_code, 3) << "also after a restart";

  EXPECT_TRUE(ban("unban", "evil").is_object());
  EXPECT_TRUE(ban("unban", "evil").is_null()) << "evil is not banned any more";
  EXPECT_EQ(evil.insist(connect, Type::connack).return_code, sim::sn::accepted);
  const json network = ban("ban", "127.0.0.0/8");
  EXPECT_TRUE(network.is_object() && !is_unknown(network));
  evil.expect(Type::disconnect);
  const auto counts = [&] {
    return gateway.ctl({"status"})["meshes"]["thread"]["counters"]["banned"];
  };
  evil.send(connect);
  EXPECT_TRUE(eventually([&] { return counts() == 1; })) << gateway.ctl({"status"});

  ASSERT_TRUE(eventually([&] { return gateway.logs("ble-0100 is online"); })) << gateway.log();
  ban("ban", "ble-0100");
  ban("ban", "evil");
  Subscriber outcomes(broker, "ntnu-slam/gateway/+/commands/+", "%t %p");
  for (const std::string robot : {"ble-0100", "evil"}) {
    mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/" + robot + "/cmd", "-m", "1"});
    EXPECT_TRUE(eventually([&] {
      return std::ranges::any_of(outcomes.lines(), [&](const std::string& line) {
        return line.find("/commands/" + robot) != std::string::npos &&
               line.find("the robot is banned (slam-gatewayctl unban)") != std::string::npos;
      });
    })) << robot;
    const Finished ping =
        run_program({SLAMGW_CTL, "--socket", gateway / "control.sock", "ping", robot});
    EXPECT_EQ(ping.status, 1);
    EXPECT_NE(ping.err.find(robot + " is banned"), std::string::npos) << ping.err;
  }
  for (const json& row : gateway.ctl({"robots"}))
    EXPECT_EQ(row["why"] == "it is banned (slam-gatewayctl unban)", row["id"] != "ble-0101") << row;
  Subscriber other(broker, "ntnu-slam/robot/ble-0101/update", "%t");
  EXPECT_TRUE(eventually([&] { return !other.lines().empty(); }))
      << "messages in flight have arrived";
  Subscriber updates(broker, "ntnu-slam/robot/+/update", "%t");
  EXPECT_TRUE(eventually([&] { return updates.lines().size() > 3; }));
  for (const std::string& topic : updates.lines())
    EXPECT_EQ(topic, "ntnu-slam/robot/ble-0101/update");
}

/// Returns the topics of retained presence that a new subscriber receives.
std::set<std::string> retained_presence(const Mosquitto& broker) {
  Subscriber late(broker, "ntnu-slam/gateway/test/robots/+", "%t");
  eventually([&] { return !late.lines().empty(); });
  const auto topics = late.lines();  // a robot's presence may be published at this moment
  return {topics.begin(), topics.end()};
}

TEST(Reload, KeepsSessionOfThreadRobotUnderItsNewName) {
  Mosquitto broker;
  GatewayProcess gateway(configuration_for(broker));
  Device robot(gateway.mqttsn_address());
  robot.insist(sim::sn::connect("nrf-7", 60, sim::sn::flag_clean_session), sim::sn::Type::connack);
  robot.send(sim::sn::register_topic(1, "ntnu-slam/robot/nrf-7/adv"));
  const std::uint16_t adv = robot.expect(sim::sn::Type::regack).topic_id;
  robot.send(sim::sn::subscribe(1, 2, "ntnu-slam/server/nrf-7/cmd"));
  const std::uint16_t cmd = robot.expect(sim::sn::Type::suback).topic_id;
  ASSERT_TRUE(eventually([&] { return gateway.logs("nrf-7 is online"); })) << gateway.log();
  Subscriber named(broker, "ntnu-slam/robot/#", "%t %p");

  gateway.reload([](json& wanted) {
    wanted["robots"] = {{{"id", "tank"}, {"mqttsn_client_id", "nrf-7"}}};
  });
  ASSERT_TRUE(eventually([&] { return gateway.logs("tank is online"); })) << gateway.log();

  robot.send(sim::sn::publish(1, adv, 3, std::vector<std::uint8_t>{'h', 'i'}));
  robot.expect(sim::sn::Type::puback);
  ASSERT_TRUE(eventually([&] { return !named.lines().empty(); })) << gateway.log();
  EXPECT_EQ(named.lines().front(), "ntnu-slam/robot/tank/adv hi");
  std::thread answering([&] {
    const auto command = robot.expect(sim::sn::Type::publish);
    EXPECT_EQ(command.topic_id, cmd);
    robot.send(sim::sn::puback(cmd, command.msg_id, sim::sn::accepted));
  });
  EXPECT_EQ(gateway.ctl({"send", "tank", "cmd", "10,-20"})["outcome"], "delivered");
  answering.join();
  EXPECT_EQ(retained_presence(broker), std::set<std::string>{"ntnu-slam/gateway/test/robots/tank"});
}

TEST(Reload, WithdrawsRemovedRobotFromPreviousBroker) {
  Mosquitto left;
  Mosquitto next;
  json configuration = configuration_for(left);
  configuration["robots"] = {{{"id", "tank"}, {"mqttsn_client_id", "nrf-7"}}};
  GatewayProcess gateway(configuration);
  Device robot(gateway.mqttsn_address());
  robot.insist(sim::sn::connect("nrf-7", 60, sim::sn::flag_clean_session), sim::sn::Type::connack);
  robot.send(sim::sn::disconnect());
  robot.expect(sim::sn::Type::disconnect);
  ASSERT_FALSE(retained_presence(left).empty()) << gateway.log();

  gateway.reload([&](json& wanted) {
    wanted.erase("robots");
    wanted["broker"]["uri"] = next.uri();
  });

  Subscriber there(next, "ntnu-slam/gateway/test/state", "%p");
  ASSERT_TRUE(eventually([&] { return !there.lines().empty(); })) << gateway.log();
  Subscriber late(left, "ntnu-slam/gateway/test/#", "%r %t");
  ASSERT_TRUE(eventually([&] { return !late.lines().empty(); }));
  EXPECT_EQ(late.lines(), std::vector<std::string>{"1 ntnu-slam/gateway/test/state"});
}

TEST(Reload, NamesSettingsThatNeedRestartInOneLine) {
  Mosquitto broker;
  GatewayProcess gateway(configuration_for(broker));
  ASSERT_TRUE(eventually([&] { return gateway.logs("connected"); })) << gateway.log();
  gateway.reload([](json& wanted) {
    wanted["gateway"]["id"] = "other";
    wanted["broker"]["max_inflight"] = 17;
    wanted["broker"]["keep_alive_s"] = 31;
    wanted["topics"]["prefix"] = "elsewhere";
    wanted["payload"]["update"] = "json";
    wanted["presence"]["offline_after_s"] = 31;
    wanted["mqttsn"]["retry_count"] = 4;
    wanted["store"]["max_bytes"] = 1000000;
    wanted["control"]["socket"] = "/tmp/elsewhere.sock";
    wanted["log"]["level"] = "debug";
  });
  EXPECT_TRUE(eventually([&] {
    return gateway.logs(
        "only a restart changes: gateway.id, broker.max_inflight, topics.prefix, payload.update, "
        "ble_mesh.* or presence.*, mqttsn.*, store.*, control.socket\n");
  })) << gateway.log();
  EXPECT_EQ(gateway.ctl({"status"})["gateway"], "test");
}

TEST(Reload, WarnsLikeStart) {
  Mosquitto broker;
  GatewayProcess gateway(configuration_for(broker));
  ASSERT_TRUE(eventually([&] { return gateway.logs("connected"); })) << gateway.log();
  gateway.reload([](json& wanted) {
    wanted["ble_mesh"]["enabled"] = true;
    wanted["presence"]["offline_after_s"] = 5;
  });
  EXPECT_TRUE(eventually([&] {
    return gateway.logs("presence.offline_after_s: is no longer than");
  })) << gateway.log();
}

TEST(Reload, RefusesInvalidConfigurationAndKeepsOldOne) {
  Mosquitto broker;
  GatewayProcess gateway(configuration_for(broker));
  ASSERT_TRUE(eventually([&] { return gateway.logs("connected"); })) << gateway.log();
  const std::string open_to_all = gateway / "credentials.json";
  write_file(open_to_all, R"({"username":"u","password":"p"})", 0644);
  const auto count_refusals = [&] {
    int count = 0;
    const std::string log = gateway.log();
    const std::string words = "the configuration was not changed";
    for (auto at = log.find(words); at != log.npos; at = log.find(words, at + 1)) ++count;
    return count;
  };
  int refusals = 0;
  const auto refuses = [&](const std::function<void(json&)>& change) {
    const json before = json::parse(read_file(gateway / "gateway.json"));
    gateway.reload([&](json& wanted) {
      wanted["log"]["traffic"] = "off";  // valid itself, but refused with the rest
      change(wanted);
    });
    ++refusals;
    EXPECT_TRUE(eventually([&] { return count_refusals() == refusals; })) << gateway.log();
    write_file(gateway / "gateway.json", before.dump(2));
  };
  refuses([](json& wanted) { wanted["broker"]["uri"] = "nonsense"; });
  refuses([](json& wanted) { wanted["broker"]["urii"] = "mqtt://h:1"; });
  refuses([&](json& wanted) { wanted["broker"]["credentials_file"] = open_to_all; });
  refuses([](json& wanted) { wanted["broker"]["credentials_file"] = "/nonexistent"; });
  refuses([](json& wanted) {
    wanted["robots"] = {{{"id", "a"}, {"ble_address", "0x0100"}},
                        {{"id", "b"}, {"ble_address", "0x0100"}}};
  });
  EXPECT_TRUE(gateway.logs("broker.uri")) << gateway.log();
  EXPECT_TRUE(gateway.logs("broker.urii")) << gateway.log();
  EXPECT_EQ(gateway.ctl({"status"})["broker"]["uri"], broker.uri());
  EXPECT_EQ(gateway.ctl({"status"})["broker"]["state"], "up");
  SimulatorProcess robots({"thread", "--gateway", gateway.mqttsn_address(), "--robots", "1"});
  EXPECT_TRUE(eventually([&] { return gateway.logs("robot1 update"); }))
      << "log.traffic is unchanged";
}

}  // namespace
}  // namespace slamgw::test
