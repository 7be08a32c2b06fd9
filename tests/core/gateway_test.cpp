// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "tests/core/gateway_rig.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;

using GatewayTest = test::GatewayRig;

TEST_F(GatewayTest, SendsAReportUpWithItsReceipt) {
  say(update_from("NRF_5", {0x0a, 0x00, 0xec, 0xff, 0x99}));
  const auto uploads = drain<Upload>();
  ASSERT_EQ(uploads.size(), 1u);
  EXPECT_EQ(uploads[0].message.topic, "ntnu-slam/robot/NRF_5/update");
  EXPECT_EQ(to_hex(uploads[0].message.payload), "0a00ecff");
  EXPECT_EQ(uploads[0].message.qos, Qos::at_least_once);
  EXPECT_EQ(uploads[0].receipt, (Receipt{Mesh::thread, 7}));
}

TEST_F(GatewayTest, ShowsTrafficDecoded) {
  say(update_from("NRF_5", {0x0a, 0x00, 0xec, 0xff}));
  const auto passed = drain<PassUp>();
  ASSERT_EQ(passed.size(), 1u);
  EXPECT_EQ(passed[0].event.type, "update");
  ASSERT_TRUE(passed[0].event.update);
  EXPECT_EQ(passed[0].event.update->robot.y_cm, -20);
}

/// A client without a session (QoS -1) may publish to a predefined topic outside robots' trees.
TEST_F(GatewayTest, SendsAMessageOfNoRobotUpAndTracksNoRobot) {
  say(Report{.mesh = Mesh::thread,
             .robot = "",
             .topic = "x/common",
             .payload = to_bytes("hi"),
             .receipt = no_receipt});
  const auto uploads = drain<Upload>();
  ASSERT_EQ(uploads.size(), 1u);
  EXPECT_EQ(uploads[0].message.topic, "x/common");
  EXPECT_EQ(gateway.traffic().up, 1u);
  EXPECT_TRUE(gateway.registry().robots().empty());
}

TEST_F(GatewayTest, PublishesUnreadableUpdatesUnderRejectedAndReportsABurstOnce) {
  int notices = 0;
  for (int i = 0; i < 5; ++i) {
    say(update_from("NRF_5", {1, 2, 3}));
    while (auto action = gateway.next_action()) {
      if (std::holds_alternative<Notice>(*action)) ++notices;
      if (const auto* upload = std::get_if<Upload>(&*action)) {
        EXPECT_EQ(upload->message.topic, "ntnu-slam/gateway/pi1/rejected/NRF_5/update");
        EXPECT_EQ(upload->message.payload, (Bytes{1, 2, 3}));
        EXPECT_TRUE(upload->receipt.is_owed()) << "or the robot would repeat it for ever";
      }
    }
  }
  EXPECT_EQ(notices, 1);
  EXPECT_EQ(gateway.traffic().rejected, 5u);
  EXPECT_EQ(gateway.traffic().up, 5u) << "equal to the robot's own count";
}

/// A robot cannot clear a message under `rejected`.
TEST_F(GatewayTest, RetainsNoUnreadableUpdate) {
  Report update = update_from("NRF_5", {1, 2, 3});
  update.retain = true;
  say(update);
  const auto rejected = drain<Upload>();
  ASSERT_EQ(rejected.size(), 1u);
  EXPECT_FALSE(rejected[0].message.retain);
  EXPECT_EQ(gateway.retained().count(), 0u);
  EXPECT_EQ(gateway.traffic().not_retained, 0u);
}

TEST_F(GatewayTest, RetainsABoundedNumberOfTopicsForEachRobotAndInTotal) {
  const auto is_retained = [&](int robot, int type, const char* text) {
    const std::string name = "r" + std::to_string(robot);
    say(Report{.mesh = Mesh::thread,
               .robot = name,
               .topic = "ntnu-slam/robot/" + name + "/t" + std::to_string(type),
               .payload = to_bytes(text),
               .retain = true,
               .receipt = no_receipt});
    const auto up = drain<PassUp>();
    EXPECT_EQ(up.size(), 1u) << "it is published in any case";
    return !up.empty() && up[0].retain;
  };
  constexpr int most = RetainedTopics::max_per_robot;
  for (int type = 0; type < most; ++type) EXPECT_TRUE(is_retained(0, type, "x"));
  EXPECT_FALSE(is_retained(0, most, "x"));
  EXPECT_TRUE(is_retained(0, 3, "y")) << "a new value of a retained topic";
  EXPECT_TRUE(is_retained(0, 3, "")) << "cleared";
  EXPECT_TRUE(is_retained(0, most, "x")) << "a new topic after a cleared one";
  EXPECT_TRUE(is_retained(0, most + 1, "")) << "clearing costs nothing";
  int retained = 0;
  for (int robot = 1; robot < 500; ++robot)
    for (int type = 0; type < most; ++type) retained += is_retained(robot, type, "x") ? 1 : 0;
  EXPECT_EQ(retained, static_cast<int>(RetainedTopics::max_in_all) - most);
  EXPECT_GT(gateway.traffic().not_retained, 3000u);
}

