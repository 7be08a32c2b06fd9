// SPDX-License-Identifier: Apache-2.0
// config/mosquitto.example.conf as an operator takes it over. With its passwords and its access
// control list the gateway works, and other users are restricted to their topics.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <sstream>

#include "tests/e2e/gateway_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/free_port.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

std::string replaced(std::string text, const std::string& what, const std::string& by) {
  const std::size_t at = text.find(what);
  if (at == text.npos) throw std::runtime_error("the example has no " + what);
  return text.replace(at, what.size(), by);
}

class BrokerExample : public testing::Test {
 protected:
  BrokerExample() {
    const std::string example = read_file(SLAMGW_BROKER_EXAMPLE);
    std::string text =
        replaced(example, "\nlistener 1883\n", fmt::format("\nlistener {} 127.0.0.1\n", port_));
    text = replaced(text, "password_file /etc/mosquitto/slam-gateway.passwd",
                    "password_file " + (directory_ / "passwords"));
    text = replaced(text, "acl_file /etc/mosquitto/slam-gateway.acl",
                    "acl_file " + (directory_ / "acl"));
    // Root's Mosquitto becomes the user of this name, which must be able to read the files.
    write_file(directory_ / "mosquitto.conf", text + "user root\n");
    write_acl(example);
    run_program({"mosquitto_passwd", "-b", "-c", directory_ / "passwords", "slam-gateway", "g"});
    run_program({"mosquitto_passwd", "-b", directory_ / "passwords", "slam-server", "s"});
    broker_ = std::make_unique<ChildProcess>(
        std::vector<std::string>{"mosquitto", "-c", directory_ / "mosquitto.conf"}, std::string(),
        directory_ / "broker.log");
    if (!eventually([&] { return publish("slam-gateway", "ntnu-slam/gateway/test/up", "1"); }))
      throw std::runtime_error("no broker: " + read_file(directory_ / "broker.log"));
  }

  /// Does the same as docs/broker.md: sed -n 's/^#   //p'.
  void write_acl(const std::string& example) {
    std::string acl;
    std::istringstream lines(example);
    for (std::string line; std::getline(lines, line);)
      if (line.starts_with("#   ")) acl += line.substr(4) + "\n";
    write_file(directory_ / "acl", acl, 0600);
  }

  static std::string password_of(const std::string& user) { return user.substr(5, 1); }

  std::vector<std::string> client(const std::string& program, const std::string& user) const {
    std::vector<std::string> command{program, "-h", "127.0.0.1", "-p", std::to_string(port_),
                                     "-q",    "1"};
    if (!user.empty()) command.insert(command.end(), {"-u", user, "-P", password_of(user)});
    return command;
  }

  bool publish(const std::string& user, const std::string& topic, const std::string& text,
               bool retain = false) const {
    std::vector<std::string> command = client("mosquitto_pub", user);
    command.insert(command.end(), {"-t", topic, "-m", text});
    if (retain) command.emplace_back("-r");
    return run_program(command).status == 0;
  }

  /// Writes the messages of `filter` that `user` receives to the file of the user's name.
  void listen(const std::string& user, const std::string& filter) {
    std::vector<std::string> command{"stdbuf", "-oL"};
    for (const std::string& word : client("mosquitto_sub", user)) command.push_back(word);
    command.insert(command.end(), {"-d", "-t", filter, "-F", "MSG %t %p"});
    listeners_.push_back(std::make_unique<ChildProcess>(command, directory_ / user));
    ASSERT_TRUE(eventually([&] { return hears(user, "SUBACK"); }));
  }
  bool hears(const std::string& user, const std::string& text) const {
    return read_file(directory_ / user).find(text) != std::string::npos;
  }

  json gateway_configuration() {
    const std::string credentials = directory_ / "credentials.json";
    write_file(credentials, R"({"username": "slam-gateway", "password": "g"})", 0600);
    return {
        {"broker",
         {{"uri", fmt::format("mqtt://127.0.0.1:{}", port_)}, {"credentials_file", credentials}}}};
  }

  TempDir directory_;
  std::uint16_t port_ = free_tcp_port();
  std::unique_ptr<ChildProcess> broker_;
  std::vector<std::unique_ptr<ChildProcess>> listeners_;
};

TEST_F(BrokerExample, GrantsEveryRightThatGatewayUses) {
  ASSERT_TRUE(publish("slam-gateway", "ntnu-slam/gateway/test/robots/ghost",
                      R"({"state":"online"})", true));
  listen("slam-server", "#");
  GatewayProcess gateway(gateway_configuration());
  SimulatorProcess robots({"thread", "--gateway", gateway.mqttsn_address(), "--robots", "1"});
  EXPECT_TRUE(eventually([&] { return hears("slam-server", "ntnu-slam/robot/robot1/update"); }))
      << gateway.log();
  EXPECT_TRUE(hears("slam-server", "gateway/test/state {")) << gateway.log();

  EXPECT_TRUE(publish("slam-server", "ntnu-slam/server/robot1/run", "1"));
  EXPECT_TRUE(eventually([&] { return hears("slam-server", "gateway/test/commands/robot1"); }))
      << gateway.log();
  // The gateway reads this to find robots that a killed daemon left as online.
  listen("slam-gateway", "ntnu-slam/gateway/test/robots/+");
  EXPECT_TRUE(eventually([&] { return hears("slam-gateway", "gateway/test/robots/ghost"); }));
  EXPECT_FALSE(gateway.logs("access control list")) << gateway.log();
}

TEST_F(BrokerExample, RestrictsOtherUsersToTheirTopics) {
  listen("slam-gateway", "#");
  for (const char* topic : {"ntnu-slam/gateway/test/state", "ntnu-slam/robot/robot1/update",
                            "ntnu-slam/gateway/test/robots/robot1", "elsewhere"})
    publish("slam-server", topic, "forged");  // MQTT 3.1.1 acknowledges it and drops it
  ASSERT_TRUE(publish("slam-server", "ntnu-slam/server/robot1/cmd", "allowed"));
  EXPECT_TRUE(eventually([&] { return hears("slam-gateway", "allowed"); }));
  EXPECT_FALSE(hears("slam-gateway", "forged")) << read_file(directory_ / "slam-gateway");
  EXPECT_FALSE(publish("", "ntnu-slam/server/robot1/cmd", "anonymous"));
  EXPECT_FALSE(hears("slam-gateway", "anonymous"));
}

}  // namespace
}  // namespace slamgw::test
