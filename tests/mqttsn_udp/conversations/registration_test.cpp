// SPDX-License-Identifier: Apache-2.0
// Topic registration in both directions (R57-R69).
#include <gtest/gtest.h>

#include <map>

#include "adapters/mqttsn_udp/limits.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

TEST(SnGateway, R57_AnswersRegisterWithAnIdAndTheSameMsgId) {
  ConnectedRig rig;
  rig.send(1, Register{0x7777, 0x1234, own_topic});
  EXPECT_EQ(rig.sent_to(1), Lines{"REGACK id=1 msg=4660 code=0"});
}

TEST(SnGateway, R58_NeverGivesOutReservedIds) {
  TopicTable table;
  table.number_by([](std::string_view) { return highest_new_topic_id; });
  EXPECT_EQ(table.assign("first"), 0x7fff);
  EXPECT_EQ(table.assign("second"), 1);
  EXPECT_EQ(table.name_of(0), nullptr);
  EXPECT_EQ(table.name_of(0xffff), nullptr);
  for (int i = 0; i < 200'000; ++i) {
    const std::uint16_t id = topic_id_of("t" + std::to_string(i));
    ASSERT_TRUE(id != 0 && id != 0xffff) << i;
  }
}

/// The Java and Python clients of marcoratto (mqttsn12) read the ids of REGACK and SUBACK as signed
/// numbers. They neither publish with a negative id nor recognize it in a PUBLISH.
TEST(SnGateway, R58_GivesOutIdsThatArePositiveAsSignedNumbers) {
  TopicTable table;
  for (const std::string topic : {"a/t0", "a/t1", "mqttsn/test/pub_qos1_retained"})
    EXPECT_LE(table.assign(topic).value(), 0x7fff) << topic;
  EXPECT_EQ(topic_id_of("a/t9x"), 0x370f) << "version 0.1.0 assigned the same id";
  table.restore({"kept", 0xfffe});
  EXPECT_EQ(table.id_of("kept"), 0xfffe) << "an id from before the restart stays";
}

TEST(SnGateway, R58_BoundsTheTopicsOfAClient) {
  TopicTable table;
  for (std::size_t i = 0; i < limits::max_topics_per_client; ++i)
    table.find(table.assign("t" + std::to_string(i)).value())->is_own = true;
  EXPECT_EQ(table.assign("one more"), std::nullopt) << "the client uses all of its topics";
}

/// CONNACK cannot report a missing session. So an id must not mean another topic there.
TEST(SnGateway, R58_GivesATopicTheSameIdAtEachGateway) {
  std::vector<std::string> topics;
  for (int i = 0; i < 10; ++i) topics.push_back("ntnu-slam/robot/r1/t" + std::to_string(i));
  TopicTable here;
  TopicTable there;
  for (const std::string& topic : topics) here.assign(topic);
  for (std::size_t i = 10; i-- > 5;) there.assign(topics[i]);
  for (std::size_t i = 0; i < 10; ++i) {
    const auto* meant = there.name_of(here.id_of(topics[i]).value());
    EXPECT_EQ(meant ? *meant : "unknown", i < 5 ? "unknown" : topics[i]);
  }
}

TEST(SnGateway, R58_FindsANameByAnyOfItsIds) {
  TopicTable table;
  table.restore({"a", 7});
  table.restore({"b", 8});
  table.rename([](const std::string&) { return "b"; });
  const auto id = table.id_of("b");
  ASSERT_TRUE(id == 7 || id == 8);
  EXPECT_EQ(table.assign("b"), id);
  EXPECT_EQ(table.id_of("a"), std::nullopt);
}

TEST(SnGateway, R58_RestoresNoIdTwice) {
  TopicTable table;
  table.restore({"a", 7});
  table.restore({"b", 7});
  table.restore({"none", 0});
  table.restore({"none", 0xffff});
  ASSERT_EQ(table.topics().size(), 1U);
  EXPECT_EQ(*table.name_of(7), "a");
}