TEST_F(GatewayTest, ClearsARetainedUpdateAtItsTopic) {
  const auto retain = [this](Bytes payload) {
    Report report = update_from("NRF_5", std::move(payload));
    report.retain = true;
    say(std::move(report));
    return drain<Upload>();
  };
  retain({0x0a, 0x00, 0xec, 0xff});
  EXPECT_EQ(gateway.retained().count(), 1u);
  const auto uploads = retain({});
  ASSERT_EQ(uploads.size(), 1u);
  EXPECT_EQ(uploads[0].message.topic, "ntnu-slam/robot/NRF_5/update");
  EXPECT_TRUE(uploads[0].message.payload.empty());
  EXPECT_TRUE(uploads[0].message.retain);
  EXPECT_EQ(gateway.retained().count(), 0u);
}

TEST_F(GatewayTest, RetainsOnlyTypesThatTheConfigurationNames) {
  Gateway strict(TopicScheme("ntnu-slam", "pi1"),
                 {.version = "0.1.0", .started = now.wall, .retain = {"map", "will"}}, broker,
                 [](Mesh, const std::string&) { return std::optional<Presence>{}; });
  std::string type;
  const auto is_retained = [&](const std::string& topic, const char* text) {
    strict.on_mesh_event(Report{.mesh = Mesh::thread,
                                .robot = "r",
                                .topic = topic,
                                .payload = to_bytes(text),
                                .retain = true,
                                .receipt = no_receipt},
                         now);
    std::optional<bool> retain;
    while (auto action = strict.next_action())
      if (const auto* up = std::get_if<PassUp>(&*action)) {
        retain = up->retain;
        type = up->event.type;
      }
    EXPECT_TRUE(retain) << "it is published in any case";
    return retain.value_or(false);
  };
  const std::string own = "ntnu-slam/robot/r/";
  EXPECT_TRUE(is_retained(own + "map", "x"));
  EXPECT_FALSE(is_retained(own + "maps", "x"));
  EXPECT_TRUE(is_retained(own + "maps", "")) << "clearing";
  EXPECT_EQ(strict.traffic().not_retained, 1u);
  EXPECT_TRUE(is_retained("lab/r/map", "x")) << "a foreign topic's type is its last level";
  EXPECT_EQ(type, "map");
}

TEST_F(GatewayTest, ReportsARobotThatRetainsTooManyTopicsOncePerBurst) {
  std::size_t notices = 0;
  for (int type = 0; type < 200; ++type) {
    gateway.on_mesh_event(Report{.mesh = Mesh::thread,
                                 .robot = "r",
                                 .topic = "ntnu-slam/robot/r/t" + std::to_string(type),
                                 .payload = to_bytes("x"),
                                 .retain = true,
                                 .receipt = no_receipt},
                          now);
    while (auto action = gateway.next_action())
      if (const auto* notice = std::get_if<Notice>(&*action)) {
        ++notices;
        EXPECT_NE(notice->text.find("'ntnu-slam/robot/r/t16' is published without"),
                  std::string::npos)
            << notice->text;
      }
  }
  EXPECT_EQ(notices, 1u);
}

TEST_F(GatewayTest, PublishesPresenceRetained) {
  broker_comes();
  say(PresenceChange{Mesh::ble, "ble-0100", Presence::online, "0x0100"});
  const auto uploads = drain<Upload>();
  ASSERT_EQ(uploads.size(), 1u);
  EXPECT_EQ(uploads[0].message.topic, "ntnu-slam/gateway/pi1/robots/ble-0100");
  EXPECT_TRUE(uploads[0].message.retain);
  const json state = json::parse(as_text(uploads[0].message.payload));
  EXPECT_EQ(state["state"], "online");
  EXPECT_EQ(state["mesh"], "ble");
  EXPECT_EQ(state["address"], "0x0100");
  EXPECT_EQ(state["since"], "2023-11-14T22:13:20Z");
}

TEST_F(GatewayTest, ShowsInThePresenceWhileARobotIsDeaf) {
  broker_comes();
  const auto presence = [&](bool is_deaf, std::chrono::seconds later) {
    gateway.on_mesh_event(PresenceChange{Mesh::ble, "a", Presence::online, "0x0100", is_deaf},
                          Now{now.mono + later, now.wall + later});
    return json::parse(as_text(drain<Upload>().back().message.payload));
  };
  const json before = presence(false, 0s);
  EXPECT_FALSE(before.contains("deaf"));
  const json deaf = presence(true, 5s);
  EXPECT_EQ(deaf["deaf"], true);
  EXPECT_EQ(deaf["state"], "online");
  EXPECT_EQ(deaf["since"], before["since"]) << "the state has not changed";
  EXPECT_EQ(gateway.registry().deaf(), 1u);
  EXPECT_FALSE(presence(false, 9s).contains("deaf"));
}

