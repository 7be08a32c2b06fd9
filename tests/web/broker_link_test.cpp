// SPDX-License-Identifier: Apache-2.0
// The connection of slam-gateway-web to a real Mosquitto.
#include "web/server/io/broker_link.hpp"

#include <gtest/gtest.h>

#include "tests/support/eventually.hpp"
#include "tests/support/mosquitto.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::web {
namespace {

/// Returns the first reason why the broker cannot be reached.
std::string refusal_of(const test::Mosquitto& broker,
                       std::optional<std::string> credentials_file = {}, bool tls = false) {
  BrokerSettings settings;
  settings.port = broker.port();
  settings.tls = tls;
  settings.credentials_file = std::move(credentials_file);
  boost::asio::io_context io;
  std::string refusal;
  BrokerLink::Listener listener;
  listener.on_state = [&](bool, const std::string& why) {
    refusal = why;
    io.stop();
  };
  const auto work = boost::asio::make_work_guard(io);
  const BrokerLink link(io, settings, {"a/#"}, listener);
  io.run_for(std::chrono::seconds(30));
  return refusal;
}

TEST(WebBrokerLink, PassesSenderOfCommandAndOriginOfMessage) {
  const test::Mosquitto broker;
  const test::Subscriber robot(broker, "a/server/#", "%t %x %P", "mqttv5");
  BrokerSettings settings;
  settings.port = broker.port();
  boost::asio::io_context io;
  std::vector<BrokerMessage> heard;
  bool is_up = false;
  BrokerLink::Listener listener;
  listener.on_state = [&](bool is_there, const std::string&) { is_up = is_there; };
  listener.on_message = [&](const BrokerMessage& message) { heard.push_back(message); };
  BrokerLink link(io, settings, {"a/robot/#"}, listener);
  EXPECT_FALSE(link.publish({"a/server/r/run", "stop", "ada"})) << "the broker is offline";
  ASSERT_TRUE(test::eventually(io, [&] { return is_up; }));
  ASSERT_TRUE(link.publish({"a/server/r/run", "stop", "ada, page at 192.0.2.1"}));
  ASSERT_TRUE(test::eventually(io, [&] { return robot.lines().size() == 1; }));
  EXPECT_EQ(robot.lines().front(), "a/server/r/run 73746f70 sender:ada, page at 192.0.2.1");
  const auto user_property = [](const std::string& name, const std::string& value) {
    return std::vector<std::string>{"-D", "publish", "user-property", name, value};
  };
  std::vector<std::string> arguments{"-V", "5", "-t", "a/robot/r/update", "-m", "x"};
  for (const auto& each : {user_property("mesh", "ble"), user_property("gateway", "pi"),
                           user_property("received_at", "2026-11-21T13:57:43.613Z")})
    arguments.insert(arguments.end(), each.begin(), each.end());
  // The first messages may come before the subscription.
  ASSERT_TRUE(test::eventually(io, [&] {
    if (heard.empty()) test::mosquitto_publish(broker, arguments);
    return !heard.empty();
  }));
  EXPECT_EQ(heard.front().mesh, "ble");
  EXPECT_EQ(heard.front().gateway, "pi");
  EXPECT_EQ(heard.front().received_at, "2026-11-21T13:57:43.613Z");
}

TEST(WebBrokerLink, NamesRefusedUserAndFile) {
  const test::Mosquitto broker({}, "page", "right");
  const test::TempDir directory;
  const std::string file = directory / "web-credentials.json";
  test::write_file(file, R"({"username": "page", "password": "not it"})", 0600);
  const std::string wrong = refusal_of(broker, file);
  EXPECT_NE(wrong.find("(user 'page' from " + file + "): correct that file"), wrong.npos) << wrong;
  EXPECT_EQ(wrong.find("not it"), wrong.npos) << "no password in a log";
  const std::string none = refusal_of(broker);
  EXPECT_NE(none.find("(no user name was sent): give one in web-credentials.json"), none.npos)
      << none;
}

TEST(WebBrokerLink, NamesTlsFailure) {
  const test::Mosquitto broker;
  const std::string why = refusal_of(broker, std::nullopt, true);
  EXPECT_NE(why.find("TLS"), why.npos) << why;
}

}  // namespace
}  // namespace slamgw::web