TEST(SnGateway, R58_ReplacesTheLeastRecentlyUsedTopic) {
  TopicTable table;
  table.number_by([](std::string_view) { return lowest_topic_id; });
  for (std::size_t i = 1; i <= limits::max_topics_per_client; ++i) {
    const auto id = table.assign("t" + std::to_string(i));
    table.find(id.value())->is_known = true;
  }
  table.touch(1);
  table.find(2)->is_own = true;
  const std::vector<std::uint16_t> in_use{3};
  EXPECT_EQ(table.assign("new", in_use), 4);
  EXPECT_FALSE(table.find(4)->is_known) << "the new topic is not registered yet";
  EXPECT_EQ(*table.name_of(4), "new");
  EXPECT_EQ(table.id_of("t4"), std::nullopt);
  EXPECT_EQ(table.assign("t1"), 1);
  EXPECT_EQ(table.assign("newer", in_use), 5);
}

TEST(SnGateway, R65_DeliversMoreTopicsThanAClientHasIds) {
  SnRig rig;
  rig.connect(1, "listener", true, 6000);
  rig.subscribe(1, "ntnu-slam/robot/#", 1);
  constexpr std::size_t robots = limits::max_topics_per_client + 200;
  std::map<std::uint16_t, std::string> names;  // as the client has learned them
  std::size_t got = 0;
  for (int round = 0; round < 2; ++round) {
    for (std::size_t i = 0; i < robots; ++i) {
      const std::string topic = "ntnu-slam/robot/r" + std::to_string(i) + "/adv";
      rig.broker(topic, "x", 1);
      const Packet asked = *decode(rig.datagrams.back().bytes);
      if (const auto* request = std::get_if<Register>(&asked)) {
        names[request->topic_id] = request->topic_name;
        rig.send(1, Regack{request->topic_id, request->msg_id, ReturnCode::accepted});
      }
      const auto publish = std::get<Publish>(*decode(rig.datagrams.back().bytes));
      got += names[publish.topic_id] == topic ? 1 : 0;
      rig.send(1, Puback{publish.topic_id, publish.msg_id, ReturnCode::accepted});
    }
  }
  EXPECT_EQ(got, 2 * robots);
  EXPECT_LE(names.size(), limits::max_topics_per_client);
  EXPECT_EQ(rig.counter("queue_dropped"), 0U);
}

TEST(SnGateway, R65_ReassignsNoIdThatTheClientUses) {
  ConnectedRig rig(true, 6000);
  const auto own = rig.register_topic(1, own_topic);
  rig.subscribe(1, "ntnu-slam/server/r1/cmd", 0);
  rig.subscribe(1, "ntnu-slam/robot/#", 0);
  for (std::size_t i = 0; i < 2 * limits::max_topics_per_client; ++i) {
    rig.broker("ntnu-slam/robot/r" + std::to_string(i + 2) + "/adv");
    const auto request = std::get<Register>(*decode(rig.datagrams.back().bytes));
    rig.send(1, Regack{request.topic_id, request.msg_id, ReturnCode::accepted});
  }
  rig.sent_to(1);
  rig.publish(1, own, 0, 0);
  EXPECT_EQ(rig.reports.back().topic, own_topic);
  rig.broker("ntnu-slam/server/r1/cmd");
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBLISH dup=0 qos=0 retain=0 normal id=2 msg=0 data=6869"});
}

TEST(SnGateway, R63_BoundsTheMessageTypesOfARobot) {
  ConnectedRig rig;
  for (std::size_t i = 0; i < limits::max_types_per_robot; ++i)
    EXPECT_NE(rig.register_topic(1, "ntnu-slam/robot/r1/t" + std::to_string(i)), 0);
  rig.send(1, Register{0, 7, "ntnu-slam/robot/r1/more"});
  EXPECT_EQ(rig.last_to(1), "REGACK id=0 msg=7 code=3");
  rig.send(1, Register{0, 8, "ntnu-slam/robot/r1/t0"});
  EXPECT_EQ(rig.last_to(1), "REGACK id=1 msg=8 code=0");
  rig.send(1, Register{0, 9, "ntnu-slam/server/r1/cmd"});
  EXPECT_EQ(rig.last_to(1).substr(0, 9), "REGACK id") << "command topics do not count";
  ASSERT_EQ(rig.notices.size(), 1U);
  EXPECT_NE(rig.notices[0].text.find("128 types"), std::string::npos);
}