TEST_F(GatewayTest, KeepsTheTimeOfTheStateWhenOnlyTheAddressChanges) {
  broker_comes();
  const auto since = [&](const std::string& address, std::chrono::seconds later) {
    gateway.on_mesh_event(PresenceChange{Mesh::thread, "a", Presence::online, address},
                          Now{now.mono + later, now.wall + later});
    return json::parse(as_text(drain<Upload>().back().message.payload))["since"];
  };
  const json first = since("[fd00::1]:1", 0s);
  EXPECT_EQ(since("[fd00::2]:1", 60s), first);
}

TEST_F(GatewayTest, PublishesNoSignalOfAMeshThatTheRobotHasLeft) {
  broker_comes();
  Report report = update_from("a", {0x0a, 0x00, 0xec, 0xff});
  report.mesh = Mesh::ble;
  report.radio = RadioFacts{-61, 2, 3};
  say(PresenceChange{Mesh::ble, "a", Presence::online, "0x0100"});
  say(report);
  say(PresenceChange{Mesh::thread, "a", Presence::online, "[fd00::1]:1"});
  drain<Upload>();
  say(PresenceChange{Mesh::ble, "a", Presence::offline, "0x0100"});
  const auto uploads = drain<Upload>();
  ASSERT_FALSE(uploads.empty());
  const json state = json::parse(as_text(uploads.back().message.payload));
  EXPECT_EQ(state["mesh"], "thread");
  EXPECT_FALSE(state.contains("rssi_dbm"));
}

TEST_F(GatewayTest, AddsTheSignalOfTheRadioToPresenceOnce) {
  broker_comes();
  say(PresenceChange{Mesh::ble, "a", Presence::online, "0x0100"});
  drain<Upload>();
  Report report = update_from("a", {0x0a, 0x00, 0xec, 0xff});
  report.mesh = Mesh::ble;
  report.radio = RadioFacts{-61, 2, 3};
  say(report);
  const auto uploads = drain<Upload>();
  ASSERT_EQ(uploads.size(), 2u);
  EXPECT_EQ(uploads[0].message.topic, "ntnu-slam/gateway/pi1/robots/a");
  const std::string text(uploads[0].message.payload.begin(), uploads[0].message.payload.end());
  EXPECT_NE(text.find(R"("rssi_dbm":-61,"ttl":3,"hops":2)"), std::string::npos) << text;
  say(report);
  EXPECT_EQ(drain<Upload>().size(), 1u) << "a new signal alone publishes no presence";
  Report thread = update_from("a", {0x0b, 0x00, 0xec, 0xff});
  thread.mesh = Mesh::thread;
  say(thread);
  report.payload = {0x0c, 0x00, 0xec, 0xff};
  say(report);
  EXPECT_EQ(drain<Upload>().size(), 2u) << "nor does a message over the other mesh between";
}

TEST_F(GatewayTest, PublishesStateAndPresenceAgainAtEachConnection) {
  say(PresenceChange{Mesh::thread, "a", Presence::online, "[::1]:1"});
  EXPECT_TRUE(drain<Upload>().empty()) << "nothing is queued for an absent broker";
  for (int connection = 1; connection <= 2; ++connection) {
    broker_is(true);
    gateway.on_session_held("a", true, {}, now);
    std::vector<std::string> topics;
    for (const Upload& upload : drain<Upload>()) topics.push_back(upload.message.topic);
    EXPECT_EQ(topics, (std::vector<std::string>{"ntnu-slam/gateway/pi1/state",
                                                "ntnu-slam/gateway/pi1/robots/a"}));
    broker_is(false);
  }
}

TEST_F(GatewayTest, RenewsItsOwnSubscriptionsAtEachConnection) {
  const auto filters = [this] {
    std::vector<std::string> asked;
    for (const auto& each : drain<SubscribeAtBroker>())
      if (!test::is_of_rights_probe(each)) asked.push_back(each.filter);
    return asked;
  };
  gateway.subscribe_own("ntnu-slam/gateway/+/state");
  EXPECT_TRUE(filters().empty()) << "the broker is away";
  for (int connection = 1; connection <= 2; ++connection) {
    broker_is(true);
    EXPECT_EQ(filters(), std::vector<std::string>{"ntnu-slam/gateway/+/state"});
    broker_is(false);
    EXPECT_TRUE(filters().empty());
  }
  broker_is(true);
  EXPECT_EQ(filters().size(), 1u);
  gateway.subscribe_own("ntnu-slam/gateway/+/state");
  EXPECT_TRUE(filters().empty()) << "already subscribed";
  gateway.subscribe_own("ntnu-slam/fleet/all/+");
  EXPECT_EQ(filters(), std::vector<std::string>{"ntnu-slam/fleet/all/+"});
  gateway.unsubscribe_own("ntnu-slam/gateway/+/state");
  gateway.unsubscribe_own("ntnu-slam/gateway/+/state");
  const auto ended = drain<UnsubscribeAtBroker>();
  ASSERT_EQ(ended.size(), 1u);
  EXPECT_EQ(ended[0].filter, "ntnu-slam/gateway/+/state");
  broker_is(false);
  broker_is(true);
  EXPECT_EQ(filters(), std::vector<std::string>{"ntnu-slam/fleet/all/+"});
}

