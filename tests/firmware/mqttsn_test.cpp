// SPDX-License-Identifier: Apache-2.0
// slam_mqttsn.h, octet by octet: it sends the vectors of tests/vectors.
#include <gtest/gtest.h>

#include <algorithm>

#include "tests/firmware/sn_robot.hpp"
#include "tests/vectors/mqttsn_vectors.hpp"

extern "C" std::size_t c99_connect(std::uint8_t* out, std::size_t capacity);

namespace slamgw::firmware {
namespace {

using Hex = std::vector<std::string>;

std::string vector_named(std::string_view name) {
  for (const auto& vector : mqttsn::message_vectors)
    if (vector.name == name) return to_hex(hex(vector.wire));
  ADD_FAILURE() << "no vector " << name;
  return "";
}

TEST(SnClient, ConnectsRegistersAndPublishes) {
  SnRobot robot;
  robot.start();
  EXPECT_EQ(robot.sent(), Hex{vector_named("CONNECT-clean-60s-r1")});
  robot.hear("03 05 00");
  EXPECT_FALSE(slam_sn_is_ready(&robot.client));
  EXPECT_EQ(robot.sent(), Hex{vector_named("REGISTER-from-client-a/b")});
  robot.hear("07 0b 00 05 00 01 00");
  EXPECT_TRUE(slam_sn_is_ready(&robot.client));
  EXPECT_TRUE(robot.publish(SLAM_SN_QOS0));
  EXPECT_EQ(robot.sent(), Hex{vector_named("PUBLISH-q0-normal-id5-hi")});
  EXPECT_TRUE(robot.publish(SLAM_SN_QOS0 | SLAM_SN_RETAIN));
  EXPECT_EQ(robot.sent(), Hex{vector_named("PUBLISH-q0-retain")});
}

TEST(SnClient, SendsItsWillWhenAsked) {
  SnRobot robot;
  robot.settings.will_topic = "w/1";
  robot.settings.will_message = "dead";
  robot.settings.will_flags = SLAM_SN_QOS1 | SLAM_SN_RETAIN;
  robot.start();
  EXPECT_EQ(robot.sent(), Hex{vector_named("CONNECT-will-clean-60s-r1")});
  robot.hear("02 06");
  EXPECT_EQ(robot.sent(), Hex{vector_named("WILLTOPIC-q1-retain-w/1")});
  robot.hear("02 08");
  EXPECT_EQ(robot.sent(), Hex{vector_named("WILLMSG-dead")});
  robot.hear("02 06");  // a repeat
  EXPECT_EQ(robot.sent(), Hex{vector_named("WILLTOPIC-q1-retain-w/1")});
  robot.settings.will_message = nullptr;
  robot.hear("02 08");
  EXPECT_EQ(robot.sent(), Hex{vector_named("WILLMSG-empty")});
}

TEST(SnClient, RepeatsConnectUntilAGatewayAnswers) {
  SnRobot robot;
  robot.settings.retry_ms = 2000;
  robot.start();
  const auto sent = robot.pass(60000);
  ASSERT_EQ(sent.size(), 31U);
  for (std::size_t i = 0; i < sent.size(); ++i)
    EXPECT_EQ(sent[i], (SnRobot::Sent{static_cast<std::uint32_t>(2000 * i),
                                      vector_named("CONNECT-clean-60s-r1")}));
}

TEST(SnClient, WaitsLongerBeforeItReconnectsAfterARefusal) {
  SnRobot robot;
  robot.start();
  robot.sent();
  const auto event = robot.hear("03 05 01");
  EXPECT_EQ(event.kind, SLAM_SN_REFUSED);
  EXPECT_EQ(event.code, SLAM_SN_CONGESTION);
  EXPECT_EQ(event.topic, SLAM_SN_NO_TOPIC);
  EXPECT_TRUE(robot.pass(SLAM_SN_CONGESTION_MS - 1).empty());
  EXPECT_EQ(robot.pass(1).size(), 1U);
}

TEST(SnClient, SubscribesByEachKindOfTopic) {
  SnRobot robot({{"a/b", 0, SLAM_SN_SUBSCRIBE | SLAM_SN_QOS1},
                 {"a/#", 0, SLAM_SN_SUBSCRIBE},
                 {nullptr, 7, SLAM_SN_SUBSCRIBE | SLAM_SN_QOS1 | SLAM_SN_PREDEFINED},
                 {"ab", 0, SLAM_SN_SUBSCRIBE | SLAM_SN_SHORT}});
  robot.start(9);
  robot.sent();
  robot.hear("03 05 00");
  EXPECT_EQ(robot.sent(), Hex{vector_named("SUBSCRIBE-name-q1-a/b")});
  robot.hear(vector_named("SUBACK-q1-id5"));
  EXPECT_EQ(robot.sent(), Hex{vector_named("SUBSCRIBE-name-q0-wild-a/#")});
  robot.hear(vector_named("SUBACK-wild-id0"));
  EXPECT_EQ(robot.sent(), Hex{"071221000c0007"});
  robot.hear("08 13 20 00 07 00 0c 00");
  EXPECT_EQ(robot.sent(), Hex{"071202000d6162"});
  robot.hear("08 13 00 00 00 00 0d 00");
  EXPECT_TRUE(slam_sn_is_ready(&robot.client));
}

TEST(SnClient, RepeatsSubscribeWithDup) {
  SnRobot robot({{"a/b", 0, SLAM_SN_SUBSCRIBE | SLAM_SN_QOS2}});
  robot.start(11);
  robot.sent();
  robot.hear("03 05 00");
  EXPECT_EQ(robot.sent(), Hex{"08124000"
                              "0c612f62"});
  robot.now += SLAM_SN_RETRY_MS;
  EXPECT_EQ(robot.sent(), Hex{vector_named("SUBSCRIBE-name-q2-dup")});
}

TEST(SnClient, ReportsWhichTopicWasRefused) {
  SnRobot robot({{"a/b", 0, 0}, {"c", 0, SLAM_SN_SUBSCRIBE}});
  robot.start();
  robot.sent();
  robot.hear("03 05 00");
  EXPECT_TRUE(robot.publish(SLAM_SN_QOS1));  // it waits for its topic
  robot.sent();
  const auto event = robot.hear("07 0b 00 00 00 02 03");
  EXPECT_EQ(event.kind, SLAM_SN_REFUSED);
  EXPECT_EQ(event.code, SLAM_SN_NOT_SUPPORTED);
  EXPECT_EQ(event.topic, 0);
  EXPECT_FALSE(slam_sn_is_publishing(&robot.client));
  EXPECT_FALSE(robot.publish(SLAM_SN_QOS1));
  EXPECT_EQ(robot.sent().size(), 1U) << "goes on to the next topic";
}

TEST(SnClient, PublishesWithEachKindOfTopicId) {
  SnRobot robot({{nullptr, 7, SLAM_SN_PREDEFINED}, {"ab", 0, SLAM_SN_SHORT}});
  robot.get_ready(2);
  EXPECT_TRUE(robot.publish(SLAM_SN_QOS0, "hi", 0));
  EXPECT_EQ(robot.sent(), Hex{vector_named("PUBLISH-q0-predef-id7")});
  EXPECT_TRUE(robot.publish(SLAM_SN_QOS0, "hi", 1));
  EXPECT_EQ(robot.sent(), Hex{vector_named("PUBLISH-q0-short-ab")});
  EXPECT_TRUE(robot.publish(SLAM_SN_QOS1, "hi", 0));
  EXPECT_EQ(robot.sent(), Hex{vector_named("PUBLISH-q1-predef-id7")});
}

TEST(SnClient, RepeatsQos1WithDupUntilPuback) {
  SnRobot robot;
  robot.get_ready(0xfffe);  // the CONNECT and the REGISTER have 0xfffe and 0xffff
  EXPECT_TRUE(robot.publish(SLAM_SN_QOS1));
  EXPECT_EQ(robot.sent(), Hex{vector_named("PUBLISH-q1-normal-id5-mid1-hi")}) << "no id 0";
  EXPECT_FALSE(robot.publish(SLAM_SN_QOS1)) << "one at a time";
  const auto repeats = robot.pass(2 * SLAM_SN_RETRY_MS + 1);
  ASSERT_EQ(repeats.size(), 2U);
  EXPECT_EQ(repeats[1], (SnRobot::Sent{2 * SLAM_SN_RETRY_MS, vector_named("PUBLISH-q1-dup")}));
  EXPECT_EQ(robot.hear("07 0d 00 05 00 02 00").kind, SLAM_SN_NOTHING) << "another id";
  const auto event = robot.hear(vector_named("PUBACK-ok"));
  EXPECT_EQ(event.kind, SLAM_SN_PUBLISHED);
  EXPECT_EQ(event.code, SLAM_SN_ACCEPTED);
  EXPECT_TRUE(robot.pass(SLAM_SN_RETRY_MS * 2).empty());
}

TEST(SnClient, PublishesQos2InBothHalves) {
  SnRobot robot;
  robot.get_ready(0xffff);
  EXPECT_TRUE(robot.publish(SLAM_SN_QOS2));
  EXPECT_EQ(robot.sent(), Hex{vector_named("PUBLISH-q2-normal")});
  robot.now += SLAM_SN_RETRY_MS;
  EXPECT_EQ(robot.sent(), Hex{vector_named("PUBLISH-q2-dup")});
  EXPECT_EQ(robot.hear(vector_named("PUBCOMP")).kind, SLAM_SN_NOTHING) << "too early";
  EXPECT_EQ(robot.hear(vector_named("PUBREC")).kind, SLAM_SN_NOTHING);
  EXPECT_EQ(robot.sent(), Hex{vector_named("PUBREL")});
  robot.now += SLAM_SN_RETRY_MS;
  EXPECT_EQ(robot.sent(), Hex{vector_named("PUBREL")});
  EXPECT_EQ(robot.hear(vector_named("PUBCOMP")).kind, SLAM_SN_PUBLISHED);
}

TEST(SnClient, RegistersATopicAgainThatTheGatewayForgot) {
  SnRobot robot;
  robot.get_ready();
  EXPECT_TRUE(robot.publish(SLAM_SN_QOS1));
  robot.sent();
  EXPECT_EQ(robot.hear("07 0d 00 05 00 02 02").kind, SLAM_SN_NOTHING);
  EXPECT_EQ(robot.sent(), Hex{"090a00000003612f62"});
  robot.hear("07 0b 00 09 00 03 00");
  const auto again = robot.pass(SLAM_SN_RETRY_MS);
  ASSERT_EQ(again.size(), 1U);
  EXPECT_EQ(again[0].octets, "090ca0000900026869") << "with the new id";
  // QoS 0 is refused with message id 0.
  robot.hear("07 0d 00 09 00 02 00");
  EXPECT_TRUE(robot.publish(SLAM_SN_QOS0));
  robot.sent();
  robot.hear("07 0d 00 09 00 00 02");
  EXPECT_EQ(robot.sent().size(), 1U);
}

TEST(SnClient, WaitsAfterACongestedPuback) {
  SnRobot robot;
  robot.settings.keep_alive_s = 6000;
  robot.get_ready();
  EXPECT_TRUE(robot.publish(SLAM_SN_QOS1));
  robot.sent();
  robot.hear("07 0d 00 05 00 02 01");
  EXPECT_TRUE(robot.pass(SLAM_SN_CONGESTION_MS - 1).empty());
  EXPECT_EQ(robot.pass(1).size(), 1U);
  const auto event = robot.hear("07 0d 00 05 00 02 03");
  EXPECT_EQ(event.kind, SLAM_SN_PUBLISHED);
  EXPECT_EQ(event.code, SLAM_SN_NOT_SUPPORTED);
}

TEST(SnClient, ReportsMessagesOfItsSubscriptions) {
  SnRobot robot({{"a/b", 0, SLAM_SN_SUBSCRIBE | SLAM_SN_QOS1}});
  robot.get_ready();
  auto event = robot.hear(vector_named("PUBLISH-q1-normal-id5-mid1-hi"));
  EXPECT_EQ(event.kind, SLAM_SN_MESSAGE);
  EXPECT_EQ(std::string(event.name, event.name_size), "a/b");
  EXPECT_EQ(as_text(ByteView(event.data, event.size)), "hi");
  EXPECT_EQ(event.topic, 0);
  EXPECT_TRUE(slam_sn_is_of_type(&event, "b"));
  EXPECT_FALSE(slam_sn_is_of_type(&event, "a"));
  EXPECT_FALSE(slam_sn_is_of_type(&event, "a/b"));
  EXPECT_EQ(robot.sent(), Hex{vector_named("PUBACK-ok")});

  EXPECT_EQ(robot.hear(vector_named("PUBLISH-q1-dup")).kind, SLAM_SN_NOTHING);
  EXPECT_EQ(robot.sent(), Hex{vector_named("PUBACK-ok")}) << "acknowledged, but not reported twice";
  EXPECT_EQ(robot.client.repeats, 1U);
  EXPECT_EQ(robot.hear(vector_named("PUBLISH-q0-normal-id5-hi")).kind, SLAM_SN_MESSAGE);
  EXPECT_TRUE(robot.sent().empty());
}

TEST(SnClient, ReportsAQos2MessageOnce) {
  SnRobot robot({{"a/b", 0, SLAM_SN_SUBSCRIBE | SLAM_SN_QOS2}});
  robot.get_ready();
  EXPECT_EQ(robot.hear(vector_named("PUBLISH-q2-normal")).kind, SLAM_SN_MESSAGE);
  EXPECT_EQ(robot.sent(), Hex{vector_named("PUBREC")});
  EXPECT_EQ(robot.hear(vector_named("PUBLISH-q2-normal")).kind, SLAM_SN_NOTHING)
      << "without DUP, too";
  EXPECT_EQ(robot.sent(), Hex{vector_named("PUBREC")});
  robot.hear(vector_named("PUBREL"));
  EXPECT_EQ(robot.sent(), Hex{vector_named("PUBCOMP")});
  robot.hear(vector_named("PUBREL"));
  EXPECT_EQ(robot.sent(), Hex{vector_named("PUBCOMP")});
}

TEST(SnClient, RecognizesALateCopyOfAQos2MessageAfterPubrel) {
  SnRobot robot({{"a/b", 0, SLAM_SN_SUBSCRIBE | SLAM_SN_QOS2}});
  robot.get_ready();
  EXPECT_EQ(robot.hear(vector_named("PUBLISH-q2-normal")).kind, SLAM_SN_MESSAGE);
  robot.sent();
  robot.hear(vector_named("PUBREL"));
  robot.sent();
  for (const std::string name : {"PUBLISH-q2-normal", "PUBLISH-q2-dup"}) {
    EXPECT_EQ(robot.hear(vector_named(name)).kind, SLAM_SN_NOTHING) << name;
    EXPECT_EQ(robot.sent(), Hex{vector_named("PUBREC")});
  }
  robot.sleep_and_wake();
  EXPECT_EQ(robot.hear(vector_named("PUBLISH-q2-normal")).kind, SLAM_SN_MESSAGE)
      << "a new message of a gateway whose ids begin again";
}

TEST(SnClient, LearnsTopicsOfAWildcard) {
  SnRobot robot({{"a/#", 0, SLAM_SN_SUBSCRIBE | SLAM_SN_QOS1}});
  robot.start();
  robot.sent();
  robot.hear("03 05 00");
  robot.sent();
  robot.hear("08 13 20 00 00 00 01 00");
  EXPECT_EQ(robot.hear(vector_named("PUBLISH-q0-normal-id5-hi")).kind, SLAM_SN_NOTHING);
  EXPECT_EQ(robot.sent(), Hex{"070d0005000002"}) << "code 2 (invalid topic id), at QoS 0 too";
  robot.hear(vector_named("REGISTER-from-gw-id5-a/b"));
  EXPECT_EQ(robot.sent(), Hex{"070b0005123400"});
  const auto event = robot.hear(vector_named("PUBLISH-q0-normal-id5-hi"));
  EXPECT_EQ(event.kind, SLAM_SN_MESSAGE);
  EXPECT_EQ(std::string(event.name, event.name_size), "a/b");
  EXPECT_EQ(event.topic, SLAM_SN_NO_TOPIC);
}

TEST(SnClient, ForgetsTheOldestTopicWhenItsTableIsFull) {
  SnRobot robot({{"a/#", 0, SLAM_SN_SUBSCRIBE}});
  robot.get_ready();
  const auto learn = [&](unsigned id) {
    robot.hear("08 0a 00 0" + std::to_string(id) + " 00 01 61 3" + std::to_string(id));
    robot.sent();
  };
  const auto recognizes = [&](unsigned id) {
    const bool is_heard =
        robot.hear("08 0c 00 00 0" + std::to_string(id) + " 00 00 21").kind == SLAM_SN_MESSAGE;
    robot.sent();
    return is_heard;
  };
  for (unsigned id = 6; id <= 9; ++id) learn(id);
  for (unsigned id = 6; id <= 9; ++id) EXPECT_TRUE(recognizes(id)) << id;
  learn(9);
  EXPECT_TRUE(recognizes(6)) << "a repeated topic takes no second place";
  learn(1);
  EXPECT_FALSE(recognizes(6));
  EXPECT_TRUE(recognizes(1));
  EXPECT_TRUE(recognizes(7));
  const std::string name(2 * (SLAM_SN_MAX_NAME + 1), '6');
  robot.hear(to_hex(Bytes{SLAM_SN_MAX_NAME + 7}) + "0a 00 02 00 01" + name);
  EXPECT_EQ(robot.sent(), Hex{"070b0002000103"});
}

TEST(SnClient, AcceptsAnOverlongNameOfAConfiguredTopic) {
  SnRobot robot;
  robot.get_ready();
  const std::string name(SLAM_SN_MAX_NAME + 10, 'x');
  robot.topics[0].name = name.c_str();
  robot.hear(to_hex(Bytes{SLAM_SN_MAX_NAME + 16}) + "0a 00 02 00 01" + to_hex(to_bytes(name)));
  EXPECT_EQ(robot.sent(), Hex{"070b0002000100"});
}

TEST(SnClient, PingsWhenTheGatewayIsSilentForTheKeepAlive) {
  SnRobot robot;
  robot.get_ready();
  EXPECT_TRUE(robot.pass(59999).empty());
  EXPECT_EQ(robot.pass(1), (std::vector<SnRobot::Sent>{{1, vector_named("PINGREQ-plain")}}));
  robot.hear("02 17");
  EXPECT_TRUE(robot.pass(59999).empty());
  robot.hear("02 16");
  EXPECT_EQ(robot.sent(), Hex{"0217"});
}

TEST(SnClient, ReconnectsWhenTheGatewayIsSilent) {
  SnRobot robot;
  robot.get_ready();
  const auto sent = robot.pass(110000);
  ASSERT_GE(sent.size(), 5U);
  for (std::size_t i = 0; i < 4; ++i)
    EXPECT_EQ(sent[i], (SnRobot::Sent{static_cast<std::uint32_t>(60000 + i * SLAM_SN_RETRY_MS),
                                      vector_named("PINGREQ-plain")}));
  EXPECT_EQ(sent[4].octets, vector_named("CONNECT-clean-60s-r1"));
  EXPECT_GE(sent[4].after_ms, 60000 + 4 * SLAM_SN_RETRY_MS + SLAM_SN_RECONNECT_MS);
  EXPECT_EQ(robot.client.lost, 1U);
}

TEST(SnClient, KeepsItsMessageOverAReconnect) {
  SnRobot robot;
  robot.get_ready();
  EXPECT_TRUE(robot.publish(SLAM_SN_QOS1));
  robot.sent();
  robot.hear("02 18");
  const auto sent = robot.pass(2 * SLAM_SN_RECONNECT_MS);
  ASSERT_EQ(sent.size(), 1U) << "only CONNECT, while the message waits";
  EXPECT_GE(sent[0].after_ms, SLAM_SN_RECONNECT_MS);
  robot.hear("03 05 00");
  EXPECT_EQ(robot.sent(), Hex{"090a00000004612f62"});
  robot.hear("07 0b 00 09 00 04 00");
  EXPECT_EQ(robot.sent(), Hex{"090ca0000900026869"})
      << "DUP, the same message id, the new topic id";
  EXPECT_EQ(robot.hear("07 0d 00 09 00 02 00").kind, SLAM_SN_PUBLISHED);
}

TEST(SnClient, StaysConnectedWhileOtherRequestsAreAnswered) {
  SnRobot robot({{"a/b", 0, 0}, {"c", 0, SLAM_SN_SUBSCRIBE}});
  robot.start();
  robot.sent();
  robot.hear("03 05 00");
  robot.sent();
  robot.hear("07 0b 00 05 00 01 00");
  for (int i = 0; i < 30; ++i) {  // the SUBSCRIBE waits for the broker
    ASSERT_TRUE(robot.publish(SLAM_SN_QOS1));
    robot.pass(5000);
    Bytes puback = hex("07 0d 00 05 00 00 00");
    puback[4] = static_cast<std::uint8_t>(robot.client.publish_id >> 8);
    puback[5] = static_cast<std::uint8_t>(robot.client.publish_id);
    ASSERT_EQ(robot.hear(to_hex(puback)).kind, SLAM_SN_PUBLISHED);
  }
  EXPECT_EQ(robot.client.lost, 0U);
}

/// The gateway may have started a second session, without the registered topics.
TEST(SnClient, RestartsTheSetupAfterASecondConnack) {
  SnRobot robot;
  robot.start();
  EXPECT_EQ(robot.pass(SLAM_SN_RETRY_MS).size(), 2U) << "CONNECT is repeated";
  robot.hear("03 05 00");
  robot.sent();
  robot.hear("07 0b 00 05 00 01 00");
  robot.hear("03 05 00");
  EXPECT_FALSE(slam_sn_is_ready(&robot.client));
  EXPECT_EQ(robot.sent().size(), 1U);
  robot.hear("03 05 00");
  EXPECT_TRUE(robot.sent().empty()) << "the third CONNACK answers no CONNECT";
}

TEST(SnClient, IgnoresAnUnexpectedConnack) {
  SnRobot robot;
  robot.get_ready();
  for (int i = 0; i < 100; ++i) robot.hear("03 05 00");
  EXPECT_TRUE(slam_sn_is_ready(&robot.client));
  EXPECT_TRUE(robot.sent().empty());
}

TEST(SnClient, FetchesQueuedMessagesWhileItSleeps) {
  SnRobot robot({{"a/b", 0, SLAM_SN_SUBSCRIBE | SLAM_SN_QOS1}});
  robot.get_ready();
  EXPECT_TRUE(slam_sn_sleep(&robot.client, robot.now, 300));
  EXPECT_EQ(robot.sent(), Hex{"04180155"}) << "300 s, and 41 s for repeats";
  EXPECT_FALSE(slam_sn_is_dozing(&robot.client));
  robot.hear("02 18");
  EXPECT_TRUE(slam_sn_is_dozing(&robot.client));
  EXPECT_EQ(slam_sn_wait_ms(&robot.client, robot.now), 300000U);
  EXPECT_EQ(robot.pass(300000),
            (std::vector<SnRobot::Sent>{{300000, vector_named("PINGREQ-clientid-r1")}}));
  for (int i = 0; i < 10; ++i) {  // many messages wait: the PINGRESP comes late
    robot.now += 9000;
    robot.hear("09 0c 20 00 05 00 1" + std::to_string(i) + " 68 69");
    EXPECT_EQ(robot.sent().size(), 1U);
  }
  robot.hear("02 17");
  EXPECT_TRUE(slam_sn_is_dozing(&robot.client));
  EXPECT_EQ(robot.client.lost, 0U);
}

TEST(SnClient, ResumesItsSessionWhenItWakes) {
  SnRobot robot;
  robot.get_ready();
  EXPECT_TRUE(slam_sn_sleep(&robot.client, robot.now, 10));
  robot.sent();
  robot.hear("02 18");
  slam_sn_wake(&robot.client, robot.now);
  EXPECT_EQ(robot.sent(), Hex{vector_named("CONNECT-noclean-60s-r1")});
  robot.hear("03 05 00");
  EXPECT_EQ(robot.sent().size(), 1U);
}

/// The gateway repeats a message after the next CONNECT when the client's answer was lost.
TEST(SnClient, RecognizesARepeatOfAMessageFromBeforeItsSleep) {
  for (const std::string qos : {"2", "4"}) {
    SnRobot robot({{"a/b", 0, SLAM_SN_SUBSCRIBE | SLAM_SN_QOS2}});
    robot.get_ready();
    EXPECT_EQ(robot.hear("09 0c " + qos + "0 00 05 00 07 68 69").kind, SLAM_SN_MESSAGE);
    robot.sent();
    robot.sleep_and_wake();
    const std::string dup = qos == "2" ? "a" : "c";
    EXPECT_EQ(robot.hear("09 0c " + dup + "0 00 05 00 07 68 69").kind, SLAM_SN_NOTHING);
    EXPECT_EQ(robot.sent().size(), 1U) << "the repeat is acknowledged";
    EXPECT_EQ(robot.client.repeats, 1U);
  }
}

TEST(SnClient, AcceptsANewMessageWithAnIdFromBeforeItsSleep) {
  SnRobot robot({{"a/b", 0, SLAM_SN_SUBSCRIBE | SLAM_SN_QOS2}});
  robot.get_ready();
  EXPECT_EQ(robot.hear("09 0c 40 00 05 00 01 68 69").kind, SLAM_SN_MESSAGE);
  robot.sent();
  robot.sleep_and_wake();
  EXPECT_EQ(robot.hear("09 0c 40 00 05 00 01 68 69").kind, SLAM_SN_MESSAGE)
      << "without DUP, from a gateway that has lost the session";
}

TEST(SnClient, RegistersATopicAgainAfterACongestedRegack) {
  SnRobot robot({{"a/b", 0, 0}, {"a/c", 0, SLAM_SN_SUBSCRIBE}});
  robot.start();
  robot.sent();
  robot.hear("03 05 00");
  const auto asked = robot.sent();
  ASSERT_EQ(asked.size(), 1U);
  EXPECT_TRUE(robot.publish(SLAM_SN_QOS1));
  EXPECT_EQ(robot.hear("070b0000" + asked[0].substr(8, 4) + "01").kind, SLAM_SN_REFUSED);
  EXPECT_FALSE(slam_sn_is_publishing(&robot.client));
  EXPECT_FALSE(robot.publish(SLAM_SN_QOS1));
  robot.answer_setup(5);  // the other topic
  EXPECT_TRUE(slam_sn_is_ready(&robot.client));
  std::vector<std::string> later;
  for (std::uint32_t s = 1; s < SLAM_SN_CONGESTION_MS / 1000; ++s) {
    for (const auto& each : robot.pass(1000)) later.push_back(each.octets);
    if (!later.empty()) robot.hear("02 17");
  }
  EXPECT_EQ(std::ranges::count(later, "0216"), std::ssize(later)) << "it only pings";
  EXPECT_GE(later.size(), 4U);
  robot.pass(999);
  ++robot.now;
  robot.answer_setup(6);
  EXPECT_TRUE(robot.publish(SLAM_SN_QOS1));
}

TEST(SnClient, PublishesWhileItSleeps) {
  SnRobot robot;
  robot.get_ready();
  EXPECT_TRUE(slam_sn_sleep(&robot.client, robot.now, 10));
  EXPECT_FALSE(slam_sn_sleep(&robot.client, robot.now, 10)) << "the first DISCONNECT is still open";
  robot.sent();
  robot.hear("02 18");
  EXPECT_TRUE(robot.publish(SLAM_SN_QOS1));
  EXPECT_FALSE(slam_sn_is_dozing(&robot.client));
  EXPECT_EQ(robot.sent().size(), 1U);
  EXPECT_EQ(robot.client.state, SLAM_SN_ASLEEP);
}

TEST(SnClient, DisconnectsAndCanConnectAgain) {
  SnRobot robot;
  robot.get_ready();
  slam_sn_disconnect(&robot.client, robot.now);
  EXPECT_EQ(robot.sent(), Hex{vector_named("DISCONNECT-plain")});
  EXPECT_EQ(robot.pass(100000).size(), 3U) << "repeats";
  EXPECT_EQ(robot.client.state, SLAM_SN_OFF);
  EXPECT_EQ(slam_sn_wait_ms(&robot.client, robot.now), UINT32_MAX);
  EXPECT_FALSE(robot.publish(SLAM_SN_QOS1));
  slam_sn_connect(&robot.client, robot.now);
  EXPECT_EQ(robot.sent().size(), 1U);
}

TEST(SnClient, WritesAndReadsTheThreeOctetLength) {
  SnRobot robot({{"a/b", 0, 0}, {"c", 0, SLAM_SN_SUBSCRIBE}});
  robot.get_ready();
  EXPECT_TRUE(robot.publish(SLAM_SN_QOS0, std::string(248, 'a')));
  EXPECT_EQ(robot.sent().at(0).substr(0, 4), "ff0c");
  EXPECT_TRUE(robot.publish(SLAM_SN_QOS0, std::string(249, 'a')));
  EXPECT_EQ(robot.sent().at(0).substr(0, 8), "0101020c");
  EXPECT_TRUE(robot.publish(SLAM_SN_QOS1, std::string(SLAM_SN_MAX_PAYLOAD, 'a')));
  EXPECT_EQ(robot.sent().at(0).size(), 2 * SLAM_SN_MAX_PACKET);
  EXPECT_FALSE(robot.publish(SLAM_SN_QOS0, std::string(SLAM_SN_MAX_PAYLOAD + 1, 'a')));

  Bytes long_one = hex("01 01 2c 0c 20 00 06 00 20");
  long_one.resize(300, 'x');
  const auto event = robot.hear(to_hex(long_one));
  EXPECT_EQ(event.kind, SLAM_SN_MESSAGE);
  EXPECT_EQ(event.size, 291U);
  EXPECT_EQ(robot.hear("01 00 09 0c 00 00 06 00 00").kind, SLAM_SN_MESSAGE);
}

TEST(SnClient, IgnoresAndCountsInvalidDatagrams) {
  for (const bool is_ready : {false, true}) {
    SnRobot robot;
    is_ready ? robot.get_ready() : robot.start();
    robot.sent();
    robot.client.invalid = 0;
    for (const auto octets : mqttsn::invalid_datagrams) {
      EXPECT_EQ(robot.hear(octets).kind, SLAM_SN_NOTHING) << octets;
      EXPECT_TRUE(robot.sent().empty()) << octets;
    }
    EXPECT_EQ(robot.client.invalid, mqttsn::invalid_datagrams.size());
    EXPECT_EQ(slam_sn_is_ready(&robot.client), is_ready);
  }
}

TEST(SnClient, IgnoresMessagesThatOnlyClientsSend) {
  SnRobot robot;
  robot.get_ready();
  for (const auto& vector : mqttsn::message_vectors) {
    static constexpr std::string_view theirs[] = {
        "CONNECT",    "WILLTOPIC-", "WILLMSG-",         "SUBSCRIBE", "UNSUB",     "WILLTOPICUPD",
        "WILLMSGUPD", "SEARCHGW",   "DISCONNECT-sleep", "GWINFO",    "ADVERTISE", "PUBLISH-qm1"};
    if (std::ranges::none_of(theirs, [&](auto head) { return vector.name.starts_with(head); }))
      continue;
    EXPECT_EQ(robot.hear(vector.wire).kind, SLAM_SN_NOTHING) << vector.name;
    EXPECT_TRUE(robot.sent().empty()) << vector.name;
  }
  EXPECT_TRUE(slam_sn_is_ready(&robot.client));
}

TEST(SnClient, RefusesInvalidSettings) {
  const auto is_valid = [](auto change) {
    SnRobot robot;
    robot.settings.topics = robot.topics.data();
    robot.settings.topic_count = 1;
    change(robot);
    return slam_sn_init(&robot.client, &robot.settings, 1);
  };
  const std::string long_name(SLAM_SN_MAX_PACKET, 'a');
  EXPECT_TRUE(is_valid([](SnRobot&) {}));
  EXPECT_FALSE(is_valid([](SnRobot& robot) { robot.settings.client_id = ""; }));
  EXPECT_FALSE(is_valid([](SnRobot& robot) { robot.settings.keep_alive_s = 0; }));
  EXPECT_FALSE(is_valid([](SnRobot& robot) { robot.settings.will_topic = ""; }));
  EXPECT_FALSE(is_valid([](SnRobot& robot) { robot.topics[0].name = nullptr; }));
  EXPECT_FALSE(is_valid([](SnRobot& robot) { robot.topics[0].flags = SLAM_SN_SHORT; }));
  EXPECT_FALSE(is_valid([](SnRobot& robot) { robot.topics[0].flags = 3; }));
  EXPECT_FALSE(is_valid([&](SnRobot& robot) { robot.settings.client_id = long_name.c_str(); }));
  EXPECT_FALSE(is_valid([&](SnRobot& robot) { robot.topics[0].name = long_name.c_str(); }));
  EXPECT_FALSE(
      is_valid([](SnRobot& robot) { robot.settings.topic_count = SLAM_SN_MAX_TOPICS + 1; }));
}

TEST(SnClient, EncodesTheSameConnectInC99WithSmallerBounds) {
  Bytes out(16);
  out.resize(c99_connect(out.data(), out.size()));
  EXPECT_EQ(to_hex(out), vector_named("CONNECT-clean-60s-r1"));
}

}  // namespace
}  // namespace slamgw::firmware
