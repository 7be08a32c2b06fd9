// SPDX-License-Identifier: Apache-2.0
// A robot that the configuration renames, while its firmware builds topics from its client id.
#include <gtest/gtest.h>

#include <set>
#include <utility>

#include "adapters/mqttsn_udp/clients/session_snapshot.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

/// The client id is "nrf-7", the robot's name is "tank".
struct RenamedRig : SnRig {
  explicit RenamedRig(Settings settings = {})
      : SnRig(std::move(settings), {{"tank", {}, "nrf-7"}}) {
    send(1, Connect{false, false, 1, 600, "nrf-7"});
    sent_to(1);
  }
};

TEST(SnGateway, PublishesARenamedRobotsTopicsUnderItsName) {
  RenamedRig rig;
  const auto id = rig.register_topic(1, "ntnu-slam/robot/nrf-7/update");
  rig.publish(1, id, 1, 7);
  ASSERT_EQ(rig.reports.size(), 1U);
  EXPECT_EQ(rig.reports[0].topic, "ntnu-slam/robot/tank/update");
  EXPECT_EQ(rig.reports[0].robot, "tank");
  EXPECT_EQ(rig.register_topic(1, "ntnu-slam/robot/tank/update"), id) << "both names are one topic";
  EXPECT_TRUE(rig.notices.empty());
}

TEST(SnGateway, DeliversARenamedRobotsCommandsUnderItsClientId) {
  RenamedRig rig;
  rig.subscribe(1, "ntnu-slam/server/nrf-7/#", 1);
  ASSERT_EQ(rig.subscribes.size(), 1U);
  EXPECT_EQ(rig.subscribes[0].filter, "ntnu-slam/server/tank/#");
  rig.broker("ntnu-slam/server/tank/cmd", "go", 1);
  EXPECT_EQ(rig.last_to(1), "REGISTER id=1 msg=1 topic=ntnu-slam/server/nrf-7/cmd");
  rig.send(1, Regack{1, 1, ReturnCode::accepted});
  rig.send(1, Puback{1, 2, ReturnCode::accepted});
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::delivered);
  EXPECT_EQ(rig.outcomes[0].robot, "tank");
  Unsubscribe unsubscribe;
  unsubscribe.topic_name = "ntnu-slam/server/nrf-7/#";
  rig.send(1, unsubscribe);
  EXPECT_EQ(rig.unsubscribes.size(), 1U);
}

TEST(SnGateway, UsesTheNewNameIfTheRobotSubscribedWithIt) {
  RenamedRig rig;
  rig.subscribe(1, "ntnu-slam/server/tank/+", 1);
  rig.broker("ntnu-slam/server/tank/cmd", "go", 1);
  EXPECT_EQ(rig.last_to(1), "REGISTER id=1 msg=1 topic=ntnu-slam/server/tank/cmd");
}

TEST(SnGateway, TranslatesOnlyTopicsOfTheRenamedRobot) {
  RenamedRig rig;
  rig.subscribe(1, "ntnu-slam/server/nrf-7/+", 1);
  rig.subscribe(1, "ntnu-slam/robot/+/update", 1);
  rig.subscribe(1, "ntnu-slam/robot/nrf-70/update", 1);
  EXPECT_EQ(rig.subscribes.back().filter, "ntnu-slam/robot/nrf-70/update");
  rig.broker("ntnu-slam/robot/nrf-7x/update", "u", 1);
  EXPECT_EQ(rig.last_to(1), "REGISTER id=2 msg=1 topic=ntnu-slam/robot/nrf-7x/update");
  rig.connect(2, "r2");
  rig.send(2, Register{0, 1, "ntnu-slam/server/nrf-7/cmd"});
  EXPECT_EQ(rig.last_to(2), "REGACK id=0 msg=1 code=3") << "not r2's topic";
}

TEST(SnGateway, TranslatesTheWillOfARenamedRobot) {
  SnRig rig({}, {{"tank", {}, "nrf-7"}});
  rig.send(1, Connect{true, true, 1, 60, "nrf-7"});
  rig.send(1, WillTopic{WireQos::one, false, "ntnu-slam/robot/nrf-7/gone"});
  rig.send(1, WillMsg{to_bytes("bye")});
  EXPECT_EQ(rig.last_to(1), "CONNACK code=0");
  rig.pass_s(100);
  ASSERT_EQ(rig.reports.size(), 1U);
  EXPECT_EQ(rig.reports[0].topic, "ntnu-slam/robot/tank/gone");
}