TEST_F(GatewayTest, LeavesRobotsSubscriptionsToTheirSessions) {
  broker_comes();
  say(SubscribeRequest{Mesh::thread, "a", "ntnu-slam/server/a/cmd", Qos::at_least_once});
  say(UnsubscribeRequest{Mesh::thread, "a", "ntnu-slam/server/a/cmd"});
  say(SessionCleaned{Mesh::thread, "a"});
  say(NoteChanged{Mesh::thread, "a", {1}});
  say(NoteRequest{Mesh::thread, "a"});
  EXPECT_FALSE(gateway.next_action());
  EXPECT_FALSE(gateway.registry().find("a"));
}

TEST_F(GatewayTest, MarksLeftoverRobotsOfAnEarlierRunOfflineUnlessHeard) {
  broker_comes();
  const auto kept = [&](const std::string& id, const std::string& state) {
    gateway.on_broker_message(
        {"ntnu-slam/gateway/pi1/robots/" + id,
         to_bytes(R"({"state":")" + state + R"(","mesh":"ble","since":"then"})"),
         Qos::at_least_once, true},
        now);
  };
  for (const char* id : {"gone", "heard", "broken\x01"}) kept(id, "online");
  kept("was", "offline");
  EXPECT_TRUE(drain<DeliverToMesh>().empty()) << "own presence is not delivered to meshes";
  say(PresenceChange{Mesh::ble, "heard", Presence::online, "0x0100"});
  drain<Upload>();
  gateway.on_deadline(now);
  EXPECT_TRUE(drain<Upload>().empty()) << "too early";
  now.mono += PresencePublisher::leftover_grace;
  EXPECT_LE(gateway.deadline(), now.mono);
  gateway.on_deadline(now);
  std::vector<std::string> offline;
  while (auto action = gateway.next_action()) {
    if (const auto* upload = std::get_if<Upload>(&*action)) {
      EXPECT_TRUE(upload->message.retain);
      offline.push_back(
          upload->message.topic.substr(29) + " " +
          std::string(upload->message.payload.begin(), upload->message.payload.end()));
    }
  }
  ASSERT_EQ(offline.size(), 2u);
  EXPECT_EQ(offline[1], R"(gone {"state":"offline","mesh":"ble","since":"2023-11-14T22:13:20Z"})");
  gateway.on_deadline(now);
  EXPECT_TRUE(drain<Upload>().empty()) << "once";
}

class CommandsTest : public GatewayTest {
 protected:
  static constexpr const char* topic = "ntnu-slam/server/a/cmd";

  /// Receives a command over the robot's session.
  std::optional<DeliverToMesh> server_sends(bool retain = false,
                                            std::chrono::milliseconds waited = 0ms) {
    gateway.commands().on_robot_message(
        {"a", {topic, {1, 2, 3, 4}, Qos::at_least_once, retain, {}, Waited{waited}}}, now);
    std::optional<DeliverToMesh> delivery;
    while (auto action = gateway.next_action()) {
      if (auto* it = std::get_if<DeliverToMesh>(&*action)) delivery = std::move(*it);
      if (auto* it = std::get_if<CommandOutcome>(&*action)) outcomes.push_back(std::move(*it));
    }
    return delivery;
  }
  CommandId command_sent(bool retain = false, std::chrono::milliseconds waited = 0ms) {
    const auto delivery = server_sends(retain, waited);
    return delivery ? delivery->message.command : CommandId::none;
  }
  CommandOutcome outcome_of(CommandId id, CommandResult result = CommandResult::delivered) {
    return {Mesh::ble, id, "a", "cmd", result, 5ms, ""};
  }
  void mesh_ends(CommandId id) {
    say(outcome_of(id));
    for (auto& outcome : drain<CommandOutcome>()) outcomes.push_back(std::move(outcome));
  }
  void pass(Duration time) {
    now.mono += time;
    gateway.on_deadline(now);
    for (auto& outcome : drain<CommandOutcome>()) outcomes.push_back(std::move(outcome));
  }

  std::vector<CommandOutcome> outcomes;
};

