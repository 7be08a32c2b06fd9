// SPDX-License-Identifier: Apache-2.0
// Several brokers in the configuration, with each client library: real ones that are killed or
// stand still.
#include <gtest/gtest.h>

#include "tests/mqtt/broker_link.hpp"
#include "tests/support/certificates.hpp"
#include "tests/support/free_port.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw {
namespace {

using test::Mosquitto;
using test::Subscriber;

class BrokerList : public WithEachClient {
 public:
  static BrokerSettings list_of(std::initializer_list<std::uint16_t> ports) {
    BrokerSettings settings = settings_for(*ports.begin());
    for (const std::uint16_t port : ports) settings.others.push_back({"127.0.0.1", port, false});
    settings.others.erase(settings.others.begin());
    return settings;
  }
};

/// A link to the first of two brokers.
struct TwoBrokers {
  explicit TwoBrokers(bool returns_to_first = false) : link(settings(returns_to_first)) {}
  BrokerSettings settings(bool returns_to_first) const {
    BrokerSettings settings = BrokerList::list_of({first.port(), second.port()});
    settings.returns_to_first = returns_to_first;
    return settings;
  }
  /// Kills the first broker once the link is up there. Returns true if the link then comes up at
  /// the second.
  bool moves_on() {
    if (!link.comes_up()) return false;
    first.kill();
    return link.sees([&] { return link.listener.ups == 2; }) &&
           link.upstream->broker().port == second.port();
  }

