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

TEST_F(GatewayTest, PutsUnreadableUpdatesUnderRejectedAndSaysSoOncePerBurst) {
  int notices = 0;
  for (int i = 0; i < 5; ++i) {
    say(update_from("NRF_5", {1, 2, 3}));
    while (auto action = gateway.next_action()) {
      if (std::holds_alternative<Notice>(*action)) ++notices;
      if (const auto* upload = std::get_if<Upload>(&*action)) {
        EXPECT_EQ(upload->message.topic, "ntnu-slam/gateway/pi1/rejected/NRF_5/update");
        EXPECT_EQ(upload->message.payload, (Bytes{1, 2, 3}));
        EXPECT_TRUE(upload->receipt.is_owed()) << "the robot must not repeat it for ever";
      }
    }
  }
  EXPECT_EQ(notices, 1);
  EXPECT_EQ(gateway.traffic().rejected, 5u);
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

TEST_F(GatewayTest, SaysInThePresenceThatARobotIsDeafWhileItIs) {
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
  EXPECT_EQ(deaf["since"], before["since"]) << "the state is as old as before";
  EXPECT_EQ(gateway.registry().deaf(), 1u);
  EXPECT_FALSE(presence(false, 9s).contains("deaf"));
}

TEST_F(GatewayTest, AddsWhatTheRadioSaysToPresenceOnce) {
  broker_comes();
  say(PresenceChange{Mesh::ble, "a", Presence::online, "0x0100"});
  drain<Upload>();
  Report report = update_from("a", {0x0a, 0x00, 0xec, 0xff});
  report.radio = RadioFacts{-61, 2, 3};
  say(report);
  const auto uploads = drain<Upload>();
  ASSERT_EQ(uploads.size(), 2u);
  EXPECT_EQ(uploads[0].message.topic, "ntnu-slam/gateway/pi1/robots/a");
  const std::string text(uploads[0].message.payload.begin(), uploads[0].message.payload.end());
  EXPECT_NE(text.find(R"("rssi_dbm":-61,"ttl":3,"hops":2)"), std::string::npos) << text;
  say(report);
  EXPECT_EQ(drain<Upload>().size(), 1u) << "a changing radio is no news";
}

TEST_F(GatewayTest, SaysEverythingAgainWhenTheBrokerComesBack) {
  say(PresenceChange{Mesh::thread, "a", Presence::online, "[::1]:1"});
  say(SubscribeRequest{Mesh::thread, "ntnu-slam/server/a/cmd", Qos::at_least_once});
  EXPECT_TRUE(drain<Upload>().empty()) << "nothing is queued for an absent broker";

  broker_is(true);
  std::vector<std::string> topics;
  std::vector<std::string> filters;
  while (auto action = gateway.next_action()) {
    if (const auto* upload = std::get_if<Upload>(&*action)) topics.push_back(upload->message.topic);
    if (const auto* sub = std::get_if<SubscribeAtBroker>(&*action)) filters.push_back(sub->filter);
  }
  EXPECT_EQ(topics, (std::vector<std::string>{"ntnu-slam/gateway/pi1/state",
                                              "ntnu-slam/gateway/pi1/robots/a"}));
  EXPECT_EQ(filters,
            (std::vector<std::string>{"ntnu-slam/server/a/cmd", "ntnu-slam/gateway/pi1/robots/+"}));
}

TEST_F(GatewayTest, CallsRobotsOfAnEarlierLifeOfflineUnlessTheyAreHeard) {
  broker_is(true);
  const auto asked = drain<SubscribeAtBroker>();
  ASSERT_EQ(asked.size(), 1u);
  EXPECT_EQ(asked[0].filter, "ntnu-slam/gateway/pi1/robots/+");
  const auto kept = [&](const std::string& id, const std::string& state) {
    const SubscriptionId own[] = {asked[0].id};
    gateway.on_broker_message(
        {"ntnu-slam/gateway/pi1/robots/" + id,
         to_bytes(R"({"state":")" + state + R"(","mesh":"ble","since":"then"})"),
         Qos::at_least_once, true},
        own, now);
  };
  for (const char* id : {"gone", "heard", "broken\x01"}) kept(id, "online");
  kept("was", "offline");
  EXPECT_TRUE(drain<DeliverToMeshes>().empty()) << "nobody else's business";
  say(PresenceChange{Mesh::ble, "heard", Presence::online, "0x0100"});
  drain<Upload>();
  gateway.on_deadline(now);
  EXPECT_TRUE(drain<Upload>().empty()) << "too early";
  gateway.on_subscribe_result(asked[0].filter, SubscribeAnswer::granted, now);
  now.mono += LeftoverRobots::retained_patience;
  EXPECT_EQ(gateway.deadline(), now.mono);
  gateway.on_deadline(now);
  const auto ended = drain<UnsubscribeAtBroker>();
  ASSERT_EQ(ended.size(), 1u);
  EXPECT_EQ(ended[0].filter, asked[0].filter);
  now.mono += LeftoverRobots::grace - LeftoverRobots::retained_patience;
  EXPECT_EQ(gateway.deadline(), now.mono);
  gateway.on_deadline(now);
  std::vector<std::string> offline;
  while (auto action = gateway.next_action()) {
    if (const auto* upload = std::get_if<Upload>(&*action)) {
      EXPECT_TRUE(upload->message.retain);
      offline.push_back(
          upload->message.topic.substr(29) + " " +
          std::string(upload->message.payload.begin(), upload->message.payload.end()));
    }
    EXPECT_FALSE(std::holds_alternative<UnsubscribeAtBroker>(*action)) << "once";
  }
  ASSERT_EQ(offline.size(), 2u);
  EXPECT_EQ(offline[1], R"(gone {"state":"offline","mesh":"ble","since":"2023-11-14T22:13:20Z"})");
  gateway.on_deadline(now);
  EXPECT_TRUE(drain<Upload>().empty()) << "once";
}

TEST_F(GatewayTest, ListensForWhatItLeftBehindAsLongAsItComes) {
  broker_is(true);
  const std::string filter = drain<SubscribeAtBroker>().at(0).filter;
  const auto unsubscribes_after = [&](Duration time) {
    now.mono += time;
    gateway.on_deadline(now);
    return drain<UnsubscribeAtBroker>().size();
  };
  EXPECT_EQ(unsubscribes_after(LeftoverRobots::retained_patience), 0u) << "NATS may take long";
  gateway.on_subscribe_result(filter, SubscribeAnswer::granted, now);
  EXPECT_EQ(unsubscribes_after(LeftoverRobots::retained_patience / 2), 0u);
  const SubscriptionId own[] = {own_subscription};
  gateway.on_broker_message({"ntnu-slam/gateway/pi1/robots/late", to_bytes(R"({"state":"online"})"),
                             Qos::at_least_once, true},
                            own, now);
  EXPECT_EQ(unsubscribes_after(LeftoverRobots::retained_patience / 2), 0u);
  broker_is(false);
  broker_is(true);
  EXPECT_EQ(drain<SubscribeAtBroker>().size(), 1u) << "a new connection knows of no subscription";
  gateway.on_subscribe_result(filter, SubscribeAnswer::granted, now);
  EXPECT_EQ(unsubscribes_after(LeftoverRobots::retained_patience), 1u);
  EXPECT_EQ(unsubscribes_after(LeftoverRobots::grace), 0u);
}

TEST_F(GatewayTest, AnswersSubscribersAtOnceWhileTheBrokerIsAway) {
  say(SubscribeRequest{Mesh::thread, "ntnu-slam/server/a/cmd", Qos::at_least_once});
  const auto answers = drain<AnswerSubscribe>();
  ASSERT_EQ(answers.size(), 1u);
  EXPECT_TRUE(answers[0].granted);
}

TEST_F(GatewayTest, PassesTheBrokersAnswerToWhoAsked) {
  broker_comes();
  say(SubscribeRequest{Mesh::thread, "f", Qos::at_least_once});
  EXPECT_TRUE(drain<AnswerSubscribe>().empty());
  gateway.on_subscribe_result("f", SubscribeAnswer::refused, now);
  const auto answers = drain<AnswerSubscribe>();
  ASSERT_EQ(answers.size(), 1u);
  EXPECT_FALSE(answers[0].granted);
  EXPECT_EQ(answers[0].mesh, Mesh::thread);
}

TEST_F(GatewayTest, WhoWaitsWhenTheBrokerGoesGetsItsAnswerWhenItIsBack) {
  broker_comes();
  say(SubscribeRequest{Mesh::thread, "f", Qos::at_least_once});
  broker_is(false);
  gateway.on_subscribe_result("f", SubscribeAnswer::closes_connection, now);
  const auto answers = drain<AnswerSubscribe>();
  ASSERT_EQ(answers.size(), 1u);
  EXPECT_FALSE(answers[0].granted);
}

TEST_F(GatewayTest, ARefusalReachesTheMeshesThatNoLongerWaitToo) {
  say(SubscribeRequest{Mesh::ble, "f", Qos::at_least_once});
  say(SubscribeRequest{Mesh::thread, "f", Qos::at_least_once});
  ASSERT_EQ(drain<AnswerSubscribe>().size(), 2u);
  broker_comes();
  gateway.on_subscribe_result("f", SubscribeAnswer::refused, now);
  const auto answers = drain<AnswerSubscribe>();
  ASSERT_EQ(answers.size(), 2u);
  EXPECT_FALSE(answers[0].granted || answers[1].granted);
}

TEST_F(GatewayTest, AnswersWhoWaitsWhenTheBrokerStaysAway) {
  broker_comes();
  say(SubscribeRequest{Mesh::ble, "f", Qos::at_least_once});
  broker_is(false);
  EXPECT_TRUE(drain<AnswerSubscribe>().empty());
  now.mono += Gateway::subscribe_patience;
  ASSERT_EQ(gateway.deadline(), now.mono);
  gateway.on_deadline(now);
  const auto answers = drain<AnswerSubscribe>();
  ASSERT_EQ(answers.size(), 1u);
  EXPECT_TRUE(answers[0].granted);
}

TEST_F(GatewayTest, SubscribersDoNotWaitForASilentBroker) {
  broker_comes();
  say(SubscribeRequest{Mesh::ble, "f", Qos::at_least_once});
  drain<SubscribeAtBroker>();
  broker.is_silent = true;
  gateway.on_broker_silence(now);
  EXPECT_EQ(drain<AnswerSubscribe>().size(), 1u);
  say(SubscribeRequest{Mesh::thread, "g", Qos::at_least_once});
  std::size_t answered = 0;
  std::size_t asked = 0;
  while (auto action = gateway.next_action()) {
    answered += std::holds_alternative<AnswerSubscribe>(*action) ? 1 : 0;
    asked += std::holds_alternative<SubscribeAtBroker>(*action) ? 1 : 0;
  }
  EXPECT_EQ(answered, 1u);
  EXPECT_EQ(asked, 1u) << "it may answer yet";
  broker.is_silent = false;
  gateway.on_broker_silence(now);
  say(SubscribeRequest{Mesh::thread, "h", Qos::at_least_once});
  EXPECT_TRUE(drain<AnswerSubscribe>().empty());
}

TEST_F(GatewayTest, EndsASubscriptionWithTheLastMeshThatWantsIt) {
  broker_comes();
  say(SubscribeRequest{Mesh::thread, "f", Qos::at_least_once});
  say(SubscribeRequest{Mesh::ble, "f", Qos::at_least_once});
  say(UnsubscribeRequest{Mesh::thread, "f"});
  EXPECT_TRUE(drain<UnsubscribeAtBroker>().empty());
  say(UnsubscribeRequest{Mesh::ble, "f"});
  EXPECT_EQ(drain<UnsubscribeAtBroker>().size(), 1u);
}

TEST_F(GatewayTest, TellsTheLinkThatNobodyWantsAFilterAlsoWhileTheBrokerIsAway) {
  broker_comes();
  say(SubscribeRequest{Mesh::thread, "f", Qos::at_least_once});
  broker_is(false);
  drain<UnsubscribeAtBroker>();
  say(UnsubscribeRequest{Mesh::thread, "f"});
  const auto unwanted = drain<UnsubscribeAtBroker>();
  ASSERT_EQ(unwanted.size(), 1u) << "it remembers what it has sent";
  EXPECT_EQ(unwanted[0].filter, "f");
}

class CommandsTest : public GatewayTest {
 protected:
  static constexpr const char* topic = "ntnu-slam/server/a/cmd";

  DeliverToMeshes server_sends(bool retain = false) {
    gateway.on_broker_message({topic, {1, 2, 3, 4}, Qos::at_least_once, retain}, {}, now);
    DeliverToMeshes delivery;
    while (auto action = gateway.next_action()) {
      if (auto* it = std::get_if<DeliverToMeshes>(&*action)) delivery = std::move(*it);
      if (auto* it = std::get_if<CommandOutcome>(&*action)) outcomes.push_back(std::move(*it));
    }
    return delivery;
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

TEST_F(CommandsTest, GoOverTheFirstMeshWhereTheRobotCanBeReached) {
  using enum Presence;
  const auto carrier = [&](std::optional<Presence> ble, std::optional<Presence> thread) {
    reach.clear();
    if (ble) reach[{Mesh::ble, "a"}] = *ble;
    if (thread) reach[{Mesh::thread, "a"}] = *thread;
    const DeliverToMeshes delivery = server_sends();
    for (const Mesh mesh : all_meshes)
      EXPECT_EQ(delivery.command_on(mesh) != CommandId::none, mesh == delivery.carrier);
    return delivery.carrier;
  };
  EXPECT_EQ(carrier(online, std::nullopt), Mesh::ble);
  EXPECT_EQ(carrier(std::nullopt, asleep), Mesh::thread);
  EXPECT_EQ(carrier(online, online), Mesh::ble);
  EXPECT_EQ(carrier(offline, online), Mesh::thread) << "on Thread only";
  EXPECT_EQ(carrier(offline, asleep), Mesh::thread);
  EXPECT_EQ(carrier(offline, offline), Mesh::ble);
  EXPECT_EQ(carrier(std::nullopt, offline), Mesh::thread);
}

TEST_F(CommandsTest, ToARobotThatNobodyKnowsAreRefusedAtOnce) {
  const DeliverToMeshes delivery = server_sends();
  EXPECT_EQ(delivery.message.topic, topic) << "other robots may listen to it";
  EXPECT_EQ(delivery.carrier, std::nullopt);
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].result, CommandResult::refused);
  EXPECT_EQ(outcomes[0].why, "no robot of this name is known here");
  EXPECT_EQ(outcomes[0].mesh, std::nullopt);
  pass(1min);
  EXPECT_EQ(outcomes.size(), 1u);
}

TEST_F(CommandsTest, HaveExactlyOneOutcomeEachWhateverTheMeshSays) {
  reach[{Mesh::ble, "a"}] = Presence::online;
  const CommandId ended_twice = server_sends().command;
  const CommandId never_ended = server_sends().command;
  EXPECT_NE(ended_twice, never_ended);
  mesh_ends(ended_twice);
  mesh_ends(ended_twice);
  EXPECT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(gateway.traffic().late_outcomes, 1u);
  ASSERT_TRUE(gateway.deadline());
  EXPECT_LT(*gateway.deadline(), now.mono + 30s);
  pass(30s);
  ASSERT_EQ(outcomes.size(), 2u);
  EXPECT_EQ(outcomes[1].id, never_ended);
  EXPECT_EQ(outcomes[1].result, CommandResult::timeout);
  mesh_ends(never_ended);
  EXPECT_EQ(outcomes.size(), 2u) << "too late";
}

TEST_F(CommandsTest, EndInTimeAlsoWhenTheyHaveWaitedForTheFleet) {
  reach[{Mesh::ble, "a"}] = Presence::online;
  const CommandId fresh = server_sends().command;
  gateway.on_turn({topic, {}, Qos::at_least_once, false, {}, false, 5s}, now);
  const auto delivered = drain<DeliverToMeshes>();
  ASSERT_EQ(delivered.size(), 1u);
  EXPECT_EQ(delivered[0].message.waited, 5s);
  EXPECT_EQ(gateway.deadline(), now.mono + CommandLedger::patience - 5s);
  pass(25s);
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].id, delivered[0].command);
  mesh_ends(delivered[0].command);
  EXPECT_EQ(gateway.traffic().late_outcomes, 1u);
  pass(5s);
  ASSERT_EQ(outcomes.size(), 2u);
  EXPECT_EQ(outcomes[1].id, fresh);
}

