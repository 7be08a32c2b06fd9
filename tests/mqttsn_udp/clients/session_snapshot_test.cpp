// SPDX-License-Identifier: Apache-2.0
// Sessions that outlive the daemon: a second gateway made from the first one's snapshots.
#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "adapters/mqttsn_udp/clients/topic_table.hpp"
#include "adapters/mqttsn_udp/limits.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

/// Saves all changed sessions at once, as a store does.
void save(SnRig& rig, std::map<std::string, Bytes>& store) {
  for (const std::string& id : rig.gateway.take_changed(1000)) {
    if (const auto snapshot = rig.gateway.snapshot(id, rig.now)) {
      store[id] = encode_session(*snapshot);
    } else {
      store.erase(id);
    }
  }
}

void restart(SnRig& before, SnRig& after) {
  std::map<std::string, Bytes> store;
  save(before, store);
  after.now = before.now;
  for (const auto& [id, content] : store) {
    const auto snapshot = decode_session(content);
    ASSERT_TRUE(snapshot) << id;
    EXPECT_TRUE(after.gateway.restore(*snapshot, after.now));
  }
  after.broker_link(true);  // drains the actions of restoring
}

TEST(SnGateway, R47_RestoresTopicsSubscriptionsAndWillAfterARestart) {
  SnRig before;
  before.send(1, Connect{true, true, 1, 60, "r1"});
  before.send(1, WillTopic{WireQos::one, true, "ntnu-slam/robot/r1/gone"});
  before.send(1, WillMsg{to_bytes("bye")});
  const auto id = before.register_topic(1, own_topic);
  before.subscribe(1, "a/x", 1);
  SnRig after;
  restart(before, after);
  ASSERT_EQ(after.subscribes.size(), 1U);
  EXPECT_EQ(after.subscribes[0].filter, "a/x");
  EXPECT_EQ(after.subscribes[0].robot, "r1");
  EXPECT_TRUE(after.subscribes[0].is_standing) << "its retained messages were delivered before";
  EXPECT_EQ(after.presence.at(0).presence, Presence::online);
  EXPECT_TRUE(after.is_silent(1));
  after.publish(1, id, 1, 7);
  ASSERT_EQ(after.reports.size(), 1U);
  EXPECT_EQ(after.reports[0].topic, own_topic);
  after.broker("a/x", "down", 0);
  EXPECT_EQ(after.last_to(1), "PUBLISH dup=0 qos=0 retain=0 normal id=2 msg=0 data=646f776e");
  after.pass_s(100);
  ASSERT_EQ(after.reports.size(), 2U);
  EXPECT_TRUE(after.reports[1].is_will);
  EXPECT_EQ(after.reports[1].payload, to_bytes("bye"));
}

/// Length of a filter, so that few clients use up the shared bound.
constexpr std::size_t long_name = 20'000;

/// A client whose filters fitted keeps them, in whichever order the sessions are restored.
TEST(SnGateway, RestoresEveryFilterThatFittedBeforeARestart) {
  SnRig before;
  before.connect(1, "zz", false);
  for (int i = 0; i < 8; ++i) before.subscribe(1, "a/" + std::to_string(i), 1);
  SessionSnapshot wide = before.gateway.snapshot("zz", before.now).value();
  const SessionSnapshot last = wide;
  SnRig after;
  NameBudget taken;
  for (const auto& each : last.subscriptions) taken.take(NameBudget::of_filter(each.filter.size()));
  for (std::size_t n = 0; n < 60; ++n) {  // uses the shared bound first, then each client's own
    wide.client_id = wide.robot = "c" + std::to_string(n);
    wide.peer.reset();
    wide.subscriptions.clear();
    std::size_t held = 0;
    for (std::size_t i = 0; i < limits::max_subscriptions_per_client; ++i) {
      std::string filter = "a/" + wide.client_id + "-" + std::to_string(i);
      filter += "/" + std::string(long_name, 'x');
      const std::size_t octets = NameBudget::of_filter(filter.size());
      if (!taken.may_take(held, octets)) {
        filter = "a/" + wide.client_id + "-" + std::to_string(i);
        if (!taken.may_take(held, NameBudget::of_filter(filter.size()))) break;
      }
      held += NameBudget::of_filter(filter.size());
      taken.take(NameBudget::of_filter(filter.size()));
      wide.subscriptions.push_back({filter});
    }
    ASSERT_TRUE(after.gateway.restore(wide, after.now));
    EXPECT_EQ(after.gateway.snapshot(wide.client_id, after.now)->subscriptions.size(),
              wide.subscriptions.size());
  }
  EXPECT_FALSE(taken.may_take(limits::name_octets_for_each, 1024)) << "the shared bound is used up";
  ASSERT_TRUE(after.gateway.restore(last, after.now));
  EXPECT_EQ(after.gateway.snapshot("zz", after.now)->subscriptions.size(), 8U);
}