TEST(SnGateway, R63_BoundsTheNamesOfAllClientsTogether) {
  NameBudget budget;
  budget.take(limits::name_octets_together);  // by other clients
  {
    TopicTable table;
    table.charge(budget);
    EXPECT_NE(table.assign("what every robot needs"), std::nullopt);
    std::size_t longs = 0;
    while (table.assign(std::string(1200, 'x') + std::to_string(longs)) &&
           table.topics().size() == longs + 2)
      ++longs;
    EXPECT_EQ(longs, 2U);
    table.clear();
    budget.give_back(limits::name_octets_together);
    for (int i = 0; i < 100; ++i) table.assign(std::string(1200, 'x') + std::to_string(i));
    EXPECT_EQ(table.topics().size(), 100U);
    EXPECT_FALSE(budget.may_take(limits::name_octets_for_each, limits::name_octets_together));
  }
  EXPECT_TRUE(budget.may_take(limits::name_octets_for_each, limits::name_octets_together))
      << "a destroyed table returns its names";
}

TEST(SnGateway, R59_KeepsIdsOfClientsApart) {
  ConnectedRig rig;
  rig.connect(2, "r2");
  const auto id = rig.register_topic(1, own_topic);
  rig.publish(2, id, 0, 0);
  EXPECT_EQ(rig.last_to(2), "PUBACK id=1 msg=0 code=2");
  EXPECT_TRUE(rig.reports.empty());
}

TEST(SnGateway, R60_GivesOneNameOneId) {
  ConnectedRig rig;
  const auto id = rig.register_topic(1, own_topic);
  EXPECT_NE(rig.register_topic(1, "ntnu-slam/robot/r1/update"), id);
  EXPECT_EQ(rig.register_topic(1, own_topic), id);
}

TEST(SnGateway, R61_GivesRegisterAndSubscribeTheSameId) {
  ConnectedRig rig;
  const auto id = rig.register_topic(1, "ntnu-slam/server/r1/cmd");
  rig.send(1, Subscribe{false, WireQos::one, TopicIdType::normal, 9, "ntnu-slam/server/r1/cmd", 0});
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=1 id=" + std::to_string(id) + " msg=9 code=0");
}

TEST(SnGateway, R62_KeepsPredefinedAndNormalIdsApart) {
  Settings settings;
  settings.predefined_topics = {{1, "a/predefined", {}}};
  ConnectedRig rig(settings);
  ASSERT_EQ(rig.register_topic(1, own_topic), 1);
  rig.publish(1, 1, 0, 0);
  rig.send(1, Publish{false, WireQos::zero, false, TopicIdType::predefined, 1, 0, {}});
  ASSERT_EQ(rig.reports.size(), 2U);
  EXPECT_EQ(rig.reports[0].topic, own_topic);
  EXPECT_EQ(rig.reports[1].topic, "a/predefined");
}

TEST(SnGateway, R63_RefusesInvalidTopicNamesAndAFullTable) {
  Settings settings;
  settings.when_full = WhenFull::reject;
  ConnectedRig rig(settings);
  for (const std::string& name : {std::string("a/+"), std::string("a/#"), std::string("a/\xff"),
                                  std::string("a/\0", 3), std::string("not/allowed")}) {
    rig.send(1, Register{0, 1, name});
    EXPECT_EQ(rig.last_to(1), "REGACK id=0 msg=1 code=3") << name;
  }
  EXPECT_EQ(rig.notices.size(), 1U);
  EXPECT_NE(rig.notices[0].text.find("topics.extra_publish"), std::string::npos);
  for (std::size_t i = 0; i < limits::max_topics_per_client; ++i)
    rig.register_topic(1, "a/" + std::to_string(i));
  rig.send(1, Register{0, 2, "a/one-more"});
  EXPECT_EQ(rig.last_to(1), "REGACK id=0 msg=2 code=1");
  ASSERT_EQ(rig.notices.size(), 2U);
  EXPECT_NE(rig.notices[1].text.find("no room for 'a/one-more'"), std::string::npos);
}