TEST_F(CommandsTest, GoOverTheFirstMeshThatReachesTheRobot) {
  using enum Presence;
  const auto carrier = [&](std::optional<Presence> ble, std::optional<Presence> thread) {
    reach.clear();
    if (ble) reach[{Mesh::ble, "a"}] = *ble;
    if (thread) reach[{Mesh::thread, "a"}] = *thread;
    const auto delivery = server_sends();
    EXPECT_NE(delivery->message.command, CommandId::none);
    return delivery->mesh;
  };
  EXPECT_EQ(carrier(online, std::nullopt), Mesh::ble);
  EXPECT_EQ(carrier(std::nullopt, asleep), Mesh::thread);
  EXPECT_EQ(carrier(online, online), Mesh::ble);
  EXPECT_EQ(carrier(offline, online), Mesh::thread) << "on Thread only";
  EXPECT_EQ(carrier(offline, asleep), Mesh::thread);
  EXPECT_EQ(carrier(offline, offline), Mesh::ble);
  EXPECT_EQ(carrier(std::nullopt, offline), Mesh::thread);
}

TEST_F(CommandsTest, GoToOneMeshWhileOtherMessagesGoToEachMesh) {
  reach[{Mesh::thread, "a"}] = Presence::online;
  const auto command = server_sends();
  ASSERT_TRUE(command);
  EXPECT_EQ(command->mesh, Mesh::thread);
  EXPECT_EQ(command->message.robot, "a");
  EXPECT_EQ(command->message.message.topic, topic);
  for (const char* other : {"ntnu-slam/robot/b/update", "ntnu-slam/server/b/cmd", "lab/x"}) {
    gateway.commands().on_robot_message(
        {"a", {other, {7}, Qos::exactly_once, true}, CommandId::none, /*is_unasked=*/true}, now);
    const auto delivered = drain<DeliverToMesh>();
    ASSERT_EQ(delivered.size(), 1u) << other;
    EXPECT_EQ(delivered[0].mesh, std::nullopt);
    EXPECT_EQ(delivered[0].message.robot, "a");
    EXPECT_EQ(delivered[0].message.command, CommandId::none);
    EXPECT_EQ(delivered[0].message.message.topic, other);
    EXPECT_TRUE(delivered[0].message.message.retain);
    EXPECT_TRUE(delivered[0].message.is_unasked);
  }
  EXPECT_EQ(gateway.commands().open(), 1u);
  EXPECT_EQ(gateway.commands().counts().down, 4u);
  EXPECT_EQ(gateway.commands().counts().down_on[Mesh::thread], 1u) << "the command";
}

TEST_F(CommandsTest, AreMarkedForTheMeshWhenTheRobotHasNotSubscribedToThem) {
  reach[{Mesh::thread, "a"}] = Presence::online;
  gateway.commands().on_robot_message(
      {"a", {topic, {}, Qos::at_least_once}, CommandId::none, /*is_unasked=*/true}, now);
  const auto delivered = drain<DeliverToMesh>();
  ASSERT_EQ(delivered.size(), 1u);
  EXPECT_TRUE(delivered[0].message.is_unasked);
  EXPECT_NE(delivered[0].message.command, CommandId::none) << "the mesh owes its outcome";
}

TEST_F(CommandsTest, AreNotMadeOfRightsProbes) {
  reach[{Mesh::thread, "a"}] = Presence::online;
  const std::string topic = "ntnu-slam/server/a/probe";
  gateway.commands().on_robot_message({"a", {topic, to_bytes("17-1"), Qos::at_most_once}}, now);
  EXPECT_FALSE(gateway.next_action());
  gateway.commands().on_robot_message({"a", {topic, to_bytes("17-1"), Qos::at_least_once}}, now);
  gateway.commands().on_robot_message({"a", {topic, to_bytes("hello"), Qos::at_most_once}}, now);
  EXPECT_EQ(drain<DeliverToMesh>().size(), 2u) << "commands whose type is probe";
}

/// A robot may subscribe to topics of others, whose payloads are arbitrary.
TEST_F(CommandsTest, MessagesOnTopicsOfOthersAreNeverRightsProbes) {
  reach[{Mesh::thread, "a"}] = Presence::online;
  for (const char* topic :
       {"ntnu-slam/robot/b/probe", "lab/pool/probe", "ntnu-slam/server/a/b/probe"})
    gateway.commands().on_robot_message({"a", {topic, to_bytes("20-25"), Qos::at_most_once}}, now);
  EXPECT_EQ(drain<DeliverToMesh>().size(), 3u);
}

TEST_F(CommandsTest, ToAnUnknownOrAbsentRobotAreRefusedAtOnce) {
  EXPECT_FALSE(server_sends());
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].result, CommandResult::refused);
  EXPECT_EQ(outcomes[0].why, "no robot of this name is known here");
  EXPECT_EQ(outcomes[0].mesh, std::nullopt);
  say(PresenceChange{Mesh::thread, "a", Presence::offline, "x"});
  EXPECT_FALSE(server_sends());
  ASSERT_EQ(outcomes.size(), 2u);
  EXPECT_EQ(outcomes[1].why, "the robot is not connected");
  pass(1min);
  EXPECT_EQ(outcomes.size(), 2u);
}