TEST_F(CommandsTest, FromBeforeARestartHaveNoIdAndAreTold) {
  mesh_ends(CommandId::none);
  mesh_ends(CommandId::none);
  EXPECT_EQ(outcomes.size(), 2u);
}

TEST_F(CommandsTest, ThatAreRetainedMayBePassedOver) {
  server_sends(true);
  EXPECT_TRUE(outcomes.empty()) << "it waits at the broker until somebody knows the robot";
  reach[{Mesh::ble, "a"}] = Presence::online;
  server_sends(true);
  const CommandId taken = server_sends(true).command;
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
  EXPECT_EQ(server_sends().command_on(Mesh::ble), CommandId::none);
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].result, CommandResult::refused);
  pass(30s);
  EXPECT_EQ(outcomes.size(), max_open_commands + 1);
  EXPECT_NE(server_sends().command_on(Mesh::ble), CommandId::none);
}

TEST_F(GatewayTest, TakesOneCopyOfAMessageForOverlappingSubscriptions) {
  broker_comes();
  for (const char* filter : {"ntnu-slam/server/a/+", "ntnu-slam/server/a/cmd"}) {
    say(SubscribeRequest{Mesh::thread, filter, Qos::at_least_once});
    gateway.on_subscribe_result(filter, SubscribeAnswer::granted, now);
  }
  const auto subscriptions = drain<SubscribeAtBroker>();
  ASSERT_EQ(subscriptions.size(), 2u);
  const BrokerMessage cmd{"ntnu-slam/server/a/cmd", {1, 2, 3, 4}, Qos::at_least_once, false};
  for (const SubscribeAtBroker& subscription : subscriptions) {
    gateway.on_broker_message(cmd, std::vector{subscription.id}, now);
  }
  EXPECT_EQ(drain<DeliverToMeshes>().size(), 1u);
  BrokerMessage retained = cmd;
  retained.retain = true;
  gateway.on_broker_message(retained, std::vector{subscriptions[1].id}, now);
  EXPECT_EQ(drain<DeliverToMeshes>().size(), 1u) << "retained ones come for one subscription only";
}

