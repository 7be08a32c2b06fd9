// SPDX-License-Identifier: Apache-2.0
// The rights of docs/fleet.md, read from that page, at a real Mosquitto and a real NATS. With these
// rights gateways open robots' sessions and take them from each other and from a dead gateway.
// Other users reach no robot's mailbox, and no gateway publishes for another.
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <sstream>

#include "tests/e2e/device.hpp"
#include "tests/e2e/gateway_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/mosquitto.hpp"
#include "tests/support/nats_server.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

constexpr const char* any_password = "...";  // as on the page

std::string with_all_replaced(std::string text, std::string_view what, std::string_view by) {
  for (auto at = text.find(what); at != text.npos; at = text.find(what, at + by.size()))
    text.replace(at, what.size(), by);
  return text;
}

/// Returns the first block of code below `lead` in docs/fleet.md.
std::string block_below(std::string_view lead) {
  const std::string page = read_file(SLAMGW_FLEET_PAGE);
  const auto begin = page.find("\n```\n", page.find(lead));
  const auto end = page.find("\n```\n", begin + 1);
  if (page.find(lead) == page.npos || end == page.npos)
    throw std::runtime_error("docs/fleet.md has no block below: " + std::string(lead));
  return page.substr(begin + 5, end - begin - 4);
}

/// A broker with users and rights, among them the gateways room-a and room-b.
class GuardedBroker {
 public:
  virtual ~GuardedBroker() = default;
  virtual std::uint16_t port() const = 0;
  /// Returns the lines of its log about refusals.
  virtual std::string refusals() const = 0;

 protected:
  static std::string lines_with(const std::string& text, std::string_view what) {
    std::istringstream lines(text);
    std::string found;
    for (std::string line; std::getline(lines, line);)
      if (line.find(what) != line.npos) found += line + "\n";
    return found;
  }
};

class GuardedMosquitto : public GuardedBroker {
 public:
  GuardedMosquitto() {
    std::string list = rights_of_example();
    const std::string of_a = block_below("With Mosquitto");
    list += "\n" + of_a + "\n" + with_all_replaced(of_a, "room-a", "room-b");
    list += "\nuser robot\ntopic readwrite ntnu-slam/robot/robot/#\n";
    write_file(directory_ / "acl", list, 0600);
    write_file(directory_ / "passwords", "", 0600);
    for (const char* user : {"slam-gateway", "slam-server", "room-a", "room-b", "robot"})
      run_program({"mosquitto_passwd", "-b", directory_ / "passwords", user, any_password});
    broker_.emplace(
        fmt::format("allow_anonymous false\npassword_file {}\nacl_file {}\n"
                    "log_type all\nlog_dest file {}\n",
                    directory_ / "passwords", directory_ / "acl", directory_ / "log"));
  }
  std::uint16_t port() const override { return broker_->port(); }
  std::string refusals() const override {
    return lines_with(read_file(directory_ / "log"), "Denied");
  }

 private:
  /// Does the same as docs/broker.md: sed -n 's/^#   //p'.
  static std::string rights_of_example() {
    std::istringstream example(read_file(SLAMGW_BROKER_EXAMPLE));
    std::string list;
    for (std::string line; std::getline(example, line);)
      if (line.starts_with("#   ")) list += line.substr(4) + "\n";
    return list;
  }

  TempDir directory_;
  std::optional<Mosquitto> broker_;
};

class GuardedNats : public GuardedBroker {
 public:
  std::uint16_t port() const override { return server_.mqtt_port(); }
  std::string refusals() const override { return lines_with(server_.log(), "Violation"); }

 private:
  /// Returns the users of the page and one more for each other gateway, as the page says.
  static std::string accounts() {
    std::string text = block_below("NATS maps levels");
    const auto begin = text.find("{ user: room-a");
    const auto end = text.find("{ user:", begin + 1);
    if (end == text.npos) throw std::runtime_error("no user after room-a: " + text);
    const std::string of_a = text.substr(begin, end - begin);
    text.insert(end, with_all_replaced(of_a, "room-a", "room-b") +
                         R"({ user: robot, password: "...", permissions: {
                              publish: "ntnu-slam.robot.robot.>" } }, )");
    return text;
  }

  NatsServer server_{accounts()};
};