TEST_F(CommandsTest, ToABannedRobotAreRefusedAtOnceOnEitherMesh) {
  broker_comes();
  reach[{Mesh::ble, "ble-0100"}] = Presence::online;
  reach[{Mesh::thread, "r1"}] = Presence::online;
  gateway.set_names(RobotNames({}, Bans({"ble-0100", "r1"})));
  for (const std::string robot : {"ble-0100", "r1"}) {
    gateway.commands().on_robot_message(
        {robot, {"ntnu-slam/server/" + robot + "/cmd", {}, Qos::at_least_once}}, now);
    gateway.commands().on_operator_command({"uid 0"}, robot, "run", {}, now);
    gateway.on_broker_message({"ntnu-slam/server/" + robot + "/cmd", {}, Qos::at_least_once}, now);
    std::size_t refused = 0;
    while (const auto action = gateway.next_action()) {
      EXPECT_FALSE(std::holds_alternative<DeliverToMesh>(*action));
      const auto* outcome = std::get_if<CommandOutcome>(&*action);
      if (!outcome) continue;
      ++refused;
      EXPECT_EQ(outcome->result, CommandResult::refused);
      EXPECT_EQ(outcome->why, "the robot is banned (slam-gatewayctl unban)");
    }
    EXPECT_EQ(refused, 3U);
  }
  gateway.set_names(RobotNames());
  gateway.commands().on_operator_command({"uid 0"}, "r1", "run", {}, now);
  EXPECT_EQ(drain<DeliverToMesh>().size(), 1U);
}

TEST_F(CommandsTest, AreInTheAuditTrailWithTheirSender) {
  broker_comes();
  reach[{Mesh::thread, "r1"}] = Presence::online;
  BrokerMessage planned{"ntnu-slam/server/r1/cmd", {}, Qos::at_least_once};
  planned.sender = sender_at_broker("planner");
  gateway.commands().on_robot_message({"r1", planned}, now);
  gateway.commands().on_robot_message({"r1", {"ntnu-slam/server/r1/cmd", {}, Qos::at_least_once}},
                                      now);
  gateway.commands().on_operator_command({"uid 7 (ann)"}, "r1", "run", {}, now);
  for (const auto& delivery : drain<DeliverToMesh>())
    gateway.on_mesh_event(
        CommandOutcome{
            Mesh::thread, delivery.message.command, "r1", "cmd", CommandResult::delivered, {}, ""},
        now);
  const auto notices = drain<Notice>();
  ASSERT_EQ(notices.size(), 3U);
  const char* const who[] = {"broker: planner", "broker", "uid 7 (ann)"};
  for (std::size_t i = 0; i < notices.size(); ++i) {
    ASSERT_TRUE(notices[i].audit);
    EXPECT_EQ(notices[i].audit->who, who[i]);
    EXPECT_EQ(notices[i].audit->outcome, "delivered");
    EXPECT_EQ(notices[i].robot, "r1");
  }
  EXPECT_EQ(notices[0].audit->what, "command cmd");
  EXPECT_EQ(notices[0].text, "thread r1 cmd delivered after 0 ms; asked by broker: planner");
  EXPECT_EQ(notices[1].text, "thread r1 cmd delivered after 0 ms");
  EXPECT_EQ(notices[0].severity, Severity::info);
  EXPECT_EQ(notices[2].severity, Severity::notice);
}

TEST_F(CommandsTest, OfAnOperatorAreInTheAuditTrailBesideAFlood) {
  broker_comes();
  pass(1min);
  drain<Notice>();
  for (int i = 0; i < 100; ++i) {
    gateway.on_broker_message({"ntnu-slam/server/stranger/cmd", {}, Qos::at_least_once}, now);
    now.mono += 1s;
    gateway.on_deadline(now);
    gateway.commands().on_operator_command({"uid 0 (root)"}, "stranger", "cmd", {}, now);
  }
  std::size_t orders = 0;
  std::size_t others = 0;
  for (const Notice& notice : drain<Notice>()) {
    if (!notice.audit) continue;
    ++(is_operator(notice.audit->who) ? orders : others);
    EXPECT_EQ(notice.audit->outcome, "refused");
  }
  EXPECT_EQ(orders, 100U);
  EXPECT_LE(others, 11U);
  EXPECT_GE(others, 1U);
}

TEST(SenderAtBroker, IsMarkedAsUnverifiedAndBounded) {
  EXPECT_EQ(who_of(sender_at_broker("planner")), "broker: planner");
  EXPECT_EQ(who_of(sender_at_broker("")), "broker");
  EXPECT_EQ(who_of(sender_at_broker(std::string(65, 'x'))), "broker");
  EXPECT_FALSE(is_operator(who_of(sender_at_broker("uid 0 (root)"))));
  EXPECT_TRUE(is_operator("uid 0 (root)"));
}