/// Earlier versions had no shared bound.
TEST(SnGateway, RestoresNoMoreFiltersThanTheSharedBound) {
  constexpr std::size_t clients = 45;
  SnRig before;
  before.connect(1, "c", false);
  SessionSnapshot kept = before.gateway.snapshot("c", before.now).value();
  SnRig after;
  std::size_t charged = 0;
  std::size_t restored = 0;
  for (std::size_t n = 0; n < clients; ++n) {
    kept.client_id = kept.robot = "c" + std::to_string(n);
    kept.peer.reset();
    kept.state = ClientState::disconnected;
    kept.subscriptions.clear();
    for (std::size_t i = 0; i < limits::max_subscriptions_per_client; ++i) {
      std::string filter = "a/" + kept.client_id + "-" + std::to_string(i);
      filter += "/" + std::string(long_name, 'x');
      kept.subscriptions.push_back({filter});
    }
    ASSERT_TRUE(after.gateway.restore(kept, after.now));
    const auto came_back = after.gateway.snapshot(kept.client_id, after.now);
    ASSERT_TRUE(came_back);
    for (const auto& each : came_back->subscriptions) {
      charged += NameBudget::of_filter(each.filter.size());
      ++restored;
    }
  }
  EXPECT_LE(charged, limits::name_octets_together + 2 * clients * limits::name_octets_for_each);
  EXPECT_GT(charged, limits::name_octets_together / 2);
  EXPECT_LT(restored, clients * limits::max_subscriptions_per_client);
  after.broker_link(true);
  ASSERT_FALSE(after.notices.empty());
  EXPECT_NE(after.notices.back().text.find("are larger than the bound"), std::string::npos)
      << after.notices.back().text;
}

TEST(SnGateway, ReportsKeptSubscriptionsThatAreNoLongerAllowed) {
  SnRig before;
  before.connect(1, "c", false);
  SessionSnapshot kept = before.gateway.snapshot("c", before.now).value();
  kept.subscriptions.push_back({"ntnu-slam/secret/#"});
  kept.subscriptions.push_back({"x/+"});
  SnRig after;
  ASSERT_TRUE(after.gateway.restore(kept, after.now));
  EXPECT_TRUE(after.gateway.snapshot("c", after.now).value().subscriptions.empty());
  after.broker_link(true);
  ASSERT_EQ(after.notices.size(), 1U);
  EXPECT_NE(after.notices[0].text.find(
                "c's kept subscriptions to 'ntnu-slam/secret/#', 'x/+' are given up"),
            std::string::npos);
}

const std::string cmd_topic = "ntnu-slam/server/r1/cmd";
const std::string run_topic = "ntnu-slam/server/r1/run";

/// Leaves a `cmd` in flight and a `run` behind it, both nine seconds old.
void leave_two_commands(SnRig& before) {
  before.connect(1, "r1", false, 6000);
  before.subscribe(1, cmd_topic, 1);
  before.subscribe(1, run_topic, 1);
  before.broker(cmd_topic, "1", 1);
  before.broker(run_topic, "2", 1);
  before.pass_s(9);
  before.gateway.set_all_dirty();
}

TEST(SnGateway, ReportsOutcomesOfCommandsUnderWayAtARestart) {
  SnRig before, after;
  leave_two_commands(before);
  restart(before, after);
  after.pass_s(1);
  after.send(1, Puback{1, 1, ReturnCode::accepted});
  after.send(1, Puback{2, 258, ReturnCode::accepted});
  ASSERT_EQ(after.outcomes.size(), 2U);
  EXPECT_EQ(after.outcomes[0].type, "cmd");
  EXPECT_EQ(after.outcomes[1].type, "run");
  for (const CommandOutcome& outcome : after.outcomes) {
    EXPECT_EQ(outcome.robot, "r1");
    EXPECT_EQ(outcome.result, CommandResult::delivered);
    EXPECT_EQ(outcome.after, std::chrono::seconds(10));
  }
}

