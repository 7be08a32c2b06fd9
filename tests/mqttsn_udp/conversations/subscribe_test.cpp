// SPDX-License-Identifier: Apache-2.0
// Subscribing, and what one shared broker connection makes hard (R94-R105).
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
  SnRig rig;
  rig.connect(1, "r1");
  for (const unsigned qos : {0U, 1U, 2U}) {
    rig.send(1, by_name("a/" + std::to_string(qos), 7, static_cast<WireQos>(qos)));
    EXPECT_EQ(rig.last_to(1), "SUBACK qos=" + std::to_string(qos) +
                                  " id=" + std::to_string(qos + 1) + " msg=7 code=0");
    EXPECT_EQ(rig.subscribes.back().qos, static_cast<Qos>(qos));
  }
}

TEST(SnGateway, R95_GrantsAWildcardWithId0) {
  SnRig rig;
  rig.connect(1, "r1");
  rig.send(1, by_name("a/#", 7));
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=1 id=0 msg=7 code=0");
  rig.send(1, by_name("a/+/b", 8));
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=1 id=0 msg=8 code=0");
}

TEST(SnGateway, R96_TakesPredefinedIdsAndShortNames) {
  Settings settings;
  settings.predefined_topics = {{7, "a/seven", {}}};
  SnRig rig(settings);
  rig.connect(1, "r1");
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
  SnRig rig;
  rig.connect(1, "r1");
  for (const std::string& filter :
       {std::string("a+"), std::string("#/a"), std::string("a/\0", 3), std::string("a/\xff"),
        std::string("not/allowed"), "a/" + std::string(64, '/')}) {
    rig.send(1, by_name(filter, 7));
    EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=7 code=3") << filter;
  }
  rig.send_octets(1, hex("08 12 60 00 0a 61 2f 62"));
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=10 code=3");
  EXPECT_TRUE(rig.subscribes.empty());
  ASSERT_EQ(rig.notices.size(), 1U);
  EXPECT_NE(rig.notices[0].text.find("topics.extra_subscribe"), std::string::npos);
}