std::unique_ptr<GuardedBroker> make_broker(const std::string& engine) {
  if (engine == "Nats") return std::make_unique<GuardedNats>();
  return std::make_unique<GuardedMosquitto>();
}

class FleetRights : public testing::TestWithParam<std::string> {
 protected:
  void SetUp() override {
    if (GetParam() == "Nats" && !NatsServer::is_installed())
      GTEST_SKIP() << "nats-server is not installed";
    broker = make_broker(GetParam());
  }

  std::vector<std::string> client(const std::string& program, const std::string& user) const {
    return {program, "-V", "311",       "-p",        std::to_string(broker->port()),
            "-q",    "1",  "-h",        "127.0.0.1", "-u",
            user,    "-P", any_password};
  }
  void publish(const std::string& user, const std::string& topic, const std::string& text) const {
    auto command = client("mosquitto_pub", user);
    command.insert(command.end(), {"-t", topic, "-m", text});
    run_program(command);
  }
  /// Writes the messages of `filters` that `user` receives to the file of the user's name.
  void listen(const std::string& user, const std::vector<std::string>& filters) {
    std::vector<std::string> command{"stdbuf", "-oL"};
    for (const std::string& word : client("mosquitto_sub", user)) command.push_back(word);
    for (const std::string& filter : filters) command.insert(command.end(), {"-t", filter});
    command.insert(command.end(), {"-d", "-F", "MSG %t %p"});
    listeners.push_back(std::make_unique<ChildProcess>(command, directory / user));
    ASSERT_TRUE(eventually([&] { return hears(user, "SUBACK"); })) << read_file(directory / user);
  }
  bool hears(const std::string& user, const std::string& text) const {
    return read_file(directory / user).find(text) != std::string::npos;
  }

  json configuration(const std::string& id, const std::string& user) const {
    const std::string credentials = directory / (id + ".json");
    write_file(credentials, json{{"username", user}, {"password", any_password}}.dump(), 0600);
    return {{"gateway", {{"id", id}}},
            {"broker",
             {{"uri", fmt::format("mqtt://127.0.0.1:{}", broker->port())},
              {"credentials_file", credentials}}}};
  }

  void serve_robots(const std::string& user_of_a, const std::string& user_of_b);

  TempDir directory;
  std::unique_ptr<GuardedBroker> broker;
  std::vector<std::unique_ptr<ChildProcess>> listeners;
};

INSTANTIATE_TEST_SUITE_P(At, FleetRights, testing::Values("Mosquitto", "Nats"),
                         [](const auto& engine) { return engine.param; });

/// Expects that neither log nor status of the gateway mentions a refusal.
void expect_no_refusal(const GatewayProcess& gateway) {
  for (const char* refusal : {"access control list", "refuse", "rights"})
    EXPECT_FALSE(gateway.logs(refusal)) << gateway.log();
  const json status = gateway.ctl({"status"});
  ASSERT_TRUE(status.is_object());
  EXPECT_EQ(status["broker"]["missing_rights"], json::array());
  EXPECT_EQ(status["broker"]["refused"]["topics"], 0) << status;
  EXPECT_EQ(status["messages"]["refused"], 0) << status;
}