TEST(SnGateway, KeepsTheTimeoutOfACommandOverARestart) {
  SnRig before, after;
  leave_two_commands(before);
  restart(before, after);
  after.pass_s(19);
  EXPECT_TRUE(after.outcomes.empty());
  after.broker(cmd_topic, "later", 1);
  after.pass_s(1);
  ASSERT_EQ(after.outcomes.size(), 2U);
  EXPECT_EQ(after.outcomes[0].result, CommandResult::timeout);
  EXPECT_EQ(after.outcomes[0].after, limits::command_patience);
  after.pass_s(28);
  EXPECT_EQ(after.outcomes.size(), 3U) << "the third command times out last";
}

TEST(SnGateway, CountsItsDowntimeTowardsTheTimeoutOfCommands) {
  for (const bool is_rebooted : {false, true}) {
    SnRig before, after;
    leave_two_commands(before);
    const auto snapshot = *before.gateway.snapshot("r1", before.now);
    after.now =
        is_rebooted ? TimePoint(std::chrono::seconds(70)) : before.now + std::chrono::seconds(15);
    ASSERT_TRUE(after.gateway.restore(snapshot, after.now));
    after.broker_link(true);  // drains
    after.pass_s(is_rebooted ? 0 : 4);
    EXPECT_EQ(after.outcomes.size(), is_rebooted ? 2U : 0U);
    after.pass_s(1);
    ASSERT_EQ(after.outcomes.size(), 2U);
    EXPECT_EQ(after.outcomes[0].result, CommandResult::timeout);
  }
}

TEST(SnGateway, RefusesCommandsOfASessionThatCannotBeRestored) {
  SnRig before;
  leave_two_commands(before);
  const auto snapshot = *before.gateway.snapshot("r1", before.now);
  SnRig after({}, {{"r1", {}, "other"}});
  EXPECT_FALSE(after.gateway.restore(snapshot, before.now));
  after.broker_link(true);  // drains
  ASSERT_EQ(after.outcomes.size(), 2U);
  EXPECT_EQ(after.outcomes[1].robot, "r1");
  EXPECT_EQ(after.outcomes[1].type, "run");
  EXPECT_EQ(after.outcomes[1].result, CommandResult::refused);
}

TEST(SnGateway, DropsDamagedCommandsAndBoundsTheirAgeAtARestore) {
  SnRig before;
  leave_two_commands(before);
  auto snapshot = *before.gateway.snapshot("r1", before.now);
  snapshot.messages[0].message.topic.back() = '\xff';
  snapshot.messages[1].command_age = std::chrono::hours(1000);
  SnRig after;
  ASSERT_TRUE(after.gateway.restore(snapshot, after.now));
  after.pass_s(60);
  ASSERT_EQ(after.outcomes.size(), 1U);
  EXPECT_EQ(after.outcomes[0].after, std::chrono::hours(1));
}

/// In a fleet another gateway may have reported the outcome already. The age shows it.
TEST(SnGateway, ReportsTheFullAgeOfACommandRestoredLate) {
  SnRig before, after;
  leave_two_commands(before);
  const auto snapshot = *before.gateway.snapshot("r1", before.now);
  after.now = before.now + std::chrono::minutes(5);
  ASSERT_TRUE(after.gateway.restore(snapshot, after.now));
  after.broker_link(true);  // drains
  after.pass_s(1);
  ASSERT_EQ(after.outcomes.size(), 2U);
  EXPECT_EQ(after.outcomes[0].result, CommandResult::timeout);
  EXPECT_GE(after.outcomes[0].after, std::chrono::minutes(5));
}

TEST(SnGateway, ReportsNoOutcomeAgainAfterARestart) {
  SnRig before, after;
  leave_two_commands(before);
  std::map<std::string, Bytes> taken;
  save(before, taken);
  before.pass_s(30);
  EXPECT_EQ(before.outcomes.size(), 2U);
  restart(before, after);
  EXPECT_EQ(after.gateway.queued_for("r1"), 0U) << "the command is not sent again";
  after.pass_s(60);
  EXPECT_TRUE(after.outcomes.empty());
}

