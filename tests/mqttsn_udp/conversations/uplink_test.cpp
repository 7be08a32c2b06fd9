// SPDX-License-Identifier: Apache-2.0
// PUBLISH from clients (R70-R84).
#include <gtest/gtest.h>

#include "adapters/mqttsn_udp/limits.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

/// A connected client with one topic, id 1.
struct UplinkRig : SnRig {
  explicit UplinkRig(Settings settings = {}) : SnRig(std::move(settings)) {
    connect(1, "r1");
    register_topic(1, own_topic);
  }
  void publish_octets(std::string_view wire) { send_octets(1, hex(wire)); }
};

Settings rejecting() {
  Settings settings;
  settings.when_full = WhenFull::reject;
  return settings;
}

TEST(SnGateway, R70_ForwardsQos0OnceWithoutAnAnswer) {
  UplinkRig rig;
  rig.publish(1, 1, 0, 0, "hi");
  EXPECT_TRUE(rig.is_silent(1));
  ASSERT_EQ(rig.reports.size(), 1U);
  EXPECT_EQ(rig.reports[0].robot, "r1");
  EXPECT_EQ(rig.reports[0].topic, own_topic);
  EXPECT_EQ(rig.reports[0].payload, to_bytes("hi"));
  EXPECT_FALSE(rig.reports[0].receipt.is_owed());
}

TEST(SnGateway, R71_AcknowledgesQos1OnlyWhenTheMessageIsSafe) {
  UplinkRig rig;
  rig.publish(1, 1, 1, 0x1234);
  EXPECT_TRUE(rig.is_silent(1));
  rig.pass_s(60);
  EXPECT_TRUE(rig.is_silent(1));
  rig.receipt(rig.reports.at(0).receipt.id);
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBACK id=1 msg=4660 code=0"});
  rig.receipt(rig.reports.at(0).receipt.id);
  EXPECT_TRUE(rig.is_silent(1)) << "a receipt fires once";
}

TEST(SnGateway, ReportsRepeatsAlwaysAndOtherStepsWhileTraced) {
  UplinkRig rig;
  rig.publish(1, 1, 1, 7);
  EXPECT_EQ(rig.reports.at(0).wire.message_id, 7);
  EXPECT_EQ(rig.reports.at(0).wire.is_dup, false);
  rig.send_octets(
      1, encode(Publish{true, WireQos::one, false, TopicIdType::normal, 1, 7, to_bytes("hi")}));
  rig.receipt(1);
  ASSERT_EQ(rig.steps.size(), 1U);
  EXPECT_EQ(rig.steps[0].kind, StepKind::repeat);
  EXPECT_EQ(rig.steps[0].topic, own_topic);
  EXPECT_EQ(rig.steps[0].wire.message_id, 7);
  EXPECT_EQ(rig.steps[0].wire.is_dup, true);

  rig.gateway.on_trace(true);
  rig.steps.clear();
  rig.publish(1, 1, 1, 8);
  rig.receipt(2);
  rig.publish(1, 99, 1, 9);  // not registered
  rig.publish(1, 1, 1, 10);
  rig.receipt(3, ReceiptOutcome::refused);
  ASSERT_EQ(rig.steps.size(), 3U);
  EXPECT_EQ(rig.steps[0].kind, StepKind::acknowledged);
  EXPECT_EQ(rig.steps[0].receipt, (Receipt{Mesh::thread, 2}));
  EXPECT_EQ(rig.steps[1].kind, StepKind::refused);
  EXPECT_EQ(rig.steps[1].wire.message_id, 9);
  EXPECT_EQ(rig.steps[1].why, "its topic id is not registered");
  EXPECT_EQ(rig.steps[2].kind, StepKind::refused);
  EXPECT_EQ(rig.steps[2].receipt, (Receipt{Mesh::thread, 3}));
}

TEST(SnGateway, NamesTheTopicOfARefusedMessageWhileTraced) {
  Settings settings;
  settings.predefined_topics = {{7, "ntnu-slam/robot/r2/adv", {}}};
  UplinkRig rig(settings);
  rig.gateway.on_trace(true);
  rig.send(1, Publish{false, WireQos::one, false, TopicIdType::predefined, 7, 9, {}});
  ASSERT_EQ(rig.steps.size(), 1U);
  EXPECT_EQ(rig.steps[0].topic, "ntnu-slam/robot/r2/adv");
  EXPECT_EQ(rig.steps[0].why, "it may not publish to this topic");
}