TEST(SnGateway, TranslatesPredefinedTopicsOfARenamedRobot) {
  Settings settings;
  settings.predefined_topics = {{7, "ntnu-slam/robot/nrf-7/update", "nrf-7"}};
  settings.allow_unconnected_publish = true;
  RenamedRig rig(settings);
  rig.send(1, Publish{false, WireQos::zero, false, TopicIdType::predefined, 7, 0, {}});
  rig.send(1, Publish{false, WireQos::minus_one, false, TopicIdType::predefined, 7, 0, {}});
  ASSERT_EQ(rig.reports.size(), 2U);
  for (const Report& report : rig.reports) EXPECT_EQ(report.topic, "ntnu-slam/robot/tank/update");
}

TEST(SnGateway, RemembersOverARestartThatARobotUsesItsClientId) {
  RenamedRig before;
  before.subscribe(1, "ntnu-slam/server/nrf-7/+", 1);
  const Bytes stored = encode_session(*before.gateway.snapshot("nrf-7", before.now));
  SnRig after({}, {{"tank", {}, "nrf-7"}});
  ASSERT_TRUE(after.gateway.restore(*decode_session(stored), after.now));
  after.broker("ntnu-slam/server/tank/cmd", "go", 1);
  EXPECT_EQ(after.last_to(1), "REGISTER id=1 msg=1 topic=ntnu-slam/server/nrf-7/cmd");
}

/// Returns and clears the presence changes, oldest first.
Lines presence_lines(SnRig& rig) {
  Lines lines;
  for (const PresenceChange& change : std::exchange(rig.presence, {}))
    lines.push_back(change.robot + " " + std::string(to_string(change.presence)));
  return lines;
}

/// "nrf-7" is not renamed yet: its topics contain its client id.
struct UnnamedRig : SnRig {
  explicit UnnamedRig(Settings settings = {}) : SnRig(std::move(settings)) {
    connect(1, "nrf-7", false, 600);
    update_id = register_topic(1, "ntnu-slam/robot/nrf-7/update");
    subscribe(1, "ntnu-slam/server/nrf-7/cmd", 1);  // the next id
    subscribe(1, "ntnu-slam/server/nrf-7/+", 1);
    presence.clear();
    subscribes.clear();
  }
  void name_it(const std::string& robot) { rename({{robot, {}, "nrf-7"}}); }

  std::uint16_t update_id = 0;
};

TEST(SnGateway, KeepsTheSessionOfARobotThatIsRenamed) {
  UnnamedRig rig;
  rig.name_it("tank");
  EXPECT_TRUE(rig.is_silent(1)) << "no DISCONNECT";
  EXPECT_EQ(presence_lines(rig), (Lines{"nrf-7 offline", "tank online"}));
  EXPECT_EQ(rig.gateway.presence_of("tank"), Presence::online);
  EXPECT_EQ(rig.gateway.presence_of("nrf-7"), std::nullopt);

  rig.publish(1, rig.update_id, 1, 7);
  ASSERT_EQ(rig.reports.size(), 1U);
  EXPECT_EQ(rig.reports[0].robot, "tank");
  EXPECT_EQ(rig.reports[0].topic, "ntnu-slam/robot/tank/update");
  EXPECT_EQ(rig.register_topic(1, "ntnu-slam/robot/nrf-7/update"), rig.update_id);
  EXPECT_TRUE(rig.notices.empty());
  ASSERT_TRUE(rig.gateway.has_changed()) << "the new name is to be saved";
  EXPECT_EQ(rig.gateway.snapshot("nrf-7", rig.now)->robot, "tank");
}

TEST(SnGateway, SubscribesToTheNewNameOfARobotThatIsRenamed) {
  UnnamedRig rig;
  rig.name_it("tank");
  EXPECT_TRUE(rig.filters["nrf-7"].empty());
  EXPECT_EQ(rig.filters["tank"],
            (std::set<std::string>{"ntnu-slam/server/tank/+", "ntnu-slam/server/tank/cmd"}));
  for (const SubscribeRequest& request : rig.subscribes)
    EXPECT_FALSE(request.is_standing) << "they are new subscriptions of the new name";

  rig.broker("ntnu-slam/server/tank/cmd", "x", 1);
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=0 qos=1 retain=0 normal id=2 msg=1 data=78");
  rig.send(1, Puback{2, 1, ReturnCode::accepted});
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].robot, "tank");
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::delivered);

  rig.broker("ntnu-slam/server/tank/run", "x", 1);
  EXPECT_EQ(rig.last_to(1), "REGISTER id=3 msg=2 topic=ntnu-slam/server/nrf-7/run")
      << "its firmware uses only its client id";
}