TEST_F(CommandsTest, ThatWaitedTooLongAtTheBrokerAreRefused) {
  reach[{Mesh::ble, "a"}] = Presence::online;
  const auto grows_stale = [&](const char* of) {
    gateway.commands().on_stale_command("a", {of, {}, Qos::at_least_once, false, {}, Waited{40s}},
                                        /*has_begun_anew=*/false);
  };
  grows_stale(topic);
  std::vector<CommandOutcome> reported;
  std::vector<std::string> published;
  while (auto action = gateway.next_action()) {
    EXPECT_FALSE(std::holds_alternative<DeliverToMesh>(*action));
    if (auto* it = std::get_if<CommandOutcome>(&*action)) reported.push_back(std::move(*it));
    if (auto* it = std::get_if<Upload>(&*action)) published.push_back(it->message.topic);
  }
  ASSERT_EQ(reported.size(), 1u);
  EXPECT_EQ(reported[0].result, CommandResult::refused);
  EXPECT_EQ(reported[0].robot, "a");
  EXPECT_EQ(reported[0].type, "cmd");
  EXPECT_EQ(reported[0].after, 40s);
  EXPECT_EQ(reported[0].why, "waited too long at the broker while no gateway served the robot");
  EXPECT_EQ(published, std::vector<std::string>{"ntnu-slam/gateway/pi1/commands/a"});
  grows_stale("ntnu-slam/robot/b/update");
  grows_stale("ntnu-slam/server/b/cmd");
  EXPECT_FALSE(gateway.next_action()) << "only commands for this robot have an outcome";
}

TEST_F(CommandsTest, ForwardedToAnotherGatewayEndHereWithoutAnOutcome) {
  reach[{Mesh::ble, "a"}] = Presence::online;
  const CommandId handed_on = command_sent();
  gateway.commands().on_handed_on(handed_on);
  EXPECT_EQ(gateway.commands().open(), 0u);
  pass(1min);
  mesh_ends(handed_on);
  EXPECT_TRUE(outcomes.empty());
}

TEST_F(CommandsTest, HaveExactlyOneOutcomeEachDespiteRepeatedOrMissingOnes) {
  reach[{Mesh::ble, "a"}] = Presence::online;
  const CommandId ended_twice = command_sent();
  const CommandId never_ended = command_sent();
  EXPECT_NE(ended_twice, never_ended);
  mesh_ends(ended_twice);
  mesh_ends(ended_twice);
  EXPECT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(gateway.commands().counts().late_outcomes, 1u);
  ASSERT_TRUE(gateway.deadline());
  EXPECT_LT(*gateway.deadline(), now.mono + 30s);
  pass(30s);
  ASSERT_EQ(outcomes.size(), 2u);
  EXPECT_EQ(outcomes[1].id, never_ended);
  EXPECT_EQ(outcomes[1].result, CommandResult::timeout);
  mesh_ends(never_ended);
  EXPECT_EQ(outcomes.size(), 2u) << "too late";
}

TEST_F(CommandsTest, EndInTimeAfterTheyWaitedInAnotherGateway) {
  reach[{Mesh::ble, "a"}] = Presence::online;
  const CommandId fresh = command_sent();
  const auto delivered = server_sends(false, 5s);
  ASSERT_TRUE(delivered);
  EXPECT_EQ(delivered->message.message.waited, 5s);
  EXPECT_EQ(gateway.deadline(), now.mono + CommandLedger::patience - 5s);
  pass(25s);
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].id, delivered->message.command);
  mesh_ends(delivered->message.command);
  EXPECT_EQ(gateway.commands().counts().late_outcomes, 1u);
  pass(5s);
  ASSERT_EQ(outcomes.size(), 2u);
  EXPECT_EQ(outcomes[1].id, fresh);
}

TEST_F(CommandsTest, WithoutAnIdFromBeforeARestartHaveTheirOutcomesReported) {
  mesh_ends(CommandId::none);
  mesh_ends(CommandId::none);
  EXPECT_EQ(outcomes.size(), 2u);
}

TEST_F(CommandsTest, ThatAreRetainedHaveNoOutcomeUnlessTheMeshReportsOne) {
  server_sends(true);
  EXPECT_TRUE(outcomes.empty()) << "it waits at the broker until a gateway knows the robot";
  reach[{Mesh::ble, "a"}] = Presence::online;
  server_sends(true);
  const CommandId taken = command_sent(true);
  mesh_ends(taken);
  pass(1min);
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].id, taken);
  EXPECT_EQ(gateway.deadline(), std::nullopt);
}

TEST_F(CommandsTest, BeyondTheBoundAreRefused) {
  reach[{Mesh::ble, "a"}] = Presence::online;
  for (std::size_t i = 0; i < max_open_commands; ++i) server_sends();
  EXPECT_TRUE(outcomes.empty());
  EXPECT_FALSE(server_sends());
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].result, CommandResult::refused);
  pass(30s);
  EXPECT_EQ(outcomes.size(), max_open_commands + 1);
  EXPECT_TRUE(server_sends());
}