TEST(SnGateway, ReportsEachTransmissionWhileTraced) {
  UplinkRig rig;
  rig.subscribe(1, "ntnu-slam/server/r1/cmd");
  rig.gateway.on_trace(true);
  rig.broker("ntnu-slam/server/r1/cmd", "hi", 1);
  rig.pass_s(3);
  ASSERT_GE(rig.steps.size(), 2U);
  EXPECT_EQ(rig.steps[0].kind, StepKind::sent);
  EXPECT_EQ(rig.steps[0].topic, "ntnu-slam/server/r1/cmd");
  EXPECT_NE(rig.steps[0].command, CommandId::none);
  EXPECT_EQ(rig.steps[0].wire.is_dup, false);
  EXPECT_EQ(rig.steps[1].wire.is_dup, true);
  EXPECT_EQ(rig.steps[1].wire.message_id, rig.steps[0].wire.message_id);
  EXPECT_EQ(rig.steps[1].command, rig.steps[0].command);
}

TEST(SnGateway, R72_RefusesAnUnknownTopicIdAtAnyQos) {
  UplinkRig rig;
  for (const unsigned qos : {0U, 1U, 2U}) {
    rig.publish(1, 99, qos, 7);
    EXPECT_EQ(rig.sent_to(1), Lines{"PUBACK id=99 msg=7 code=2"}) << qos;
  }
  EXPECT_TRUE(rig.reports.empty());
}

TEST(SnGateway, R73_RefusesAnUnknownPredefinedId) {
  Settings settings;
  settings.predefined_topics = {{7, "a/mine", "r1"}, {8, "a/others", "r2"}};
  UplinkRig rig(settings);
  rig.publish_octets("09 0c 21 00 07 00 03 68 69");
  EXPECT_EQ(rig.reports.at(0).topic, "a/mine");
  rig.publish_octets("09 0c 21 00 08 00 04 68 69");
  EXPECT_EQ(rig.last_to(1), "PUBACK id=8 msg=4 code=2");
  rig.publish_octets("09 0c 23 00 07 00 05 68 69");
  EXPECT_EQ(rig.last_to(1), "PUBACK id=7 msg=5 code=3");
}

TEST(SnGateway, R74_TakesShortNamesWithoutRegistration) {
  UplinkRig rig;
  rig.publish_octets("09 0c 02 61 62 00 00 68 69");
  EXPECT_EQ(rig.reports.at(0).topic, "ab");
  for (const std::string_view wire :
       {"09 0c 22 61 23 00 01 68 69", "09 0c 22 2b 62 00 01 68 69", "09 0c 22 ff fe 00 01 68 69"}) {
    rig.publish_octets(wire);
    EXPECT_NE(rig.last_to(1).find("code=3"), std::string::npos) << wire;
  }
  EXPECT_EQ(rig.reports.size(), 1U);
}

TEST(SnGateway, R75_ForwardsQos2ExactlyOnce) {
  UplinkRig rig;
  rig.publish(1, 1, 2, 5);
  rig.publish(1, 1, 2, 5);  // before the message is safe
  EXPECT_TRUE(rig.is_silent(1));
  rig.receipt(rig.reports.at(0).receipt.id);
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBREC msg=5"});
  rig.publish_octets("09 0c c0 00 01 00 05 68 69");  // with DUP
  rig.publish_octets("09 0c 40 00 01 00 05 68 69");  // and without
  EXPECT_EQ(rig.sent_to(1), Lines(2, "PUBREC msg=5"));
  rig.send(1, Pubrel{5});
  rig.send(1, Pubrel{5});
  EXPECT_EQ(rig.sent_to(1), Lines(2, "PUBCOMP msg=5"));
  EXPECT_EQ(rig.reports.size(), 1U);
  rig.publish_octets("09 0c c0 00 01 00 05 68 69");  // a copy that the network delayed
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBREC msg=5"});
  EXPECT_EQ(rig.reports.size(), 1U);
  rig.publish(1, 1, 2, 5);
  EXPECT_EQ(rig.reports.size(), 2U) << "after PUBREL the MsgId is free, also for an equal message";
  rig.publish(1, 1, 2, 5, "other");
  EXPECT_EQ(rig.reports.size(), 3U);
  rig.send(1, Pubrel{77});
  EXPECT_EQ(rig.last_to(1), "PUBCOMP msg=77");
}