TEST(SnGateway, SendsNoPubrelForATimedOutCommandAfterARestart) {
  SnRig before;
  before.connect(1, "r1", false, 6000);
  before.subscribe(1, cmd_topic, 2);
  before.broker(cmd_topic, "1", 2);
  before.pass_s(30);
  ASSERT_EQ(before.outcomes.size(), 1U);
  EXPECT_EQ(before.outcomes[0].result, CommandResult::timeout);
  SnRig after;
  restart(before, after);
  after.send(1, Pubrec{1});
  EXPECT_TRUE(after.is_silent(1)) << "no PUBREL";
}

TEST(SnGateway, ReportsNoRefusalAgainAfterARestart) {
  SnRig before, after;
  before.connect(1, "r1", false, 6000);
  before.subscribe(1, "ntnu-slam/server/r1/+", 1);
  before.broker(cmd_topic, "1", 1);
  std::map<std::string, Bytes> store;
  save(before, store);
  const auto asked = before.last_to(1);
  ASSERT_TRUE(asked.starts_with("REGISTER")) << asked;
  before.send(1, Regack{1, 1, ReturnCode::not_supported});
  ASSERT_EQ(before.outcomes.size(), 1U);
  restart(before, after);
  after.pass_s(60);
  EXPECT_TRUE(after.outcomes.empty());
}

TEST(SnGateway, KeepsTheWholeQueueOfASleeperAtShutdown) {
  Settings settings;
  settings.max_sleeping_messages = 2;
  ConnectedRig rig(settings);
  rig.subscribe(1, "a/x", 1);
  for (int i = 0; i < 10; ++i) rig.broker("a/x", "hi", 1);
  rig.sleep(1, 300);
  const auto queued = rig.gateway.queued_for("r1");
  rig.stop();
  EXPECT_EQ(rig.gateway.queued_for("r1"), queued);
  EXPECT_EQ(queued, 10U);
}

TEST(SnGateway, RefusesUnregisteredAndLateCommandsAtShutdown) {
  ConnectedRig rig;
  rig.subscribe(1, "ntnu-slam/server/r1/+", 1);
  rig.broker(cmd_topic, "unregistered", 0);
  EXPECT_TRUE(rig.outcomes.empty());
  rig.stop();
  EXPECT_EQ(rig.outcomes.size(), 1U);
  rig.broker(run_topic, "too late", 0);
  ASSERT_EQ(rig.outcomes.size(), 2U);
  EXPECT_EQ(rig.outcomes[1].result, CommandResult::refused);
}

TEST(SnGateway, RefusesQos0CommandsOfASleeperAtShutdown) {
  ConnectedRig rig;
  rig.subscribe(1, cmd_topic, 1);
  rig.sleep(1, 300);
  rig.broker(cmd_topic, "kept", 1);
  rig.broker(cmd_topic, "not kept", 0);
  rig.stop();
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::refused);
  EXPECT_EQ(rig.gateway.queued_for("r1"), 1U);
}

TEST(SnGateway, R47_DeliversInFlightAndQueuedMessagesAfterARestart) {
  ConnectedRig before(false);
  before.subscribe(1, "a/x", 2);
  before.broker("a/x", "1", 2);
  before.broker("a/x", "2", 1);
  before.broker("a/x", "lost", 0);
  before.send(1, Pubrec{1});
  SnRig after;
  restart(before, after);
  EXPECT_EQ(after.sent_to(1), Lines{"PUBREL msg=1"});
  after.send(1, Pubcomp{1});
  EXPECT_EQ(after.sent_to(1), Lines{"PUBLISH dup=0 qos=1 retain=0 normal id=1 msg=258 data=32"});
  after.send(1, Puback{1, 258, ReturnCode::accepted});
  EXPECT_EQ(after.gateway.queued_for("r1"), 0U);
}

TEST(SnGateway, R47_RecognizesARepeatedQos2MessageAfterARestart) {
  ConnectedRig before(false);
  const auto id = before.register_topic(1, own_topic);
  before.publish(1, id, 2, 7);
  before.receipt(before.reports.at(0).receipt.id);
  SnRig after;
  restart(before, after);
  after.publish(1, id, 2, 7);
  EXPECT_TRUE(after.reports.empty());
  EXPECT_EQ(after.last_to(1), "PUBREC msg=7");
}