TEST(SnGateway, DeliversRetainedCommandsOfTheNewName) {
  UnnamedRig rig;
  rig.name_it("tank");
  rig.broker("ntnu-slam/server/tank/cmd", "x", 1, true);
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=0 qos=1 retain=1 normal id=2 msg=1 data=78");
}

TEST(SnGateway, DeliversQueuedCommandsToARobotThatIsRenamed) {
  UnnamedRig rig;
  rig.broker("ntnu-slam/server/nrf-7/cmd", "1", 1);
  rig.sleep(1);
  rig.broker("ntnu-slam/server/nrf-7/cmd", "2", 1);
  presence_lines(rig);
  rig.name_it("tank");
  EXPECT_EQ(presence_lines(rig), (Lines{"nrf-7 offline", "tank asleep"}));
  EXPECT_TRUE(rig.is_silent(1));
  rig.send(1, Pingreq{"nrf-7"});
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=1 qos=1 retain=0 normal id=2 msg=1 data=31");
  rig.send(1, Puback{2, 1, ReturnCode::accepted});
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=0 qos=1 retain=0 normal id=2 msg=2 data=32");
  rig.send(1, Puback{2, 2, ReturnCode::accepted});
  ASSERT_EQ(rig.outcomes.size(), 2U);
  for (const CommandOutcome& outcome : rig.outcomes) {
    EXPECT_EQ(outcome.result, CommandResult::delivered);
    EXPECT_EQ(outcome.robot, "nrf-7") << "the command was sent to the old name";
  }
}

TEST(SnGateway, TimesOutAQueuedCommandOfARobotThatIsRenamed) {
  UnnamedRig rig;
  rig.sleep(1);
  rig.broker("ntnu-slam/server/nrf-7/cmd", "1", 1);
  rig.name_it("tank");
  rig.pass_s(40);
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].why, "the robot sleeps and did not wake in time");
  rig.send(1, Pingreq{"nrf-7"});
  EXPECT_EQ(rig.sent_to(1), Lines{"PINGRESP"});
}

TEST(SnGateway, SwapsTheNamesOfTwoRobots) {
  SnRig rig({}, {{"a", {}, "c1"}, {"b", {}, "c2"}});
  std::uint16_t ids[3] = {};
  for (const unsigned n : {1U, 2U}) {
    const std::string id = "c" + std::to_string(n);
    rig.connect(n, id);
    ids[n] = rig.register_topic(n, "ntnu-slam/robot/" + id + "/update");
    rig.subscribe(n, "ntnu-slam/server/" + id + "/cmd", 0);
  }
  presence_lines(rig);
  rig.rename({{"b", {}, "c1"}, {"a", {}, "c2"}});
  EXPECT_EQ(rig.gateway.presence_of("a"), Presence::online);
  EXPECT_EQ(rig.gateway.presence_of("b"), Presence::online);
  const Lines lines = presence_lines(rig);
  ASSERT_EQ(lines.size(), 4U);
  EXPECT_TRUE(lines[2].ends_with("online") && lines[3].ends_with("online")) << "after offline";
  EXPECT_EQ(rig.filters["a"], std::set<std::string>{"ntnu-slam/server/a/cmd"});
  EXPECT_EQ(rig.filters["b"], std::set<std::string>{"ntnu-slam/server/b/cmd"});
  rig.publish(1, ids[1], 0, 0);
  rig.publish(2, ids[2], 0, 0);
  ASSERT_EQ(rig.reports.size(), 2U);
  EXPECT_EQ(rig.reports[0].topic, "ntnu-slam/robot/b/update");
  EXPECT_EQ(rig.reports[1].topic, "ntnu-slam/robot/a/update");
  rig.broker("ntnu-slam/server/a/cmd");
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(rig.sent_to(2).size(), 1U);
}