/// The client treats PUBREC as the end of each exchange.
TEST(SnGateway, R75_ServesAClientThatSendsNoPubrel) {
  UplinkRig rig;
  constexpr std::uint16_t last = limits::max_inbound_qos2 + 2;
  for (std::uint16_t id = 1; id <= last; ++id) {
    rig.publish(1, 1, 2, id);
    ASSERT_EQ(rig.reports.size(), id);
    rig.receipt(rig.reports.back().receipt.id);
    EXPECT_EQ(rig.sent_to(1), Lines{"PUBREC msg=" + std::to_string(id)});
    if (id == limits::max_inbound_qos2) rig.connect(1, "r1", false);
    rig.sent_to(1);
  }
  for (const std::uint16_t id : {std::uint16_t{3}, last}) {
    rig.publish(1, 1, 2, id);
    EXPECT_EQ(rig.sent_to(1), Lines{"PUBREC msg=" + std::to_string(id)})
        << "recognized as a repeat";
  }
  EXPECT_EQ(rig.reports.size(), last);
  rig.send(1, Pubrel{1});
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBCOMP msg=1"}) << "a late PUBREL is answered";
}

TEST(SnGateway, R76_ForwardsARepeatedQos1MessageOnce) {
  UplinkRig rig;
  rig.publish(1, 1, 1, 5);
  rig.pass_s(8);
  rig.publish(1, 1, 1, 5);
  EXPECT_TRUE(rig.is_silent(1)) << "the receipt is still open";
  rig.receipt(rig.reports.at(0).receipt.id);
  rig.sent_to(1);
  rig.pass_s(8);
  rig.publish(1, 1, 1, 5);
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBACK id=1 msg=5 code=0"});
  rig.publish_octets("09 0c a0 00 01 00 05 68 69");
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBACK id=1 msg=5 code=0"});
  EXPECT_EQ(rig.reports.size(), 1U);
  EXPECT_EQ(rig.counter("repeats_suppressed"), 3U);
  rig.publish(1, 1, 1, 5, "other");
  EXPECT_EQ(rig.reports.size(), 2U) << "the same MsgId alone is not a repeat";
  rig.publish(1, 1, 1, 6);
  EXPECT_EQ(rig.reports.size(), 3U) << "equal content alone is not a repeat";
  rig.pass_s(26);
  rig.publish(1, 1, 1, 5);
  EXPECT_EQ(rig.reports.size(), 4U) << "the repeat window has passed";
}

TEST(SnGateway, R76_RecognizesARepeatOfAWaitingMessageAfterManyOthers) {
  UplinkRig rig;
  rig.publish(1, 1, 1, 1, "waits");
  for (std::uint16_t id = 2; id <= limits::max_repeats + 2; ++id) {
    rig.publish(1, 1, 1, id);
    rig.receipt(rig.reports.back().receipt.id);
  }
  const std::size_t reported = rig.reports.size();
  rig.publish(1, 1, 1, 1, "waits");
  EXPECT_EQ(rig.reports.size(), reported);
  rig.sent_to(1);
  rig.receipt(rig.reports.front().receipt.id);
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBACK id=1 msg=1 code=0"});
}

/// A rig that acknowledges each report at once, so that its client can send equal messages in turn.
struct EqualMessages : UplinkRig {
  void send_one(WireQos qos, std::uint16_t msg_id, bool dup = false) {
    send(1, Publish{dup, qos, false, TopicIdType::normal, 1, msg_id, to_bytes("ok")});
    if (!reports.empty() && reports.back().receipt.id > fired) {
      fired = reports.back().receipt.id;
      receipt(fired);
    }
  }
  std::uint64_t fired = 0;
};

TEST(SnGateway, R76_PublishesEachOfFiftyEqualMessagesUnderOneMsgId) {
  for (const int milliseconds : {0, 100, 1000, 3000}) {
    EqualMessages rig;
    for (int i = 0; i < 50; ++i) {
      rig.send_one(WireQos::one, 7);
      EXPECT_EQ(rig.sent_to(1), Lines{"PUBACK id=1 msg=7 code=0"});
      rig.pass(std::chrono::milliseconds(milliseconds));
    }
    EXPECT_EQ(rig.reports.size(), 50U) << milliseconds;
    EXPECT_EQ(rig.counter("repeats_suppressed"), 0U);
  }
}

