// SPDX-License-Identifier: Apache-2.0
// Subscribing on the robot's own session at the broker (R94-R105).
#include <gtest/gtest.h>

#include "adapters/mqttsn_udp/limits.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

Subscribe by_name(const std::string& filter, std::uint16_t msg_id, WireQos qos = WireQos::one) {
  return {false, qos, TopicIdType::normal, msg_id, filter, 0};
}
Unsubscribe not_by_name(const std::string& filter, std::uint16_t msg_id) {
  return {TopicIdType::normal, msg_id, filter, 0};
}

TEST(SnGateway, R94_GrantsANameWithItsId) {
  ConnectedRig rig;
  for (const unsigned qos : {0U, 1U, 2U}) {
    rig.send(1, by_name("a/" + std::to_string(qos), 7, static_cast<WireQos>(qos)));
    EXPECT_EQ(rig.last_to(1), "SUBACK qos=" + std::to_string(qos) +
                                  " id=" + std::to_string(qos + 1) + " msg=7 code=0");
    EXPECT_EQ(rig.subscribes.back().qos, static_cast<Qos>(qos));
  }
}

TEST(SnGateway, R95_GrantsAWildcardWithId0) {
  ConnectedRig rig;
  rig.send(1, by_name("a/#", 7));
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=1 id=0 msg=7 code=0");
  rig.send(1, by_name("a/+/b", 8));
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=1 id=0 msg=8 code=0");
}

TEST(SnGateway, R96_TakesPredefinedIdsAndShortNames) {
  Settings settings;
  settings.predefined_topics = {{7, "a/seven", {}}};
  ConnectedRig rig(settings);
  rig.send_octets(1, hex("07 12 21 00 0d 00 07"));
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=1 id=7 msg=13 code=0");
  rig.send_octets(1, hex("07 12 21 00 0e 00 08"));
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=14 code=2");
  rig.send_octets(1, hex("07 12 02 00 0f 61 62"));
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=15 code=0");
  rig.send_octets(1, hex("07 12 03 00 10 61 62"));
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=16 code=3");
}

TEST(SnGateway, R97_RefusesInvalidFiltersAndQos) {
  ConnectedRig rig;
  for (const std::string& filter :
       {std::string("a+"), std::string("#/a"), std::string("a/\0", 3), std::string("a/\xff"),
        std::string("not/allowed"), "a/" + std::string(200, '/')}) {
    rig.send(1, by_name(filter, 7));
    EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=7 code=3") << filter;
  }
  rig.send_octets(1, hex("08 12 60 00 0a 61 2f 62"));
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=10 code=3");
  EXPECT_TRUE(rig.subscribes.empty());
  ASSERT_EQ(rig.notices.size(), 1U);
  EXPECT_NE(rig.notices[0].text.find("topics.extra_subscribe"), std::string::npos);
}

TEST(SnGateway, R98_SendsSubackBeforeMessagesOfTheSubscription) {
  ConnectedRig rig;
  rig.answers_subscribes = false;
  rig.send(1, by_name("a/x", 7));
  rig.broker("a/x", "old", 0, true);
  rig.broker("a/x", "new", 0);
  EXPECT_TRUE(rig.is_silent(1));
  rig.subscribe_result("a/x", true);
  EXPECT_EQ(rig.sent_to(1), (Lines{"SUBACK qos=1 id=1 msg=7 code=0",
                                   "PUBLISH dup=0 qos=0 retain=1 normal id=1 msg=0 data=6f6c64",
                                   "PUBLISH dup=0 qos=0 retain=0 normal id=1 msg=0 data=6e6577"}));
}