TEST(SnGateway, R63_RefusesOwnNamesThatItWouldNotPublish) {
  SnRig rig({}, {{"tank", {}, "nrf-7"}});
  rig.connect(1, "nrf-7");
  for (const std::string& name :
       {std::string("ntnu-slam/robot/nrf-7/imu/raw"), std::string("ntnu-slam/robot/tank/"),
        "ntnu-slam/robot/nrf-7/" + std::string(65, 'x')}) {
    rig.send(1, Register{0, 1, name});
    EXPECT_EQ(rig.last_to(1), "REGACK id=0 msg=1 code=3") << name;
  }
  for (const char* const name : {"ntnu-slam/server/nrf-7/cmd/fast", "ntnu-slam/robot/r2/imu/raw"}) {
    const auto id = rig.register_topic(1, name);
    EXPECT_NE(id, 0) << "subscribing is allowed to " << name;
    rig.publish(1, id, 0, 0);
    EXPECT_EQ(rig.last_to(1), "PUBACK id=" + std::to_string(id) + " msg=0 code=3") << name;
  }
  EXPECT_TRUE(rig.reports.empty());
}

TEST(SnGateway, R64_AnswersABurstInOrder) {
  ConnectedRig rig;
  rig.answers_subscribes = false;
  rig.send(1, Register{0, 1, own_topic});
  rig.send(1, Subscribe{false, WireQos::one, TopicIdType::normal, 2, "a/x", 0});
  rig.send(1, Register{0, 3, "ntnu-slam/robot/r1/update"});
  rig.send(1, Subscribe{false, WireQos::one, TopicIdType::normal, 4, "a/y", 0});
  EXPECT_EQ(rig.sent_to(1), Lines{"REGACK id=1 msg=1 code=0"});
  rig.subscribe_result("a/y", true);
  EXPECT_TRUE(rig.is_silent(1));
  rig.subscribe_result("a/x", true);
  EXPECT_EQ(rig.sent_to(1), (Lines{"SUBACK qos=1 id=2 msg=2 code=0", "REGACK id=3 msg=3 code=0",
                                   "SUBACK qos=1 id=4 msg=4 code=0"}));
}

TEST(SnGateway, R65_RegistersBeforeTheFirstPublishOfAWildcardMatch) {
  ConnectedRig rig;
  rig.subscribe(1, "a/#", 0);
  rig.broker("a/new", "1");
  EXPECT_EQ(rig.sent_to(1), Lines{"REGISTER id=1 msg=1 topic=a/new"});
  rig.send(1, Regack{1, 1, ReturnCode::accepted});
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=0 qos=0 retain=0 normal id=1 msg=0 data=31");
  rig.broker("a/new", "2");
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=0 qos=0 retain=0 normal id=1 msg=0 data=32");
}