TEST(SnGateway, R75_ServesAClientWithoutPubrelOverARestart) {
  ConnectedRig before(false);
  const auto topic = before.register_topic(1, own_topic);
  const auto publish = [&](SnRig& rig, std::uint16_t msg_id) {
    rig.publish(1, topic, 2, msg_id);
    ASSERT_FALSE(rig.reports.empty());
    rig.receipt(rig.reports.back().receipt.id);
    EXPECT_EQ(rig.last_to(1), "PUBREC msg=" + std::to_string(msg_id));
  };
  constexpr std::uint16_t many = limits::max_inbound_qos2;
  for (std::uint16_t msg_id = 1; msg_id <= many; ++msg_id) publish(before, msg_id);
  SnRig after;
  restart(before, after);
  for (std::uint16_t msg_id = many + 1; msg_id <= 2 * many; ++msg_id) publish(after, msg_id);
  EXPECT_EQ(after.reports.size(), many);
  after.publish(1, topic, 2, many + 1);
  EXPECT_EQ(after.reports.size(), many) << "the oldest entries are dropped first";
}

TEST(SnGateway, R76_RecognizesRepeatsAfterARestart) {
  ConnectedRig before;
  const auto id = before.register_topic(1, own_topic);
  before.publish(1, id, 1, 7, "step");
  before.publish(1, id, 1, 8, "not safe yet");
  before.receipt(before.reports.at(0).receipt.id);
  before.pass_s(8);
  before.gateway.set_all_dirty();
  SnRig after;
  restart(before, after);
  after.publish(1, id, 1, 7, "step");
  EXPECT_TRUE(after.reports.empty());
  EXPECT_EQ(after.last_to(1), "PUBACK id=1 msg=7 code=0");
  after.publish(1, id, 1, 8, "not safe yet");
  EXPECT_EQ(after.reports.size(), 1U);
}

/// Its PUBACK was lost right after the restart, and the client repeats without DUP a second later.
TEST(SnGateway, R76_RemembersOverARestartThatAClientCountsMsgIds) {
  ConnectedRig before;
  const auto id = before.register_topic(1, own_topic);
  before.gateway.take_changed(1000);
  for (std::uint16_t msg_id = 7; msg_id < 8 + limits::min_counted_ids; ++msg_id)
    before.publish(1, id, 1, msg_id, "step");
  EXPECT_EQ(before.gateway.take_changed(1000), Lines{"r1"}) << "counting ids is saved";
  before.gateway.set_all_dirty();
  SnRig after;
  restart(before, after);
  after.publish(1, id, 1, 20, "the first after the restart");
  after.receipt(after.reports.at(0).receipt.id);
  after.pass_s(1);
  after.publish(1, id, 1, 20, "the first after the restart");
  EXPECT_EQ(after.reports.size(), 1U);
}

/// An earlier version accepted wildcards as short names.
TEST(SnGateway, R85_RegistersTheNameOfAMessageForAKeptShortWildcard) {
  SnRig before({}, {}, {}, {"#"});
  before.connect(1, "r1", false);
  SessionSnapshot kept = before.gateway.snapshot("r1", before.now).value();
  kept.subscriptions = {{"+/", Qos::at_most_once, TopicIdType::short_name, 0}};
  kept.messages = {
      {{"/", to_bytes("old"), Qos::at_least_once}, Qos::at_least_once, TopicIdType::short_name}};
  SnRig after({}, {}, {}, {"#"});
  ASSERT_TRUE(after.gateway.restore(kept, after.now));
  after.robot_message({"r1", {"abc/", to_bytes("hi"), Qos::at_most_once}});
  EXPECT_EQ(after.last_to(1).substr(0, 8), "REGISTER");
}