TEST(SnGateway, R98_SendsSubackBeforeWhatTheSubscriptionCauses) {
  SnRig rig;
  rig.connect(1, "r1");
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

TEST(SnGateway, R99_TakesTheSameSubscribeAgain) {
  SnRig rig;
  rig.connect(1, "r1");
  rig.answers_subscribes = false;
  rig.send(1, by_name("a/x", 7));
  rig.send(1, by_name("a/x", 7));
  EXPECT_EQ(rig.subscribes.size(), 1U) << "the first one still waits";
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

TEST(SnGateway, R100_RefusesWithoutRoomAndWhenTheBrokerDoes) {
  Settings settings;
  settings.when_full = WhenFull::reject;
  SnRig rig(settings);
  rig.connect(1, "r1");
  rig.answers_subscribes = false;
  rig.send(1, by_name("a/no", 7));
  rig.subscribe_result("a/no", false);
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=7 code=3");
  rig.broker("a/no");
  EXPECT_TRUE(rig.is_silent(1));
  rig.answers_subscribes = true;
  for (std::size_t i = 0; i < limits::max_subscriptions_per_client; ++i)
    rig.subscribe(1, "a/" + std::to_string(i));
  rig.send(1, by_name("a/one-more", 8));
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=8 code=1");
}

TEST(SnGateway, R100_ARefusalThatComesLateEndsTheSubscriptionAndIsToldAtTheNextRequest) {
  SnRig rig;
  rig.connect(1, "r1");
  rig.subscribe(1, "a/x");
  rig.subscribe_result("a/x", false);  // granted while the broker was away
  rig.broker("a/x");
  EXPECT_TRUE(rig.is_silent(1));
  rig.answers_subscribes = false;
  rig.send(1, by_name("a/x", 9));
  rig.subscribe_result("a/x", false);
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=9 code=3");
}

TEST(SnGateway, R100_ARefusalIsNotToldAsAGrantToThoseWhoStillWait) {
  SnRig rig;
  for (unsigned n = 1; n <= 3; ++n) rig.connect(n, "r" + std::to_string(n));
  rig.answers_subscribes = false;
  for (unsigned n = 1; n <= 3; ++n) rig.send(n, by_name("a/no", 7));
  rig.send(1, by_name("a/no", 8));
  rig.subscribe_result("a/no", false);
  EXPECT_EQ(rig.sent_to(1), Lines{"SUBACK qos=0 id=0 msg=7 code=3"});
  EXPECT_TRUE(rig.is_silent(2)) << "the broker's answer to its own request is still to come";
  EXPECT_TRUE(rig.unsubscribes.empty());
  ASSERT_EQ(rig.subscribes.size(), 2U);
  rig.subscribe_result("a/no", false);
  EXPECT_EQ(rig.sent_to(1), Lines{"SUBACK qos=0 id=0 msg=8 code=3"});
  for (const unsigned n : {2U, 3U})
    EXPECT_EQ(rig.sent_to(n), Lines{"SUBACK qos=0 id=0 msg=7 code=3"});
  EXPECT_EQ(rig.unsubscribes.size(), 1U);
  rig.broker("a/no");
  for (unsigned n = 1; n <= 3; ++n) EXPECT_TRUE(rig.is_silent(n));
}

TEST(SnGateway, R101_EndsASubscriptionWithItsLastClient) {
  SnRig rig;
  for (unsigned n = 1; n <= 3; ++n) {
    rig.connect(n, "r" + std::to_string(n));
    rig.subscribe(n, "a/x");
  }
  rig.send(1, not_by_name("a/x", 1));
  rig.send(2, Disconnect{});
  EXPECT_TRUE(rig.unsubscribes.empty());
  rig.send(3, not_by_name("a/x", 1));
  ASSERT_EQ(rig.unsubscribes.size(), 1U);
  EXPECT_EQ(rig.unsubscribes[0].filter, "a/x");
}

TEST(SnGateway, R102_GivesRetainedMessagesToTheNewSubscriberOnly) {
  SnRig rig;
  rig.connect(1, "r1");
  rig.connect(2, "r2");
  rig.subscribe(1, "a/x", 0);
  rig.broker("a/x", "kept", 0, true);
  EXPECT_EQ(rig.sent_to(1).size(), 1U);
  rig.subscribe(2, "a/x", 0);
  EXPECT_EQ(rig.subscribes.size(), 2U) << "asked again, so the broker sends them again";
  rig.broker("a/x", "kept", 0, true);
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(rig.sent_to(2), Lines{"PUBLISH dup=0 qos=0 retain=1 normal id=1 msg=0 data=6b657074"});
  rig.broker("a/x", "kept", 0, true);
  EXPECT_TRUE(rig.is_silent(2)) << "each topic once";
}

TEST(SnGateway, R102_StopsWaitingForRetainedMessages) {
  SnRig rig;
  rig.connect(1, "r1");
  rig.subscribe(1, "a/#", 0);
  rig.pass_s(11);
  rig.broker("a/x", "kept", 0, true);
  EXPECT_TRUE(rig.is_silent(1));
  rig.broker_link(false);
  rig.subscribe(1, "a/y", 0);
  rig.pass_s(60);
  rig.broker_link(true);  // only now does the broker hear of it
  rig.pass_s(1);
  rig.broker("a/y", "kept", 0, true);
  EXPECT_FALSE(rig.is_silent(1));
}

TEST(SnGateway, R102_WaitsAnewForRetainedMessagesThatABrokenConnectionHasLost) {
  SnRig rig;
  rig.connect(1, "r1");
  rig.subscribe(1, "a/x", 0);
  rig.pass_s(5);
  rig.broker_link(false);
  rig.pass_s(60);
  rig.broker_link(true);
  rig.broker("a/x", "kept", 0, true);
  EXPECT_FALSE(rig.is_silent(1));
  rig.broker_link(false);
  rig.broker_link(true);
  rig.broker("a/x", "kept", 0, true);
  EXPECT_TRUE(rig.is_silent(1)) << "each topic once";
}

TEST(SnGateway, R103_DeliversOnceForOverlappingFilters) {
  SnRig rig;
  rig.connect(1, "r1");
  rig.subscribe(1, "a/#", 0);
  rig.subscribe(1, "a/x", 1);
  rig.subscribe(1, "a/+", 0);
  rig.broker("a/x", "hi", 1);
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBLISH dup=0 qos=1 retain=0 normal id=1 msg=1 data=6869"});
  rig.send(1, Puback{1, 1, ReturnCode::accepted});
  EXPECT_TRUE(rig.is_silent(1));
}

TEST(SnGateway, R103_TakesEqualMessagesForSeveral) {
  SnRig rig;
  rig.connect(1, "r1");
  rig.subscribe(1, "a/x", 0);
  rig.subscribe(1, "a/#", 0);
  rig.broker("a/x", "hi");
  rig.broker("a/x", "hi");
  EXPECT_EQ(rig.sent_to(1).size(), 2U) << "copies are the core's concern";
}

TEST(SnGateway, R104_UnsubscribesInEveryWayAndAlwaysAnswers) {
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
  SnRig rig;
  rig.connect(1, "r1");
  rig.answers_subscribes = false;
  rig.send(1, by_name("a/x", 7));
  rig.send(1, not_by_name("a/x", 8));
  EXPECT_EQ(rig.sent_to(1), (Lines{"SUBACK qos=1 id=1 msg=7 code=0", "UNSUBACK msg=8"}));
  rig.subscribe_result("a/x", true);  // late
  rig.broker("a/x");
  EXPECT_TRUE(rig.is_silent(1));
}

/// The broker's half: how often it was asked for `a/#`, and so sent all its retained messages.
std::size_t requests(const SnRig& rig) { return rig.subscribes.size(); }

TEST(SnGateway, R102_AsksTheBrokerOnceForAllWhoSubscribeMeanwhile) {
  SnRig rig;
  for (unsigned n = 1; n <= 20; ++n) rig.connect(n, "r" + std::to_string(n));
  rig.answers_subscribes = false;
  for (unsigned n = 1; n <= 20; ++n) rig.send(n, by_name("a/#", 7));
  EXPECT_EQ(requests(rig), 1U);
  rig.subscribe_result("a/#", true);
  EXPECT_EQ(rig.sent_to(1), Lines{"SUBACK qos=1 id=0 msg=7 code=0"});
  EXPECT_TRUE(rig.is_silent(2)) << "its retained messages come with the next request";
  EXPECT_EQ(requests(rig), 2U) << "one for the other 19";
  rig.subscribe_result("a/#", true);
  rig.broker("a/x", "kept", 0, true);
  EXPECT_EQ(requests(rig), 2U);
  for (unsigned n = 2; n <= 20; ++n) {
    EXPECT_EQ(rig.sent_to(n),
              (Lines{"SUBACK qos=1 id=0 msg=7 code=0", "REGISTER id=1 msg=1 topic=a/x"}));
  }
}

TEST(SnGateway, R102_AsksWithTheHighestQosOfThoseWhoShareARequest) {
  SnRig rig;
  for (unsigned n = 1; n <= 3; ++n) rig.connect(n, "r" + std::to_string(n));
  rig.answers_subscribes = false;
  rig.send(1, by_name("a/#", 7, WireQos::zero));
  rig.send(2, by_name("a/#", 7, WireQos::two));
  rig.send(3, by_name("a/#", 7, WireQos::one));
  rig.subscribe_result("a/#", true);
  ASSERT_EQ(requests(rig), 2U);
  EXPECT_EQ(rig.subscribes[1].qos, Qos::exactly_once);
}

TEST(SnGateway, R100_BoundsTheRateOfSubscribes) {
  Settings settings;
  settings.when_full = WhenFull::reject;
  SnRig rig(settings);
  rig.connect(1, "bad", true, 6000);
  rig.connect(2, "good", true, 6000);
  for (std::uint16_t i = 1; i <= 1200; ++i) {  // 20 a second for a minute
    rig.send(1, by_name("a/#", i));
    if (i % 3 == 0) rig.send(1, not_by_name("a/#", i));
    rig.pass(std::chrono::milliseconds(50));
  }
  const std::size_t of_one = requests(rig);
  EXPECT_LE(of_one, limits::broker_subscribe_burst + 32U) << "was 1200";
  EXPECT_EQ(rig.last_to(1), "UNSUBACK msg=1200");
  for (std::uint16_t i = 2998; i <= 3000; ++i) rig.send(1, by_name("a/#", i));
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=3000 code=1");
  EXPECT_GT(rig.counter("subscribes_bounded"), 900U);
  rig.send(2, by_name("a/#", 7));
  rig.pass_s(2);
  EXPECT_EQ(rig.sent_to(2), Lines{"SUBACK qos=1 id=0 msg=7 code=0"}) << "another waits shortly";
}

TEST(SnGateway, R100_LetsAClientMakeAllItsSubscriptionsAtOnce) {
  SnRig rig;
  rig.connect(1, "r1");
  for (std::size_t i = 0; i < limits::max_subscriptions_per_client; ++i)
    rig.send(1, by_name("a/" + std::to_string(i), static_cast<std::uint16_t>(i + 1)));
  EXPECT_EQ(rig.sent_to(1).size(), limits::max_subscriptions_per_client);
}

TEST(SnGateway, R105_GivesAClientItsOwnMessages) {
  SnRig rig;
  rig.connect(1, "r1");
  const auto id = rig.register_topic(1, "ntnu-slam/robot/r1/adv");
  rig.subscribe(1, "ntnu-slam/robot/r1/adv", 0);
  rig.publish(1, id, 0, 0, "me");
  rig.broker(rig.reports.at(0).topic, "me");
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=0 qos=0 retain=0 normal id=1 msg=0 data=6d65");
}

}  // namespace
}  // namespace slamgw::mqttsn
