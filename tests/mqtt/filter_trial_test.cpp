// SPDX-License-Identifier: Apache-2.0
// Brokers that close the connection at a filter in place of refusing it: a fake one in both
// versions, and NATS.
#include <gtest/gtest.h>

#include "tests/mqtt/broker_link.hpp"
#include "tests/support/fake_broker.hpp"
#include "tests/support/nats_server.hpp"

namespace slamgw {
namespace {

using test::FakeBroker;

using FilterTrial = WithEachClientAndVersion;
INSTANTIATE_TEST_SUITE_P(Over, FilterTrial, testing::Combine(each_client, either_version),
                         FilterTrial::name);

/// As the core does at each connect.
struct SubscribedLink : Link {
  using Link::Link;
  /// Until `bad` is set aside.
  bool finds_out(const std::string& bad, const std::string& good) {
    int ups = 0;
    const auto step = [&] {
      if (listener.is_up && ups != listener.ups) {
        ups = listener.ups;
        listener.subscribed.clear();
        for (const std::string& filter : {good, bad})
          upstream->subscribe(filter, Qos::at_least_once, 7);
      }
      return listener.set_aside.contains(bad) && listener.is_up && listener.subscribed[good];
    };
    return sees(step);
  }
};

TEST_P(FilterTrial, AFilterForWhichTheBrokerClosesIsSetAsideAndTheRestGoesOn) {
  FakeBroker broker;
  broker.misbehave([&](FakeBroker::Connection& connection, const FakeBroker::Packet& packet) {
    if (version() == MqttVersion::v3_1_1 && connection.is_v5()) {
      connection.send({0x20, 3, 0, 0x84, 0});
      connection.close();
      return true;
    }
    if (packet.type() != FakeBroker::subscribe || !packet.contains("lo.ad")) return false;
    connection.close();
    return true;
  });
  SubscribedLink link(settings_for(broker.port()));
  ASSERT_TRUE(link.finds_out("server/lo.ad0/#", "server/r1/#"))
      << testing::PrintToString(link.listener.reasons);
  EXPECT_EQ(link.listener.set_aside, std::set<std::string>{"server/lo.ad0/#"});
  const int ups = link.listener.ups;
  link.listener.set_aside.clear();
  link.upstream->subscribe("server/lo.ad0/#", Qos::at_least_once, 7);
  EXPECT_TRUE(link.sees([&] { return !link.listener.set_aside.empty(); })) << "told again";
  link.upstream->publish(1, {"robot/r1/update", to_bytes("x"), Qos::at_least_once, false});
  EXPECT_TRUE(link.sees([&] { return link.listener.published.size() == 1; }));
  EXPECT_EQ(link.listener.ups, ups);
  for (const std::string& reason : link.listener.reasons)
    EXPECT_EQ(reason.find("perhaps"), std::string::npos) << "no rival is suspected: " << reason;
}

TEST(FilterTrialNats, ARobotWithADotInItsNameDoesNotDisconnectTheOthers) {
  if (!test::NatsServer::is_installed()) GTEST_SKIP() << "nats-server is not installed";
  test::NatsServer broker;
  SubscribedLink link(settings_for(broker.mqtt_port()));
  ASSERT_TRUE(link.finds_out("ntnu-slam/server/lo.ad0/#", "ntnu-slam/server/r1/#"))
      << testing::PrintToString(link.listener.reasons);
  EXPECT_EQ(link.listener.set_aside, std::set<std::string>{"ntnu-slam/server/lo.ad0/#"});
}

}  // namespace
}  // namespace slamgw