/// A message after the snapshot has used the next MsgId. If its PUBREL was lost, the robot still
/// takes this MsgId for that message.
TEST(SnGateway, R90_ReusesNoMsgIdAfterACrash) {
  ConnectedRig before(false);
  before.subscribe(1, "a/x", 2);
  before.sent_to(1);
  SessionSnapshot kept = before.gateway.snapshot("r1", before.now).value();
  std::set<std::string> used;
  for (int i = 0; i < 200; ++i) {
    before.broker("a/x", "hi", 2);
    used.insert(before.last_to(1));
    before.send(1, Pubrec{static_cast<std::uint16_t>(i + 1)});
    before.send(1, Pubcomp{static_cast<std::uint16_t>(i + 1)});
  }
  EXPECT_EQ(used.size(), 200U);
  const auto first_after = [](const SessionSnapshot& snapshot) {
    SnRig after;
    EXPECT_TRUE(after.gateway.restore(snapshot, after.now));
    after.robot_message({"r1", {"a/x", to_bytes("hi"), Qos::exactly_once}});
    return after.last_to(1);
  };
  kept.last_msg_id = 1;
  EXPECT_FALSE(used.contains(first_after(kept)));
  kept.last_msg_id = highest_msg_id - 1;
  EXPECT_EQ(first_after(kept), "PUBLISH dup=0 qos=2 retain=0 normal id=1 msg=256 data=6869");
}

TEST(SnGateway, R76_RecognizesARepeatAfterACrashIfTheClientSendsRarely) {
  SnRig before;
  before.prove(1, "r1");
  const auto id = before.register_topic(1, own_topic);
  const auto say = [&](std::uint16_t msg_id) {
    before.publish(1, id, 1, msg_id, "step");
    before.receipt(before.reports.back().receipt.id);
  };
  before.gateway.take_changed(1000);
  say(100);
  SnRig after;
  restart(before, after);
  after.send_octets(1, encode(Publish{true, WireQos::one, false, TopicIdType::normal, id, 100,
                                      to_bytes("step")}));
  EXPECT_TRUE(after.reports.empty());
  EXPECT_EQ(after.last_to(1), "PUBACK id=" + std::to_string(id) + " msg=100 code=0");

  for (std::uint16_t n = 1; n <= 2 * limits::max_repeats_saved_at_once; ++n) say(100 + n);
  before.gateway.take_changed(1000);
  say(99);
  EXPECT_FALSE(before.gateway.has_changed()) << "saving each message would cost too many writes";
  before.pass(limits::repeat_window + std::chrono::seconds{1});
  before.gateway.take_changed(1000);
  say(98);
  EXPECT_TRUE(before.gateway.has_changed());
}

TEST(SnGateway, R47_RestoresSleepingAndDisconnectedClients) {
  ConnectedRig before;
  before.subscribe(1, "a/x", 1);
  before.sleep(1, 100);
  before.broker("a/x", "1", 1);
  before.connect(2, "r2", false);
  before.send(2, Disconnect{});
  SnRig after;
  restart(before, after);
  EXPECT_EQ(after.gateway.presence_of("r1"), Presence::asleep);
  EXPECT_EQ(after.gateway.presence_of("r2"), Presence::offline);
  EXPECT_EQ(after.gateway.snapshot("r2", after.now)->state, ClientState::disconnected);
  EXPECT_TRUE(after.is_silent(1));
  after.send(1, Pingreq{"r1"});
  EXPECT_EQ(after.sent_to(1).size(), 1U);
}

TEST(SnGateway, R113_RevivesALostSleeperByItsPingreqAfterARestart) {
  ConnectedRig before(false);
  before.sleep(1, 100);
  before.pass_s(151);
  SnRig after;
  restart(before, after);
  EXPECT_EQ(after.gateway.presence_of("r1"), Presence::offline);
  after.send(1, Pingreq{"r1"});
  EXPECT_EQ(after.sent_to(1), Lines{"PINGRESP"});
  EXPECT_EQ(after.gateway.presence_of("r1"), Presence::asleep);
}

TEST(SnGateway, ListsOnlyChangedSessionsForSaving) {
  ConnectedRig rig;
  rig.connect(2, "r2");
  EXPECT_EQ(rig.gateway.take_changed(1000), (Lines{"r1", "r2"}));
  rig.send(1, Pingreq{});
  EXPECT_TRUE(rig.gateway.take_changed(1000).empty());
  rig.register_topic(2, "ntnu-slam/robot/r2/adv");
  EXPECT_EQ(rig.gateway.take_changed(1000), Lines{"r2"});
  rig.send(1, Disconnect{});
  EXPECT_EQ(rig.gateway.take_changed(1000), Lines{"r1"});
  EXPECT_FALSE(rig.gateway.snapshot("r1", TimePoint{})) << "a clean session ends with DISCONNECT";
}