void FleetRights::serve_robots(const std::string& user_of_a, const std::string& user_of_b) {
  listen("slam-server", {"ntnu-slam/robot/#", "ntnu-slam/gateway/#"});
  GatewayProcess a(configuration("room-a", user_of_a));
  GatewayProcess b(configuration("room-b", user_of_b));
  for (const GatewayProcess* gateway : {&a, &b})
    ASSERT_TRUE(eventually([&] {
      const json fleet = gateway->ctl({"fleet"});
      return fleet.is_object() && fleet["gateways"].size() == 2 &&
             fleet["gateways"][0]["state"] == "member" && fleet["gateways"][1]["state"] == "member";
    })) << gateway->log();
  SimulatorProcess robots({"thread", "--gateway", a.mqttsn_address(), "--robots", "1"});

  // The robot moves, and its session with the note moves along.
  Device at_a{a.mqttsn_address()};
  at_a.connect_with_will("r1");
  at_a.subscribe("ntnu-slam/server/r1/cmd");
  ASSERT_TRUE(eventually([&] { return b.place_in_fleet("r1") == "room-a"; })) << b.log();
  Device at_b{b.mqttsn_address()};
  at_b.connect_with_will("r1");
  ASSERT_TRUE(eventually([&] { return a.place_in_fleet("r1") == "room-b"; })) << a.log();

  // A command, over the robot's own session.
  publish("slam-server", "ntnu-slam/server/r1/cmd", "1,2");
  at_b.obey();
  ASSERT_TRUE(eventually([&] { return hears("slam-server", "gateway/room-b/commands/r1"); }));
  expect_no_refusal(b);

  // A dead gateway's entry is withdrawn by the one that takes its robot over.
  b.process().send_signal(SIGKILL);
  Device back_at_a{a.mqttsn_address()};
  back_at_a.connect_with_will("r1");
  ASSERT_TRUE(eventually([&] { return a.place_in_fleet("r1") == "room-a"; })) << a.log();
  EXPECT_TRUE(eventually([&] { return hears("slam-server", "gateway/room-b/robots/r1 \n"); }))
      << read_file(directory / "slam-server");
  EXPECT_TRUE(hears("slam-server", "ntnu-slam/robot/robot1/update")) << a.log();
  EXPECT_TRUE(eventually([&] { return hears("slam-server", "gateway/room-a/numbers"); }));
  expect_no_refusal(a);
  EXPECT_EQ(broker->refusals(), "");
}

TEST_P(FleetRights, GrantEveryRightThatGatewaysUse) { serve_robots("room-a", "room-b"); }

using FleetRightsOfTheExample = FleetRights;
INSTANTIATE_TEST_SUITE_P(At, FleetRightsOfTheExample, testing::Values("Mosquitto"),
                         [](const auto& engine) { return engine.param; });

TEST_P(FleetRightsOfTheExample, AllowSeveralGatewaysWithOneUser) {
  serve_robots("slam-gateway", "slam-gateway");
}

TEST_P(FleetRights, DenyMailboxesToOthersAndForgedGatewayTopics) {
  listen("room-b", {"ntnu-slam/fleet/all/+", "ntnu-slam/fleet/robots/#", "ntnu-slam/gateway/#",
                    "ntnu-slam/server/#"});
  // NATS stores messages of QoS 1 under `$MQTT/msgs/` and delivers what is published there.
  for (const std::string place : {"", "$MQTT/msgs/"}) {
    for (const char* user : {"slam-server", "robot", "room-a"})
      for (const char* topic : {"fleet/all/room-b", "fleet/all/robot", "gateway/room-b/state",
                                "gateway/room-b/commands/r1"})
        publish(user, fmt::format("{}ntnu-slam/{}", place, topic), "forged");
    for (const char* user : {"slam-server", "robot"})
      for (const char* topic : {"fleet/robots/r1", "fleet/robots/r1/waiting"})
        publish(user, fmt::format("{}ntnu-slam/{}", place, topic), "forged");
  }
  publish("robot", "ntnu-slam/server/r1/cmd", "forged");
  publish("room-a", "ntnu-slam/server/r1/cmd", "forged");

  publish("slam-server", "ntnu-slam/server/r1/cmd", "a command");
  publish("room-a", "ntnu-slam/fleet/all/room-a", "what it hears");
  publish("room-a", "ntnu-slam/fleet/robots/r1", "a note");
  publish("room-a", "ntnu-slam/fleet/robots/r1/waiting", "a message");
  publish("room-a", "ntnu-slam/gateway/room-a/state", "a state");
  for (const char* allowed : {"a command", "what it hears", "a note", "a message", "a state"})
    EXPECT_TRUE(eventually([&] { return hears("room-b", allowed); })) << allowed;
  EXPECT_FALSE(hears("room-b", "forged")) << read_file(directory / "room-b");
}

}  // namespace
}  // namespace slamgw::test