TEST_F(GatewayTest, ReportsHowACommandEnded) {
  say(CommandOutcome{Mesh::ble, {}, "a", "cmd", CommandResult::timeout, 30000ms, "no STATUS"});
  const auto uploads = drain<Upload>();
  ASSERT_EQ(uploads.size(), 1u);
  EXPECT_EQ(uploads[0].message.topic, "ntnu-slam/gateway/pi1/commands/a");
  EXPECT_EQ(as_text(uploads[0].message.payload),
            R"({"type":"cmd","outcome":"timeout","after_ms":30000,"why":"no STATUS"})");
}

TEST_F(GatewayTest, DoesTheSameWhateverTheWallClockSays) {
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
  const WallTime boot{10s};  // a board without a clock, before it hears of the time
  const WallTime present{1'800'000'000s};
  const std::string steady = life({present, present + 15s, present + 30s, present + 45s});
  EXPECT_EQ(life({boot, present, present + 15s, present + 30s}), steady);
  EXPECT_EQ(life({present, boot, WallTime{-10s}, present}), steady);
}

TEST_F(GatewayTest, SaysInItsStateThatTheStoreIsFullAsLongAsItIs) {
  const auto states = [this] {
    std::vector<std::string> said;
    for (const Upload& upload : drain<Upload>()) {
      EXPECT_EQ(upload.message.topic, "ntnu-slam/gateway/pi1/state");
      EXPECT_TRUE(upload.message.retain);
      said.emplace_back(as_text(upload.message.payload));
    }
    return said;
  };
  gateway.on_store(true);
  EXPECT_TRUE(states().empty()) << "nobody to tell yet";
  const std::string online =
      R"({"state":"online","version":"0.1.0","since":"2023-11-14T22:13:20Z")";
  broker_is(true);
  EXPECT_EQ(states(), std::vector{online + R"(,"store":"full"})"});
  gateway.on_store(true);
  EXPECT_TRUE(states().empty()) << "no news";
  gateway.on_store(false);
  EXPECT_EQ(states(), std::vector{online + "}"});
}

TEST_F(GatewayTest, SaysOfflineWhenItStops) {
  broker_comes();
  gateway.on_stop(now);
  const auto uploads = drain<Upload>();
  ASSERT_EQ(uploads.size(), 1u);
  EXPECT_EQ(as_text(uploads[0].message.payload), R"({"state":"offline"})");
  EXPECT_TRUE(uploads[0].message.retain);
}

TEST_F(GatewayTest, SaysOnlineAgainWhenALastWillComesLate) {
  const auto state = [&](const char* text) {
    gateway.on_broker_message(
        {"ntnu-slam/gateway/pi1/state", to_bytes(text), Qos::at_least_once, false}, {}, now);
    return drain<Upload>().size();
  };
  broker_comes();
  EXPECT_EQ(state(R"({"state":"offline"})"), 0u) << "of the connection before";
  EXPECT_EQ(state(R"({"state":"online"})"), 0u);
  EXPECT_EQ(state(R"({"state":"offline"})"), 1u);
}

TEST_F(GatewayTest, NeverSaysOnlineAgainAfterItHasStopped) {
  gateway.on_stop(now);
  EXPECT_TRUE(drain<Upload>().empty()) << "its last will has said it";
  broker_is(true);  // while it waits for messages to be taken
  gateway.on_store(true);
  const auto uploads = drain<Upload>();
  ASSERT_EQ(uploads.size(), 2u);
  for (const Upload& upload : uploads)
    EXPECT_EQ(as_text(upload.message.payload), R"({"state":"offline"})");
}

}  // namespace
}  // namespace slamgw