TEST(SnGateway, ListsChangedSessionsInBatches) {
  SnRig rig;
  for (unsigned n = 0; n < 5; ++n) rig.connect(n, "r" + std::to_string(n));
  EXPECT_EQ(rig.gateway.take_changed(3).size(), 3U);
  EXPECT_TRUE(rig.gateway.has_changed());
  EXPECT_EQ(rig.gateway.take_changed(3).size(), 2U);
  EXPECT_FALSE(rig.gateway.has_changed());
}

/// A session with a value for each field.
SessionSnapshot whole_session() {
  SessionSnapshot session;
  session.client_id = "nrf-7";
  session.robot = "r7";
  session.state = ClientState::asleep;
  session.peer = Peer{{{0xfd, 1}, 47193, 3}, "\x0a\xff", "nrf-7"};
  session.local = {{0xfd, 2}, 4, 1};
  session.is_validated = false;
  session.allowance = 300;
  session.is_clean = false;
  session.has_answered = true;
  session.uses_client_id = true;
  session.keep_alive = std::chrono::seconds(60);
  session.sleep_duration = std::chrono::seconds(70'000);
  session.will = Will{"w/x", to_bytes("bye"), Qos::at_least_once, true};
  session.topics = {{"a/1", 5, true, false}, {"a/2", 0xfffe, false, true}};
  session.subscriptions = {{"a/#", Qos::exactly_once, TopicIdType::short_name, 9}};
  session.messages = {{{"a/1", to_bytes("go"), Qos::exactly_once, true},
                       Qos::at_least_once,
                       TopicIdType::predefined,
                       7,
                       8,
                       std::chrono::milliseconds(1500)},
                      {{"a/2", {}, Qos::at_least_once}}};
  session.released = {1, 400};
  session.abandoned = {2};
  session.inbound_qos2 = {{3, 0xfedcba9876543210U}};
  session.repeats = {{4, 5, 6, std::chrono::milliseconds(70)}};
  session.counts_ids = true;
  session.last_msg_id = 0x1234;
  session.saved_at = TimePoint(std::chrono::milliseconds(5'000'000'000));
  return session;
}

/// That session as version 0.1.0 writes it.
constexpr std::string_view whole_record =
    "bf6776657273696f6e0169636c69656e745f6964656e72662d3765726f626f7462723765737461746501656c"
    "6f63616c50fd02000000000000000000000000000069696e746572666163650466736f636b65740165636c65"
    "616ef46e757365735f636c69656e745f6964f56c6b6565705f616c6976655f73183c67736c6565705f731a00"
    "01117066746f706963739f9f63612f31f5f405ff9f63612f32f4f519fffeffff6d737562736372697074696f"
    "6e739f9f63612f23020209ffff686d657373616765739fbf65746f70696363612f31677061796c6f61644267"
    "6f6873656e745f716f73026672657461696ef563716f73016474797065016a707265646566696e656407666d"
    "73675f6964086a636f6d6d616e645f6d731905dcffbf65746f70696363612f32677061796c6f616440687365"
    "6e745f716f73016672657461696ef463716f73016474797065006a707265646566696e656400666d73675f69"
    "6400ffff6872656c65617365649f01190190ff696162616e646f6e65649f02ff6c696e626f756e645f716f73"
    "329f9f031bfedcba9876543210ffff67726570656174739f9f0405061846ffff6a636f756e74735f696473f5"
    "6b6c6173745f6d73675f696419123468616e737765726564f569616c6c6f77616e636519012c687361766564"
    "5f6d731b000000012a05f2006470656572bf676164647265737350fd01000000000000000000000000000064"
    "706f727419b8596573636f706503646e6f6465420aff686964656e74697479656e72662d37ff6477696c6cbf"
    "65746f70696363772f78676d6573736167654362796563716f73016672657461696ef5ffff";

TEST(SessionCodec, WritesAndReadsTheFormatOfVersion010) {
  EXPECT_EQ(to_hex(encode_session(whole_session())), whole_record);
  const auto read = decode_session(*from_hex(whole_record));
  ASSERT_TRUE(read);
  EXPECT_EQ(to_hex(encode_session(*read)), whole_record);
}

TEST(SessionCodec, RejectsOrRestoresDamagedRecordsSafely) {
  SnRig before;
  before.send(1, Connect{true, false, 1, 60, "r1"});
  before.send(1, WillTopic{WireQos::one, true, "ntnu-slam/robot/r1/gone"});
  before.send(1, WillMsg{to_bytes("bye")});
  before.register_topic(1, own_topic);
  before.subscribe(1, "a/x", 2);
  before.broker("a/x", "1", 2);
  before.broker("a/x", "2", 2);
  const Bytes sound = encode_session(*before.gateway.snapshot("r1", before.now));
  ASSERT_TRUE(decode_session(sound));
  std::size_t restored = 0;
  for (std::size_t at = 0; at < sound.size(); ++at) {
    EXPECT_FALSE(decode_session(ByteView(sound).first(at))) << at;
    for (const std::uint8_t mask : std::initializer_list<std::uint8_t>{0x01, 0xff}) {
      Bytes damaged = sound;
      damaged[at] ^= mask;
      const auto snapshot = decode_session(damaged);
      if (!snapshot) continue;
      SnRig after;
      restored += after.gateway.restore(*snapshot, after.now) ? 1 : 0;
      after.broker_link(true);
      after.send(1, Pingreq{"r1"});
      after.pass_s(200);
    }
  }
  EXPECT_GT(restored, 0U);
}

/// A client that may write below another gateway's topics at the broker can send such a record.
TEST(SessionCodec, RejectsDeeplyNestedRecords) {
  constexpr std::size_t octets = 130'000;
  for (const std::uint8_t head :
       std::initializer_list<std::uint8_t>{0x9f, 0xbf, 0x7f, 0x5f, 0x81, 0xa1, 0xc1, 0xd8}) {
    EXPECT_FALSE(decode_session(Bytes(octets, head))) << unsigned{head};
    Bytes keyed;  // each map is the value in the map before
    while (keyed.size() < octets) keyed.insert(keyed.end(), {0xbf, 0x61, 'a', head});
    EXPECT_FALSE(decode_session(keyed)) << unsigned{head};
  }
}

TEST(SessionCodec, RefusesLengthsBeyondTheOctets) {
  for (const std::uint8_t head : std::initializer_list<std::uint8_t>{0x5b, 0x7b, 0x9b, 0xbb}) {
    Bytes huge(9, 0xff);
    huge[0] = head;
    EXPECT_FALSE(decode_session(huge)) << unsigned{head};
    huge.resize(4);
    EXPECT_FALSE(decode_session(huge)) << unsigned{head};
  }
  EXPECT_FALSE(decode_session({}));
}

TEST(SnGateway, UnsubscribesRestoredFiltersThatAreNoLongerAllowed) {
  ConnectedRig before;
  before.subscribe(1, "a/x", 1);
  auto snapshot = *before.gateway.snapshot("r1", before.now);
  snapshot.subscriptions.push_back({"ntnu-slam/server/r2/cmd", Qos::at_least_once, {}, 9});
  SnRig after;
  EXPECT_TRUE(after.gateway.restore(snapshot, after.now));
  after.broker_link(true);
  EXPECT_EQ(after.filters["r1"], std::set<std::string>{"a/x"});
  ASSERT_EQ(after.unsubscribes.size(), 1U) << "the session at the broker still has it";
  EXPECT_EQ(after.unsubscribes[0].filter, "ntnu-slam/server/r2/cmd");
}

TEST(SnGateway, RestoresNoSessionUnderATakenName) {
  ConnectedRig before;
  const auto snapshot = before.gateway.snapshot("r1", TimePoint{});
  ASSERT_TRUE(snapshot);
  SnRig taken({}, {{"r1", {}, "tank"}});
  EXPECT_FALSE(taken.gateway.restore(*snapshot, taken.now)) << "another robot's name";
  SnRig twice;
  EXPECT_TRUE(twice.gateway.restore(*snapshot, twice.now));
  EXPECT_FALSE(twice.gateway.restore(*snapshot, twice.now));
}

}  // namespace
}  // namespace slamgw::mqttsn