TEST(SnGateway, UsesTheClientIdAgainWhenARobotLosesItsName) {
  RenamedRig rig;
  const auto id = rig.register_topic(1, "ntnu-slam/robot/tank/update");
  rig.subscribe(1, "ntnu-slam/server/nrf-7/+", 1);
  rig.rename({});
  EXPECT_TRUE(rig.is_silent(1));
  rig.publish(1, id, 0, 0);
  ASSERT_EQ(rig.reports.size(), 1U);
  EXPECT_EQ(rig.reports[0].topic, "ntnu-slam/robot/nrf-7/update");
  rig.broker("ntnu-slam/server/nrf-7/run", "x", 1);
  EXPECT_EQ(rig.last_to(1), "REGISTER id=2 msg=1 topic=ntnu-slam/server/nrf-7/run");
}

TEST(SnGateway, DisconnectsAClientWhoseIdBecomesAnotherRobotsName) {
  SnRig rig;
  rig.connect(1, "c1");
  rig.connect(2, "tank");
  rig.rename({{"tank", {}, "c1"}});
  EXPECT_EQ(rig.last_to(2), "DISCONNECT plain");
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(rig.gateway.presence_of("tank"), Presence::online);
  EXPECT_EQ(presence_lines(rig).back(), "tank online");
}

TEST(SnGateway, RenamesARobotThatIsSubscribedToItsNewName) {
  UnnamedRig rig;
  rig.subscribe(1, "ntnu-slam/robot/tank/update", 0);
  rig.subscribe(1, "ntnu-slam/robot/nrf-7/update", 1);
  rig.name_it("tank");
  rig.publish(1, rig.update_id, 0, 0);
  EXPECT_EQ(rig.reports.back().topic, "ntnu-slam/robot/tank/update");
  rig.broker("ntnu-slam/robot/tank/update", "x", 1);
  EXPECT_EQ(rig.sent_to(1).size(), 1U) << "one copy for both filters";
  rig.send(1, Unsubscribe{TopicIdType::normal, 9, "ntnu-slam/robot/tank/update", 0});
  rig.sent_to(1);
  rig.broker("ntnu-slam/robot/tank/update", "x", 1);
  EXPECT_TRUE(rig.is_silent(1));
}

TEST(SnGateway, RenamesARobotDuringItsWillHandshake) {
  SnRig rig;
  rig.send(1, Connect{true, true, 1, 60, "nrf-7"});
  rig.send(1, WillTopic{WireQos::one, false, "ntnu-slam/robot/nrf-7/gone"});
  rig.rename({{"tank", {}, "nrf-7"}});
  rig.send(1, WillMsg{to_bytes("bye")});
  EXPECT_EQ(rig.last_to(1), "CONNACK code=0");
  rig.rename({{"lego", {}, "nrf-7"}});
  rig.pass_s(100);
  ASSERT_EQ(rig.reports.size(), 1U);
  EXPECT_EQ(rig.reports[0].topic, "ntnu-slam/robot/lego/gone") << "the will is renamed, too";
}

TEST(SnGateway, RenamesARobotOverARestart) {
  UnnamedRig before;
  before.sleep(1);
  before.broker("ntnu-slam/server/nrf-7/cmd", "1", 1);
  const Bytes stored = encode_session(*before.gateway.snapshot("nrf-7", before.now));
  SnRig after({}, {{"tank", {}, "nrf-7"}});
  ASSERT_TRUE(after.gateway.restore(*decode_session(stored), after.now));
  after.broker_link(true);
  EXPECT_EQ(after.filters["tank"],
            (std::set<std::string>{"ntnu-slam/server/tank/+", "ntnu-slam/server/tank/cmd"}));
  for (const SubscribeRequest& request : after.subscribes)
    EXPECT_FALSE(request.is_standing) << "the new name has no session at the broker";
  EXPECT_EQ(after.gateway.presence_of("tank"), Presence::asleep);
  after.send(1, Pingreq{"nrf-7"});
  EXPECT_EQ(after.last_to(1), "PUBLISH dup=0 qos=1 retain=0 normal id=2 msg=1 data=31");
  after.publish(1, before.update_id, 0, 0);
  EXPECT_EQ(after.reports.back().topic, "ntnu-slam/robot/tank/update");
}

}  // namespace
}  // namespace slamgw::mqttsn