  Mosquitto first;
  Mosquitto second;
  Link link;
};

INSTANTIATE_TEST_SUITE_P(Over, BrokerList, each_client, BrokerList::name);

TEST_P(BrokerList, MovesToTheNextBrokerAtOnceWhenTheConnectionBreaks) {
  Mosquitto first;
  Mosquitto second;
  Link link(list_of({first.port(), second.port()}));
  ASSERT_TRUE(link.comes_up());
  EXPECT_EQ(link.upstream->broker().port, first.port());
  first.kill();
  ASSERT_TRUE(link.sees([&] { return link.listener.ups == 2; }));
  EXPECT_EQ(link.upstream->broker().port, second.port());
  EXPECT_EQ(link.listener.reasons.size(), 1u) << link.listener.reasons.back();
  Subscriber subscriber(second, "t");
  link.upstream->publish(1, {"t", to_bytes("x"), Qos::at_least_once, false});
  EXPECT_TRUE(link.sees([&] { return subscriber.lines().size() == 1; }));
}

TEST_P(BrokerList, CountsTheNodesOfAClusterAsOneBroker) {
  for (const bool is_cluster : {true, false}) {
    TwoBrokers brokers;
    BrokerSettings settings = brokers.settings(/*returns_to_first=*/false);
    settings.is_cluster = is_cluster;
    brokers.link.upstream->reconfigure(settings);
    ASSERT_TRUE(brokers.moves_on());
    const std::uint16_t port = (is_cluster ? brokers.first : brokers.second).port();
    EXPECT_EQ(brokers.link.upstream->common_uri(), "mqtt://127.0.0.1:" + std::to_string(port));
  }
}

TEST_P(BrokerList, StaysWithTheNextBrokerWhenTheFirstIsBack) {
  TwoBrokers brokers;
  auto& first = brokers.first;
  auto& second = brokers.second;
  auto& link = brokers.link;
  ASSERT_TRUE(brokers.moves_on());
  first.start();
  second.kill();
  ASSERT_TRUE(link.sees([&] { return link.listener.ups == 3; }));
  EXPECT_EQ(link.upstream->broker().port, first.port()) << "round the list again";
}

TEST_P(BrokerList, ReturnsToTheFirstBrokerWhenSoConfigured) {
  TwoBrokers brokers(true);
  auto& first = brokers.first;
  auto& link = brokers.link;
  ASSERT_TRUE(brokers.moves_on());
  const std::size_t failures = link.listener.reasons.size();
  first.start();
  ASSERT_TRUE(link.sees([&] { return link.listener.ups == 3; }));
  EXPECT_EQ(link.upstream->broker().port, first.port());
  EXPECT_EQ(link.listener.departures.size(), 1u);
  EXPECT_EQ(link.listener.reasons.size(), failures) << "an intended change is no failure";
}

TEST_P(BrokerList, PublishesItsLastWillAtTheBrokerThatItLeavesForTheFirst) {
  TwoBrokers brokers(true);
  auto& first = brokers.first;
  auto& second = brokers.second;
  auto& link = brokers.link;
  ASSERT_TRUE(brokers.moves_on());
  link.upstream->publish(1, {"gw/state", to_bytes("online"), Qos::at_least_once, true});
  ASSERT_TRUE(link.sees([&] { return link.listener.published.contains(1); }));
  Subscriber subscriber(second, "gw/state", "%p");
  ASSERT_TRUE(link.sees([&] { return subscriber.lines().size() == 1; }));
  first.start();
  ASSERT_TRUE(link.sees([&] { return link.listener.ups == 3; }));
  EXPECT_TRUE(link.sees([&] { return subscriber.lines().size() == 2; }));
  EXPECT_EQ(subscriber.lines().back(), R"({"state":"offline"})");
  EXPECT_EQ(link.listener.published, std::set<std::uint64_t>{1});
}

TEST_P(BrokerList, PublishesItsLastWillAtTheBrokerThatANewConfigurationLeaves) {
  TwoBrokers brokers;
  ASSERT_TRUE(brokers.moves_on());
  brokers.first.start();
  Subscriber will(brokers.second, "gw/state", "%p");
  BrokerSettings settings = brokers.settings(false);
  settings.keep_alive = std::chrono::seconds{20};
  brokers.link.upstream->reconfigure(settings);
  EXPECT_TRUE(brokers.link.sees([&] { return !will.lines().empty(); }));
}

TEST_P(BrokerList, TriesAllBrokersInOrder) {
  Mosquitto last;
  const std::uint16_t closed_port = test::free_tcp_port();
  const std::uint16_t other_closed_port = test::free_tcp_port();
  Link link(list_of({closed_port, other_closed_port, last.port()}));
  ASSERT_TRUE(link.comes_up());
  ASSERT_EQ(link.listener.reasons.size(), 2u);
  EXPECT_NE(link.listener.reasons[0].find("port " + std::to_string(closed_port)),
            std::string::npos);
  EXPECT_NE(link.listener.reasons[1].find("port " + std::to_string(other_closed_port)),
            std::string::npos);
}

TEST_P(BrokerList, ChecksTheCertificateForEachBrokersOwnName) {
  const test::Certificates right("localhost");
  const std::uint16_t tls_port = test::free_tcp_port();
  Mosquitto broker("listener " + std::to_string(tls_port) + " 127.0.0.1\ncertfile " +
                   right.certificate() + "\nkeyfile " + right.key());
  BrokerSettings settings = settings_for(tls_port);
  settings.tls = true;  // the certificate is not for 127.0.0.1
  settings.ca_file = right.ca();
  settings.others = {{"localhost", tls_port, true}};
  Link link(settings);
  ASSERT_TRUE(link.comes_up());
  EXPECT_EQ(link.upstream->broker().host, "localhost");
  EXPECT_NE(link.listener.reasons[0].find("is not for '127.0.0.1'"), std::string::npos)
      << link.listener.reasons[0];
}

TEST_P(BrokerList, GivesEachBrokerItsOwnClientId) {
  Mosquitto second;
  BrokerSettings settings = list_of({test::free_tcp_port(), second.port()});
  settings.client_id = "gw-%n";
  Link link(settings);
  ASSERT_TRUE(link.comes_up());
  EXPECT_EQ(link.upstream->broker().client_id, "gw-2");
}

TEST_P(BrokerList, LeavesABrokerThatStandsStill) {
  Mosquitto first;
  Mosquitto second;
  BrokerSettings settings = list_of({first.port(), second.port()});
  settings.keep_alive = std::chrono::seconds(5);
  Link link(settings);
  ASSERT_TRUE(link.comes_up());
  first.pause();
  ASSERT_TRUE(link.sees([&] { return link.listener.ups == 2; }));
  EXPECT_EQ(link.upstream->broker().port, second.port());
  first.resume();
}

}  // namespace
}  // namespace slamgw