TEST(SnGateway, R75_PublishesEachOfFiftyEqualHandshakesUnderOneMsgId) {
  for (const int milliseconds : {0, 100, 1000, 5000}) {
    EqualMessages rig;
    for (int i = 0; i < 50; ++i) {
      rig.send_one(WireQos::two, 7);
      rig.send(1, Pubrel{7});
      EXPECT_EQ(rig.sent_to(1), (Lines{"PUBREC msg=7", "PUBCOMP msg=7"}));
      rig.pass(std::chrono::milliseconds(milliseconds));
    }
    EXPECT_EQ(rig.reports.size(), 50U) << milliseconds;
  }
}

/// Three lists of equal messages in one session, under three MsgIds.
TEST(SnGateway, R76_PublishesFiftyAndFiftyEqualMessages) {
  EqualMessages rig;
  rig.send_one(WireQos::one, 1);
  for (int i = 0; i < 50; ++i) rig.send_one(WireQos::one, 7);
  for (int i = 0; i < 50; ++i) {
    rig.send_one(WireQos::two, 8);
    rig.send(1, Pubrel{8});
  }
  for (int i = 0; i < 50; ++i) rig.send_one(WireQos::one, 9);
  EXPECT_EQ(rig.reports.size(), 151U);
}

/// Nordic's client never sets DUP, and repeats a message 8 and 16 s after the first transmission.
TEST(SnGateway, R76_RecognizesNordicsRepeatsAfterALostPuback) {
  for (const unsigned earlier_messages : {0U, 1U, 10U}) {
    EqualMessages rig;
    for (std::uint16_t id = 1; id <= earlier_messages; ++id) rig.send_one(WireQos::one, id);
    for (int i = 0; i < 3; ++i) {
      rig.send_one(WireQos::one, 100);
      EXPECT_EQ(rig.last_to(1), "PUBACK id=1 msg=100 code=0");
      rig.pass_s(8);
    }
    EXPECT_EQ(rig.reports.size(), earlier_messages + 1);
    rig.send_one(WireQos::one, 101);
    EXPECT_EQ(rig.reports.size(), earlier_messages + 2);
  }
}

TEST(SnGateway, R76_RecognizesARepeatByDupUnderAReusedMsgId) {
  EqualMessages rig;
  for (int i = 0; i < 10; ++i) {
    rig.send_one(WireQos::one, 7);
    rig.send_one(WireQos::one, 7, true);  // the PUBACK was lost
    rig.pass_s(5);
    rig.send_one(WireQos::one, 7, true);
  }
  EXPECT_EQ(rig.reports.size(), 10U);
}

/// Different messages under one MsgId show that a late equal one is new.
TEST(SnGateway, R76_PublishesLateEqualMessagesOfAClientThatUsesOneMsgId) {
  EqualMessages rig;
  rig.publish(1, 1, 1, 7, "booted");
  rig.receipt(1);
  for (int i = 0; i < 50; ++i) {
    rig.send_one(WireQos::one, 7);
    rig.pass_s(10);
  }
  EXPECT_EQ(rig.reports.size(), 51U);
}

/// A first late copy differs from a repeat only in its time. After a few, the gateway learns it.
TEST(SnGateway, R76_PublishesAllButTheFirstFewOfAHeartbeatUnderOneMsgId) {
  for (const int period_s : {5, 10, 20}) {
    EqualMessages rig;
    for (int i = 0; i < 50; ++i) {
      rig.send_one(WireQos::one, 7);
      rig.pass_s(period_s);
    }
    EXPECT_GE(rig.reports.size(), 50U - limits::max_client_repeats) << period_s;
  }
}

TEST(SnGateway, R76_SuppressesEqualMessagesWhileTheFirstIsUnacknowledged) {
  UplinkRig rig;
  for (const auto& text : {"one", "two"}) {  // this client uses one MsgId for all messages
    rig.publish(1, 1, 1, 7, text);
    rig.receipt(rig.reports.back().receipt.id);
  }
  rig.publish(1, 1, 1, 7, "three");
  for (int i = 0; i < 10; ++i) rig.publish(1, 1, 1, 7, "three");
  EXPECT_EQ(rig.reports.size(), 3U);
}