TEST(SnGateway, R99_AnswersARepeatedSubscribe) {
  ConnectedRig rig;
  rig.answers_subscribes = false;
  rig.send(1, by_name("a/x", 7));
  rig.send(1, by_name("a/x", 7));
  EXPECT_EQ(rig.subscribes.size(), 1U) << "the first SUBSCRIBE is still open";
  rig.subscribe_result("a/x", true);
  EXPECT_EQ(rig.sent_to(1), Lines{"SUBACK qos=1 id=1 msg=7 code=0"});
  rig.send(1, by_name("a/x", 7));  // SUBACK was lost
  EXPECT_EQ(rig.sent_to(1), Lines{"SUBACK qos=1 id=1 msg=7 code=0"});
  EXPECT_EQ(rig.subscribes.size(), 1U);
  rig.answers_subscribes = true;
  rig.send(1, by_name("a/x", 8, WireQos::zero));
  EXPECT_EQ(rig.sent_to(1), Lines{"SUBACK qos=0 id=1 msg=8 code=0"});
  rig.broker("a/x", "hi", 1);
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBLISH dup=0 qos=0 retain=0 normal id=1 msg=0 data=6869"});
}

TEST(SnGateway, R100_RefusesASubscribeWhenFullOrRefusedByTheBroker) {
  Settings settings;
  settings.when_full = WhenFull::reject;
  ConnectedRig rig(settings);
  rig.answers_subscribes = false;
  rig.send(1, by_name("a/no", 7));
  rig.subscribe_result("a/no", false);
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=7 code=3");
  rig.broker("a/no");
  EXPECT_TRUE(rig.is_silent(1));
  rig.answers_subscribes = true;
  rig.pass(limits::subscribe_interval);
  for (std::size_t i = 0; i < limits::max_subscriptions_per_client; ++i)
    rig.subscribe(1, "a/" + std::to_string(i));
  rig.send(1, by_name("a/one-more", 8));
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=8 code=1");
  ASSERT_EQ(rig.notices.size(), 1U);
  EXPECT_NE(rig.notices[0].text.find("no room for 'a/one-more'"), std::string::npos);
  EXPECT_EQ(rig.counter("topics_refused"), 1U);
}

TEST(SnGateway, R100_EndsASubscriptionThatTheBrokerRefusesLate) {
  ConnectedRig rig;
  rig.subscribe(1, "a/x");
  rig.subscribe_result("a/x", false);  // granted while the broker was away
  rig.broker("a/x");
  EXPECT_TRUE(rig.is_silent(1));
  rig.answers_subscribes = false;
  rig.send(1, by_name("a/x", 9));
  rig.subscribe_result("a/x", false);
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=9 code=3");
}

TEST(SnGateway, R100_AnswersARefusalToAllRequestsOfThatRobotOnly) {
  ConnectedRig rig;
  rig.connect(2, "r2");
  rig.answers_subscribes = false;
  for (const unsigned n : {1U, 2U}) rig.send(n, by_name("a/no", 7));
  rig.send(1, by_name("a/no", 8, WireQos::zero));
  rig.gateway.on_subscribe_result("r1", "a/no", false, rig.now);
  rig.gateway.on_subscribe_result("r2", "a/no", true, rig.now);
  rig.gateway.on_subscribe_result("r3", "a/no", true, rig.now);
  rig.broker_link(true);  // drains
  EXPECT_EQ(rig.sent_to(1),
            (Lines{"SUBACK qos=0 id=0 msg=7 code=3", "SUBACK qos=0 id=0 msg=8 code=3"}));
  EXPECT_EQ(rig.sent_to(2), Lines{"SUBACK qos=1 id=1 msg=7 code=0"});
  rig.broker("a/no");
  EXPECT_TRUE(rig.is_silent(1));
}

TEST(SnGateway, R101_UnsubscribesAtTheBrokerForEachRobot) {
  SnRig rig;
  for (unsigned n = 1; n <= 2; ++n) {
    rig.connect(n, "r" + std::to_string(n));
    rig.subscribe(n, "a/x");
  }
  EXPECT_EQ(rig.subscribes.size(), 2U) << "each robot has its own";
  rig.send(1, not_by_name("a/x", 1));
  ASSERT_EQ(rig.unsubscribes.size(), 1U);
  EXPECT_EQ(rig.unsubscribes[0].robot, "r1");
  EXPECT_EQ(rig.unsubscribes[0].filter, "a/x");
  rig.send(2, Disconnect{});
  ASSERT_EQ(rig.unsubscribes.size(), 2U);
  EXPECT_EQ(rig.unsubscribes[1].robot, "r2");
}

