// SPDX-License-Identifier: Apache-2.0
// Two gateways' sessions at a real Mosquitto.
#include <gtest/gtest.h>

#include <deque>

#include "daemon/sessions/io/session_host.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::sessions {
namespace {

using test::eventually;

class Host {
 public:
  explicit Host(boost::asio::io_context& io)
      : host(
            io, SessionNames(TopicScheme("p", "g")), [](const std::string&) { return false; },
            [this](SessionHost::Report report) {
              std::visit([this](auto& what) { take(what); }, report);
            }) {}

  void up(const test::Mosquitto& broker, MqttVersion version) {
    BrokerSettings settings;
    settings.port = broker.port();
    host.on_broker_up(settings, version);
  }
  void hear(const std::string& robot) { host.input(&RobotSessions::on_heard, robot); }
  void subscribe(const std::string& robot, const std::string& filter) {
    host.input(&RobotSessions::subscribe, robot, filter, Qos::at_least_once, false);
  }

  std::vector<SessionHeld> held;
  std::vector<SessionLost> lost;
  std::vector<FilterAnswered> answered;
  std::vector<TakeMessage> taken;
  SessionHost host;

 private:
  void take(SessionHeld& what) { held.push_back(what); }
  void take(SessionLost& what) { lost.push_back(what); }
  void take(FilterAnswered& what) { answered.push_back(what); }
  void take(TakeMessage& what) { taken.push_back(what); }
  void take(RefuseStale&) {}
  void take(Notice& notice) { ADD_FAILURE() << notice.text; }
};

class SessionHosts : public testing::TestWithParam<MqttVersion> {
 protected:
  void publish(const std::string& topic, const std::string& payload) {
    test::mosquitto_publish(broker, {"-t", topic, "-m", payload, "-q", "1"});
  }

  boost::asio::io_context io{1};
  test::Mosquitto broker;
  Host a{io};
  Host b{io};
};

TEST_P(SessionHosts, ACommandComesToWhoeverHoldsTheRobotsSession) {
  a.up(broker, GetParam());
  b.up(broker, GetParam());
  a.hear("r1");
  a.subscribe("r1", "p/server/r1/+");
  ASSERT_TRUE(eventually(io, [&] { return a.answered.size() == 1; }));
  EXPECT_TRUE(a.answered[0].is_granted);
  publish("p/server/r1/run", "1");
  ASSERT_TRUE(eventually(io, [&] { return a.taken.size() == 1; }));
  EXPECT_EQ(as_text(a.taken[0].message.payload), "1");

  b.hear("r1");
  ASSERT_TRUE(eventually(io, [&] { return b.held.size() == 1 && a.lost.size() == 1; }));
  EXPECT_TRUE(b.held[0].was_present);
  EXPECT_EQ(a.lost[0].why, LossReason::taken);
  publish("p/server/r1/run", "0");
  ASSERT_TRUE(eventually(io, [&] { return b.taken.size() == 1; }));
  EXPECT_EQ(a.taken.size(), 1U);
  EXPECT_EQ(b.host.sessions().held(), 1U);
}

TEST_P(SessionHosts, WhatCameWhileNobodyHeldTheSessionWaitsAtTheBroker) {
  a.up(broker, GetParam());
  a.hear("r1");
  a.subscribe("r1", "p/server/r1/+");
  ASSERT_TRUE(eventually(io, [&] { return a.answered.size() == 1; }));
  a.host.stop();
  publish("p/server/r1/run", "1");
  b.up(broker, GetParam());
  b.hear("r1");
  ASSERT_TRUE(eventually(io, [&] { return b.taken.size() == 1; }));
  EXPECT_EQ(as_text(b.taken[0].message.payload), "1");
}

TEST_P(SessionHosts, SessionsComeBackWithTheBroker) {
  a.up(broker, GetParam());
  for (int i = 0; i < 20; ++i) a.hear("r" + std::to_string(i));
  ASSERT_TRUE(eventually(io, [&] { return a.held.size() == 20; }));
  broker.kill();
  a.host.on_broker_down();
  EXPECT_EQ(a.lost.size(), 20U);
  for (int i = 0; i < 20; ++i) a.hear("r" + std::to_string(i));
  broker.start();
  a.up(broker, GetParam());
  ASSERT_TRUE(eventually(io, [&] { return a.held.size() == 40; }));
}

INSTANTIATE_TEST_SUITE_P(Over, SessionHosts, testing::Values(MqttVersion::v5, MqttVersion::v3_1_1),
                         [](const auto& version) {
                           return version.param == MqttVersion::v5 ? "Mqtt5" : "Mqtt311";
                         });

}  // namespace
}  // namespace slamgw::sessions