/// The network has doubled the copy, or has delayed it behind two later messages.
TEST(SnGateway, R76_RecognizesALateCopyOfAClientThatCountsMsgIds) {
  EqualMessages rig;
  for (std::uint16_t id = 1; id <= 20; ++id) {
    const WireQos qos = id % 2 == 0 ? WireQos::two : WireQos::one;
    rig.send_one(qos, id);
    if (qos == WireQos::two) rig.send(1, Pubrel{id});
    if (id <= limits::min_counted_ids) continue;
    rig.send_one(qos, id);
    if (id % 2 == 1) rig.send_one(WireQos::one, static_cast<std::uint16_t>(id - 2));
  }
  EXPECT_EQ(rig.reports.size(), 20U);
}

/// The gateway had no room for a while, so the client repeated its message under the same MsgId.
TEST(SnGateway, R76_LearnsNothingFromRefusedMessages) {
  EqualMessages rig;
  for (int i = 0; i < 10; ++i) {
    rig.publish(1, 1, 1, 7, "ok");
    rig.receipt(rig.reports.back().receipt.id, ReceiptOutcome::refused);
  }
  rig.reports.clear();
  rig.fired = 10;
  for (int i = 0; i < 50; ++i) rig.send_one(WireQos::one, 7);
  EXPECT_EQ(rig.reports.size(), 50U);
}

TEST(SnGateway, R76_ForwardsTheRepeatOfARefusedMessage) {
  UplinkRig rig;
  rig.publish(1, 1, 1, 5);
  rig.receipt(rig.reports.at(0).receipt.id, ReceiptOutcome::refused);
  EXPECT_TRUE(rig.is_silent(1));
  rig.publish(1, 1, 1, 5);
  ASSERT_EQ(rig.reports.size(), 2U);
  rig.receipt(rig.reports[1].receipt.id);
  EXPECT_EQ(rig.last_to(1), "PUBACK id=1 msg=5 code=0");
}

TEST(SnGateway, R77_ForwardsAnyPayloadAndAnEmptyOne) {
  UplinkRig rig;
  rig.publish_octets("07 0c 10 00 01 00 00");
  EXPECT_TRUE(rig.reports.at(0).payload.empty());
  EXPECT_TRUE(rig.reports.at(0).retain);
  rig.publish_octets("09 0c 00 00 01 00 00 00 ff");
  EXPECT_EQ(rig.reports.at(1).payload, (Bytes{0x00, 0xff}));
}

TEST(SnGateway, R78_ForwardsTheRetainFlag) {
  UplinkRig rig;
  rig.publish_octets("09 0c 10 00 01 00 00 68 69");
  rig.publish_octets("09 0c 00 00 01 00 00 68 69");
  EXPECT_TRUE(rig.reports.at(0).retain);
  EXPECT_FALSE(rig.reports.at(1).retain);
}

TEST(SnGateway, R79_TakesMsgId0AtQos1And2) {
  UplinkRig rig;
  rig.publish(1, 1, 1, 0, "one");
  rig.publish(1, 1, 2, 0, "two");
  rig.receipt(rig.reports.at(0).receipt.id);
  rig.receipt(rig.reports.at(1).receipt.id);
  EXPECT_EQ(rig.sent_to(1), (Lines{"PUBACK id=1 msg=0 code=0", "PUBREC msg=0"}));
}

TEST(SnGateway, R80_IsSilentOrAnswersCongestionWhenFull) {
  UplinkRig silent;
  silent.publish(1, 1, 1, 5);
  silent.receipt(silent.reports.at(0).receipt.id, ReceiptOutcome::refused);
  EXPECT_TRUE(silent.is_silent(1));
  UplinkRig rig(rejecting());
  rig.publish(1, 1, 1, 5);
  rig.publish(1, 1, 2, 6);
  rig.receipt(rig.reports.at(0).receipt.id, ReceiptOutcome::refused);
  rig.receipt(rig.reports.at(1).receipt.id, ReceiptOutcome::refused);
  EXPECT_EQ(rig.sent_to(1), (Lines{"PUBACK id=1 msg=5 code=1", "PUBACK id=1 msg=6 code=1"}));
  for (std::uint16_t i = 0; i <= limits::max_open_receipts; ++i)
    rig.publish(1, 1, 1, static_cast<std::uint16_t>(100 + i));
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBACK id=1 msg=164 code=1"}) << "too many receipts are open";
}