/// The robot's session at the broker may have filters from another gateway.
TEST(SnGateway, R101_UnsubscribesAFilterThatIsNotKnownHere) {
  ConnectedRig rig(false);
  rig.send(1, not_by_name("a/x", 1));
  EXPECT_EQ(rig.last_to(1), "UNSUBACK msg=1");
  ASSERT_EQ(rig.unsubscribes.size(), 1U);
  EXPECT_EQ(rig.unsubscribes[0].filter, "a/x");
  for (const std::string filter : {"ntnu-slam/fleet/robots/r1/waiting", "a/#/x", ""})
    rig.send(1, not_by_name(filter, 2));
  EXPECT_EQ(rig.unsubscribes.size(), 1U) << "no client can have subscribed to these";
}

TEST(SnGateway, BoundsUnsubscribesOfUnknownFilters) {
  ConnectedRig rig(false);
  for (unsigned i = 0; i < limits::subscribe_burst + 5; ++i)
    rig.send(1, not_by_name("a/" + std::to_string(i), 1));
  EXPECT_EQ(rig.unsubscribes.size(), limits::subscribe_burst);
  EXPECT_EQ(rig.sent_to(1).size(), limits::subscribe_burst + 5) << "each is answered";
}

TEST(SnGateway, R102_DeliversARetainedMessageWithItsRetainFlag) {
  ConnectedRig rig;
  rig.subscribe(1, "a/x", 0);
  rig.broker("a/x", "kept", 0, true);
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBLISH dup=0 qos=0 retain=1 normal id=1 msg=0 data=6b657074"});
}

TEST(SnGateway, DeliversAMessageOnlyToItsRobot) {
  SnRig rig;
  for (const unsigned n : {1U, 2U}) {
    rig.connect(n, "r" + std::to_string(n));
    rig.subscribe(n, "a/x", 0);
  }
  rig.robot_message({"r2", {"a/x", to_bytes("hi"), Qos::at_least_once}});
  rig.robot_message({"nobody", {"a/x", to_bytes("hi"), Qos::at_least_once}});
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(rig.sent_to(2).size(), 1U);
}

/// The broker keeps the subscriptions of a robot that moved here, even if their note is lost.
TEST(SnGateway, DeliversMessagesOfAKeptSessionWithoutKnownFilters) {
  ConnectedRig rig(false);
  rig.robot_message({"r1", {"a/x", to_bytes("hi"), Qos::exactly_once}});
  EXPECT_EQ(rig.last_to(1), "REGISTER id=1 msg=1 topic=a/x");
  rig.send(1, Regack{1, 1, ReturnCode::accepted});
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=0 qos=2 retain=0 normal id=1 msg=2 data=6869");
  rig.send(1, Puback{1, 2, ReturnCode::accepted});
  rig.robot_message({"r1", {"not/allowed", to_bytes("hi"), Qos::at_least_once}});
  rig.robot_message({"r1", {"a/y", to_bytes("hi"), Qos::at_least_once}, {}, /*is_unasked=*/true});
  EXPECT_TRUE(rig.is_silent(1));
  rig.connect(2, "r2", true);
  rig.robot_message({"r2", {"a/x", to_bytes("hi"), Qos::at_least_once}});
  EXPECT_TRUE(rig.is_silent(2)) << "a clean session has only its own subscriptions";
}

TEST(SnGateway, R103_DeliversOnceForOverlappingFilters) {
  ConnectedRig rig;
  rig.subscribe(1, "a/#", 0);
  rig.subscribe(1, "a/x", 1);
  rig.subscribe(1, "a/+", 0);
  rig.broker("a/x", "hi", 1);
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBLISH dup=0 qos=1 retain=0 normal id=1 msg=1 data=6869"});
  rig.send(1, Puback{1, 1, ReturnCode::accepted});
  EXPECT_TRUE(rig.is_silent(1));
}