TEST_F(GatewayTest, ReportsHowACommandEnded) {
  say(CommandOutcome{Mesh::ble, {}, "a", "cmd", CommandResult::timeout, 30000ms, "no STATUS"});
  const auto uploads = drain<Upload>();
  ASSERT_EQ(uploads.size(), 1u);
  EXPECT_EQ(uploads[0].message.topic, "ntnu-slam/gateway/pi1/commands/a");
  EXPECT_EQ(as_text(uploads[0].message.payload),
            R"({"type":"cmd","outcome":"timeout","after_ms":30000,"why":"no STATUS"})");
}

TEST_F(GatewayTest, DoesNotDependOnTheWallClock) {
  const BrokerLink link{true, {}, {}};
  const auto life = [&](const std::vector<WallTime>& clock) {
    Gateway it(TopicScheme("ntnu-slam", "pi1"), {"1", UpdateMode::positions, clock[0]}, link,
               [](Mesh, const std::string&) { return std::nullopt; });
    TimePoint mono{1h};
    std::string done;
    for (const WallTime wall : clock) {
      const Now then{mono += 15s, wall};
      it.on_broker_link(then);
      it.on_mesh_event(PresenceChange{Mesh::ble, "a", Presence::online, "0x0100"}, then);
      it.on_mesh_event(update_from("a", {1, 2, 3}), then);
      it.on_mesh_event(update_from("a", {1, 0, 2, 0}), then);
      it.on_deadline(then);
      while (auto action = it.next_action()) {
        done += std::to_string(action->index());
        if (const auto* upload = std::get_if<Upload>(&*action)) done += upload->message.topic + " ";
      }
    }
    return done + std::to_string(it.registry().find("a")->numbers.rate_hz(mono));
  };
  const WallTime boot{10s};  // a computer without a clock, before it gets the time
  const WallTime present{1'800'000'000s};
  const std::string steady = life({present, present + 15s, present + 30s, present + 45s});
  EXPECT_EQ(life({boot, present, present + 15s, present + 30s}), steady);
  EXPECT_EQ(life({present, boot, WallTime{-10s}, present}), steady);
}

TEST_F(GatewayTest, ShowsInItsStateWhileTheStoreIsFull) {
  const auto states = [this] {
    std::vector<std::string> published;
    for (const Upload& upload : drain<Upload>()) {
      EXPECT_EQ(upload.message.topic, "ntnu-slam/gateway/pi1/state");
      EXPECT_TRUE(upload.message.retain);
      published.emplace_back(as_text(upload.message.payload));
    }
    return published;
  };
  gateway.presence().on_store(true);
  EXPECT_TRUE(states().empty()) << "the broker is away";
  const std::string online =
      R"({"state":"online","version":"0.1.0","since":"2023-11-14T22:13:20Z",)"
      R"("connected":"2023-11-14T22:13:20Z")";
  broker_is(true);
  EXPECT_EQ(states(), std::vector{online + R"(,"store":"full"})"});
  gateway.presence().on_store(true);
  EXPECT_TRUE(states().empty()) << "unchanged";
  gateway.presence().on_store(false);
  EXPECT_EQ(states(), std::vector{online + "}"});
}

TEST_F(GatewayTest, PublishesOfflineWhenItStops) {
  broker_comes();
  gateway.on_stop(now);
  const auto uploads = drain<Upload>();
  ASSERT_EQ(uploads.size(), 1u);
  EXPECT_EQ(as_text(uploads[0].message.payload), R"({"state":"offline"})");
  EXPECT_TRUE(uploads[0].message.retain);
}

TEST_F(GatewayTest, PublishesOnlineAgainAfterALateLastWill) {
  const auto state = [&](const char* text) {
    gateway.on_broker_message(
        {"ntnu-slam/gateway/pi1/state", to_bytes(text), Qos::at_least_once, false}, now);
    return drain<Upload>().size();
  };
  broker_comes();
  EXPECT_EQ(state(R"({"state":"offline"})"), 0u) << "the last will of the former connection";
  EXPECT_EQ(state(R"({"state":"online"})"), 0u);
  EXPECT_EQ(state(R"({"state":"offline"})"), 1u);
}

TEST_F(GatewayTest, NeverPublishesOnlineAfterItsStop) {
  gateway.on_stop(now);
  EXPECT_TRUE(drain<Upload>().empty()) << "the broker is away; its last will is published";
  broker_is(true);  // while it waits for acknowledgements
  gateway.presence().on_store(true);
  const auto uploads = drain<Upload>();
  ASSERT_EQ(uploads.size(), 2u);
  for (const Upload& upload : uploads)
    EXPECT_EQ(as_text(upload.message.payload), R"({"state":"offline"})");
}

}  // namespace
}  // namespace slamgw
