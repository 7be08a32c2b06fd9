// SPDX-License-Identifier: Apache-2.0
// Brokers that close the connection at a filter in place of refusing it: a fake one, and Mosquitto;
// and NATS, which refuses.
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
  /// True when `bad` is refused or set aside, and `good` granted.
  bool finds_out(const std::string& bad, const std::string& good) {
    int ups = 0;
    const auto step = [&] {
      if (listener.is_up && ups != listener.ups) {
        ups = listener.ups;
        listener.subscribed.clear();
        for (const std::string& filter : {good, bad})
          upstream->subscribe(filter, Qos::at_least_once, 7);
      }
      const auto answer = listener.subscribed.find(bad);
      const bool is_refused = answer != listener.subscribed.end() && !answer->second;
      return listener.is_up && is_refused && listener.subscribed[good];
    };
    return sees(step);
  }
};

/// Closes the connection for each SUBSCRIBE that names `lo.ad`; takes version 5 only if `version`
/// is that.
auto closing_for_load(MqttVersion version) {
  return [version](FakeBroker::Connection& connection, const FakeBroker::Packet& packet) {
    if (version == MqttVersion::v3_1_1 && connection.is_v5()) {
      connection.send({0x20, 3, 0, 0x84, 0});
      connection.close();
      return true;
    }
    if (packet.type() != FakeBroker::subscribe || !packet.contains("lo.ad")) return false;
    connection.close();
    return true;
  };
}

TEST_P(FilterTrial, AFilterForWhichTheBrokerClosesIsSetAsideAndTheRestGoesOn) {
  FakeBroker broker;
  broker.misbehave(closing_for_load(version()));
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

/// With a back-off that goes on, and all doubts forgotten at each find, this would take minutes.
TEST_P(FilterTrial, SeveralSuchFiltersAreFoundOneAfterTheOther) {
  FakeBroker broker;
  broker.misbehave(closing_for_load(version()));
  SubscribedLink link(settings_for(broker.port()));
  const std::set<std::string> bad{"lo.ad0", "lo.ad1", "lo.ad2", "lo.ad3"};
  int ups = 0;
  EXPECT_TRUE(link.sees([&] {
    if (link.listener.is_up && std::exchange(ups, link.listener.ups) != link.listener.ups)
      for (const std::string& filter : bad) link.upstream->subscribe(filter, Qos::at_least_once, 7);
    return link.listener.set_aside == bad;
  })) << testing::PrintToString(link.listener.set_aside);
}

/// U+0085 is refused at every door of the gateway; here it is let through. libmosquitto does not
/// send it.
TEST_P(FilterTrial, AFilterForWhichMosquittoClosesDoesNotDisconnectTheOthers) {
  BrokerOfVersion broker(version());
  SubscribedLink link(settings_for(broker.link_port()));
  const std::string bad = "server/a\xc2\x85/#";
  ASSERT_TRUE(link.finds_out(bad, "server/r1/#")) << testing::PrintToString(link.listener.reasons);
  EXPECT_FALSE(link.listener.subscribed[bad]);
}

/// NATS makes subjects of filters, which have no `.` and no space.
TEST_P(FilterTrial, AFilterThatNatsCannotHaveIsRefusedAlone) {
  if (!test::NatsServer::is_installed()) GTEST_SKIP() << "nats-server is not installed";
  if (version() == MqttVersion::v5) GTEST_SKIP() << "NATS speaks MQTT 3.1.1";
  test::NatsServer broker;
  SubscribedLink link(settings_for(broker.mqtt_port()));
  EXPECT_TRUE(link.finds_out("ntnu-slam/server/lo.ad0/#", "ntnu-slam/server/r1/#"));
  EXPECT_EQ(link.listener.ups, 1);
}

}  // namespace
}  // namespace slamgw