TEST(SnGateway, R81_TakesQosMinusOneOnlyWhereAllowed) {
  Settings settings;
  settings.predefined_topics = {{7, own_topic, {}}};
  SnRig off(settings);
  off.send_octets(1, hex("09 0c 61 00 07 00 00 68 69"));
  EXPECT_TRUE(off.reports.empty());
  EXPECT_EQ(off.counter("unconnected_refused"), 1U);
  settings.allow_unconnected_publish = true;
  SnRig rig(settings);
  rig.send_octets(1, hex("09 0c 61 00 07 00 00 68 69"));
  rig.send_octets(1, hex("09 0c 72 61 62 00 00 68 69"));
  ASSERT_EQ(rig.reports.size(), 2U);
  EXPECT_EQ(rig.reports[0].topic, own_topic);
  EXPECT_EQ(rig.reports[0].robot, "r1");
  EXPECT_EQ(rig.reports[0].address, "[fd00::1]:47193");
  EXPECT_EQ(rig.reports[0].qos, Qos::at_most_once);
  EXPECT_TRUE(rig.reports[1].retain);
  rig.send_octets(1, hex("09 0c 60 00 05 00 00 68 69"));  // a normal id
  rig.send_octets(1, hex("09 0c 61 00 09 00 00 68 69"));  // unknown
  rig.send_octets(1, hex("09 0c 62 7a 7a 00 00 68 69"));  // not allowed
  EXPECT_EQ(rig.counter("unconnected_refused"), 3U);
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_TRUE(rig.presence.empty());
}

TEST(SnGateway, R82_TakesMessagesFromASleepingClient) {
  UplinkRig rig;
  rig.sleep(1, 100);
  rig.publish(1, 1, 1, 5);
  rig.receipt(rig.reports.at(0).receipt.id);
  EXPECT_EQ(rig.last_to(1), "PUBACK id=1 msg=5 code=0");
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::asleep);
}

TEST(SnGateway, R83_HandlesSeveralMessagesInFlight) {
  UplinkRig rig;
  for (std::uint16_t i = 1; i <= 4; ++i) rig.publish(1, 1, 1 + i % 2, i, std::to_string(i));
  ASSERT_EQ(rig.reports.size(), 4U);
  for (const std::size_t i : {3U, 0U, 2U, 1U}) rig.receipt(rig.reports[i].receipt.id);
  EXPECT_EQ(rig.sent_to(1), (Lines{"PUBACK id=1 msg=4 code=0", "PUBREC msg=1", "PUBREC msg=3",
                                   "PUBACK id=1 msg=2 code=0"}));
}

TEST(SnGateway, R84_KeepsTheOrderOfArrival) {
  UplinkRig rig;
  for (int i = 0; i < 5; ++i) rig.publish(1, 1, 0, 0, std::to_string(i));
  rig.send(1, Disconnect{});
  ASSERT_EQ(rig.reports.size(), 5U);
  for (std::size_t i = 0; i < 5; ++i)
    EXPECT_EQ(rig.reports[i].payload, to_bytes(std::to_string(i)));
}

TEST(SnGateway, AnswersNoReceiptOfAnEndedSession) {
  UplinkRig rig;
  rig.publish(1, 1, 1, 5);
  rig.send(1, Disconnect{});
  rig.sent_to(1);
  rig.receipt(rig.reports.at(0).receipt.id);
  rig.receipt(4711);
  EXPECT_TRUE(rig.is_silent(1));
}

TEST(SnGateway, ReportsOncePerClientWhichSettingAllowsATopic) {
  SnRig rig({}, {}, {}, {});
  rig.connect(1, "r1");
  for (int i = 0; i < 3; ++i) rig.send(1, Register{0, 1, "v2/robot/r1/adv"});
  rig.send_octets(1, hex("09 0c 22 61 62 00 02 68 69"));
  EXPECT_EQ(rig.last_to(1), "PUBACK id=24930 msg=2 code=3");
  ASSERT_EQ(rig.notices.size(), 1U);
  EXPECT_EQ(rig.notices[0].text,
            "r1 may not publish to 'v2/robot/r1/adv': a matching filter in topics.extra_publish "
            "would allow it");
  EXPECT_EQ(rig.counter("topics_refused"), 4U);
}

}  // namespace
}  // namespace slamgw::mqttsn