TEST(SnGateway, R103_DeliversEachOfTwoEqualMessages) {
  ConnectedRig rig;
  rig.subscribe(1, "a/x", 0);
  rig.subscribe(1, "a/#", 0);
  rig.broker("a/x", "hi");
  rig.broker("a/x", "hi");
  EXPECT_EQ(rig.sent_to(1).size(), 2U) << "the core removes copies";
}

TEST(SnGateway, R104_UnsubscribesByEachKindOfTopicAndAlwaysAnswers) {
  Settings settings;
  settings.predefined_topics = {{7, "a/seven", {}}};
  SnRig rig(settings);
  rig.connect(1, "r1", true, 600);
  rig.subscribe(1, "a/x", 1);
  rig.subscribe(1, "a/seven", 0);
  rig.subscribe(1, "ab", 0);
  rig.broker("a/x", "1", 1);
  rig.broker("a/x", "2", 1);  // waits behind the first
  rig.sent_to(1);
  rig.send(1, not_by_name("a/x", 1));
  rig.send_octets(1, hex("07 14 01 00 10 00 07"));
  rig.send_octets(1, hex("07 14 02 00 11 61 62"));
  rig.send(1, not_by_name("a/never", 4));
  EXPECT_EQ(rig.sent_to(1),
            (Lines{"UNSUBACK msg=1", "UNSUBACK msg=16", "UNSUBACK msg=17", "UNSUBACK msg=4"}));
  rig.send(1, Puback{1, 1, ReturnCode::accepted});
  for (const char* topic : {"a/x", "a/seven", "ab"}) rig.broker(topic);
  EXPECT_TRUE(rig.is_silent(1));
}

TEST(SnGateway, R104_AnswersASubscribeThatItsUnsubscribeOvertook) {
  ConnectedRig rig;
  rig.answers_subscribes = false;
  rig.send(1, by_name("a/x", 7));
  rig.send(1, not_by_name("a/x", 8));
  EXPECT_EQ(rig.sent_to(1), (Lines{"SUBACK qos=1 id=1 msg=7 code=0", "UNSUBACK msg=8"}));
  rig.subscribe_result("a/x", true);  // late
  rig.broker("a/x");
  EXPECT_TRUE(rig.is_silent(1));
}

TEST(SnGateway, R100_BoundsTheRateOfSubscribes) {
  Settings settings;
  settings.when_full = WhenFull::reject;
  SnRig rig(settings);
  rig.connect(1, "bad", true, 6000);
  for (std::uint16_t i = 1; i <= 1200; ++i) {  // 20 a second for a minute
    rig.send(1, by_name("a/#", i));
    if (i % 3 == 0) rig.send(1, not_by_name("a/#", i));
    rig.pass(std::chrono::milliseconds(50));
  }
  EXPECT_LE(rig.subscribes.size(), limits::subscribe_burst + 61U) << "of 1200";
  EXPECT_EQ(rig.last_to(1), "UNSUBACK msg=1200");
  for (std::uint16_t i = 2998; i <= 3000; ++i) rig.send(1, by_name("a/#", i));
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=3000 code=1");
  EXPECT_GT(rig.counter("subscribes_bounded"), 900U);
}

TEST(SnGateway, R100_LetsAClientMakeAllItsSubscriptionsAtOnce) {
  ConnectedRig rig;
  for (std::size_t i = 0; i < limits::max_subscriptions_per_client; ++i)
    rig.send(1, by_name("a/" + std::to_string(i), static_cast<std::uint16_t>(i + 1)));
  EXPECT_EQ(rig.sent_to(1).size(), limits::max_subscriptions_per_client);
}

TEST(SnGateway, R105_DeliversToAClientItsOwnMessages) {
  ConnectedRig rig;
  const auto id = rig.register_topic(1, "ntnu-slam/robot/r1/adv");
  rig.subscribe(1, "ntnu-slam/robot/r1/adv", 0);
  rig.publish(1, id, 0, 0, "me");
  rig.broker(rig.reports.at(0).topic, "me");
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=0 qos=0 retain=0 normal id=1 msg=0 data=6d65");
}

}  // namespace
}  // namespace slamgw::mqttsn