TEST(SnGateway, R66_RegistersOneTopicAtATimeAndKeepsEachTopicsOrder) {
  ConnectedRig rig(true, 600);
  rig.subscribe(1, "a/#", 0);
  rig.broker("a/1", "1");
  rig.broker("a/2", "2");
  rig.broker("a/1", "3");
  EXPECT_EQ(rig.sent_to(1), Lines{"REGISTER id=1 msg=1 topic=a/1"});
  rig.send(1, Regack{1, 1, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(1), (Lines{"PUBLISH dup=0 qos=0 retain=0 normal id=1 msg=0 data=31",
                                   "REGISTER id=2 msg=2 topic=a/2",
                                   "PUBLISH dup=0 qos=0 retain=0 normal id=1 msg=0 data=33"}));
  rig.send(1, Regack{2, 2, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBLISH dup=0 qos=0 retain=0 normal id=2 msg=0 data=32"});
}

TEST(SnGateway, R66_RepeatsARegisterWithItsMsgIdBesideAnother) {
  ConnectedRig rig(true, 600);
  rig.subscribe(1, "a/#", 0);
  rig.broker("a/1", "1");
  rig.broker("a/2", "2");
  rig.sent_to(1);
  rig.pass(RetransmissionTimeout::initial);
  EXPECT_EQ(rig.sent_to(1),
            (Lines{"REGISTER id=1 msg=1 topic=a/1", "REGISTER id=2 msg=2 topic=a/2"}));
  rig.send(1, Regack{2, 2, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBLISH dup=0 qos=0 retain=0 normal id=2 msg=0 data=32"});
  rig.send(1, Regack{1, 1, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBLISH dup=0 qos=0 retain=0 normal id=1 msg=0 data=31"});
}

TEST(SnGateway, R67_UnsubscribesWhenARegisterIsRefused) {
  ConnectedRig rig(false);
  rig.subscribe(1, "a/x");
  rig.connect(1, "r1", false);
  rig.broker("a/x");
  EXPECT_EQ(rig.last_to(1), "REGISTER id=1 msg=1 topic=a/x");
  rig.send(1, Regack{1, 1, ReturnCode::not_supported});
  EXPECT_EQ(rig.unsubscribes.size(), 1U);
  rig.broker("a/x");
  EXPECT_TRUE(rig.is_silent(1));

  rig.subscribe(1, "a/+", 0);
  rig.broker("a/y");
  rig.send(1, Regack{2, 2, ReturnCode::not_supported});
  rig.sent_to(1);
  rig.broker("a/z");
  EXPECT_EQ(rig.last_to(1), "REGISTER id=3 msg=3 topic=a/z") << "the wildcard subscription stays";
  rig.send(1, Regack{3, 3, ReturnCode::congestion});
  rig.pass_s(80);
  rig.send(1, Pingreq{});
  EXPECT_EQ(rig.sent_to(1), Lines{"PINGRESP"}) << "no REGISTER for T_WAIT";
  for (int i = 0; i < 4; ++i) {
    rig.pass_s(80);
    rig.send(1, Pingreq{});
  }
  EXPECT_EQ(rig.sent_to(1)[3], "REGISTER id=3 msg=4 topic=a/z");
}

TEST(SnGateway, R68_IgnoresAnUnexpectedRegack) {
  ConnectedRig rig;
  rig.subscribe(1, "a/#", 0);
  rig.broker("a/1", "1");
  rig.sent_to(1);
  rig.send(1, Regack{1, 99, ReturnCode::accepted});
  EXPECT_TRUE(rig.is_silent(1));
}

/// The REGACK may be a late copy or forged.
TEST(SnGateway, R68_IgnoresCongestionInAnUnexpectedRegack) {
  ConnectedRig rig;
  rig.subscribe(1, "a/x", 0);
  rig.send(1, Regack{1, 99, ReturnCode::congestion});
  rig.broker("a/x", "1");
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=0 qos=0 retain=0 normal id=1 msg=0 data=31");
}

TEST(SnGateway, R69_KeepsAMessageWhoseRegisterIsNotAnswered) {
  ConnectedRig rig(false, 600);
  rig.subscribe(1, "a/#", 1);
  rig.broker("a/1", "1", 1);
  rig.pass_s(100);
  EXPECT_EQ(rig.sent_to(1).size(), 10U) << "repeated for 40 s";
  EXPECT_EQ(rig.gateway.queued_for("r1"), 1U);
  rig.send(1, Pingreq{});
  EXPECT_EQ(rig.sent_to(1)[1], "REGISTER id=1 msg=2 topic=a/1")
      << "registered again when the client sends";
}

}  // namespace
}  // namespace slamgw::mqttsn
