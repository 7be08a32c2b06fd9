// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/gateway.hpp"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

namespace slamgw {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;

class GatewayTest : public testing::Test {
 protected:
  template <class Action>
  std::vector<Action> drain() {
    std::vector<Action> wanted;
    while (auto action = gateway.next_action()) {
      if (auto* it = std::get_if<Action>(&*action)) wanted.push_back(std::move(*it));
    }
    return wanted;
  }

  void say(MeshEvent event) { gateway.on_mesh_event(std::move(event), now); }
  void broker_comes() {
    gateway.on_broker_link(true, now);
    while (gateway.next_action()) {
    }
  }

  static Report update_from(const std::string& robot, Bytes payload) {
    return {Mesh::thread,
            robot,
            "ntnu-slam/robot/" + robot + "/update",
            std::move(payload),
            Qos::at_least_once,
            false,
            Receipt{Mesh::thread, 7}};
  }

  Now now{TimePoint{1h}, WallTime{1'700'000'000s}};
  Gateway gateway{TopicScheme("ntnu-slam", "pi1"), {"0.1.0", UpdateMode::positions, now.wall}};
};

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
  const auto traffic = drain<TrafficEvent>();
  ASSERT_EQ(traffic.size(), 1u);
  EXPECT_EQ(traffic[0].type, "update");
  ASSERT_TRUE(traffic[0].update);
  EXPECT_EQ(traffic[0].update->robot.y_cm, -20);
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

  gateway.on_broker_link(true, now);
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
  gateway.on_broker_link(true, now);
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
  EXPECT_TRUE(drain<DeliverToMesh>().empty()) << "nobody else's business";
  say(PresenceChange{Mesh::ble, "heard", Presence::online, "0x0100"});
  drain<Upload>();
  gateway.on_tick(now);
  EXPECT_TRUE(drain<Upload>().empty()) << "too early";
  now.mono += LeftoverRobots::grace;
  gateway.on_tick(now);
  std::vector<std::string> offline;
  while (auto action = gateway.next_action()) {
    if (const auto* upload = std::get_if<Upload>(&*action)) {
      EXPECT_TRUE(upload->message.retain);
      offline.push_back(
          upload->message.topic.substr(29) + " " +
          std::string(upload->message.payload.begin(), upload->message.payload.end()));
    }
    if (const auto* end = std::get_if<UnsubscribeAtBroker>(&*action)) {
      EXPECT_EQ(end->filter, asked[0].filter);
    }
  }
  ASSERT_EQ(offline.size(), 2u);
  EXPECT_EQ(offline[1], R"(gone {"state":"offline","mesh":"ble","since":"2023-11-14T22:13:20Z"})");
  gateway.on_tick(now);
  EXPECT_TRUE(drain<Upload>().empty()) << "once";
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
  gateway.on_subscribe_result("f", false);
  const auto answers = drain<AnswerSubscribe>();
  ASSERT_EQ(answers.size(), 1u);
  EXPECT_FALSE(answers[0].granted);
  EXPECT_EQ(answers[0].mesh, Mesh::thread);
}

TEST_F(GatewayTest, AnswersWhoStillWaitsWhenTheBrokerGoes) {
  broker_comes();
  say(SubscribeRequest{Mesh::ble, "f", Qos::at_least_once});
  gateway.on_broker_link(false, now);
  const auto answers = drain<AnswerSubscribe>();
  ASSERT_EQ(answers.size(), 1u);
  EXPECT_TRUE(answers[0].granted);
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

TEST_F(GatewayTest, GivesACommandToBothMeshesUnlessTheRobotIsOnThreadOnly) {
  const BrokerMessage cmd{"ntnu-slam/server/a/cmd", {1, 2, 3, 4}, Qos::at_least_once, false};
  gateway.on_broker_message(cmd, {}, now);
  EXPECT_EQ(drain<DeliverToMesh>().size(), 2u);
  say(PresenceChange{Mesh::thread, "a", Presence::online, "x"});
  gateway.on_broker_message(cmd, {}, now);
  const auto deliveries = drain<DeliverToMesh>();
  ASSERT_EQ(deliveries.size(), 1u);
  EXPECT_EQ(deliveries[0].mesh, Mesh::thread);
}

TEST_F(GatewayTest, TakesOneCopyOfAMessageForOverlappingSubscriptions) {
  broker_comes();
  for (const char* filter : {"ntnu-slam/server/a/+", "ntnu-slam/server/a/cmd"}) {
    say(SubscribeRequest{Mesh::thread, filter, Qos::at_least_once});
    gateway.on_subscribe_result(filter, true);
  }
  const auto subscriptions = drain<SubscribeAtBroker>();
  ASSERT_EQ(subscriptions.size(), 2u);
  const BrokerMessage cmd{"ntnu-slam/server/a/cmd", {1, 2, 3, 4}, Qos::at_least_once, false};
  for (const SubscribeAtBroker& subscription : subscriptions) {
    gateway.on_broker_message(cmd, std::vector{subscription.id}, now);
  }
  EXPECT_EQ(drain<DeliverToMesh>().size(), 2u) << "one for each mesh";
  BrokerMessage retained = cmd;
  retained.retain = true;
  gateway.on_broker_message(retained, std::vector{subscriptions[1].id}, now);
  EXPECT_EQ(drain<DeliverToMesh>().size(), 2u) << "retained ones come for one subscription only";
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
  const auto life = [](const std::vector<WallTime>& clock) {
    Gateway it(TopicScheme("ntnu-slam", "pi1"), {"1", UpdateMode::positions, clock[0]});
    TimePoint mono{1h};
    std::string done;
    for (const WallTime wall : clock) {
      const Now then{mono += 15s, wall};
      it.on_broker_link(true, then);
      it.on_mesh_event(PresenceChange{Mesh::ble, "a", Presence::online, "0x0100"}, then);
      it.on_mesh_event(update_from("a", {1, 2, 3}), then);
      it.on_mesh_event(update_from("a", {1, 0, 2, 0}), then);
      it.on_tick(then);
      while (auto action = it.next_action()) {
        done += std::to_string(action->index());
        if (const auto* upload = std::get_if<Upload>(&*action)) done += upload->message.topic + " ";
      }
    }
    return done + std::to_string(it.registry().find("a")->rate.per_second(mono));
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
  gateway.on_broker_link(true, now);
  EXPECT_EQ(states(), std::vector{online + R"(,"store":"full"})"});
  gateway.on_store(true);
  EXPECT_TRUE(states().empty()) << "no news";
  gateway.on_store(false);
  EXPECT_EQ(states(), std::vector{online + "}"});
}

TEST_F(GatewayTest, SaysOfflineWhenItStops) {
  broker_comes();
  gateway.on_stop();
  const auto uploads = drain<Upload>();
  ASSERT_EQ(uploads.size(), 1u);
  EXPECT_EQ(as_text(uploads[0].message.payload), R"({"state":"offline"})");
  EXPECT_TRUE(uploads[0].message.retain);
}

TEST_F(GatewayTest, NeverSaysOnlineAgainAfterItHasStopped) {
  gateway.on_stop();
  EXPECT_TRUE(drain<Upload>().empty()) << "its last will has said it";
  gateway.on_broker_link(true, now);  // while it waits for messages to be taken
  gateway.on_store(true);
  const auto uploads = drain<Upload>();
  ASSERT_EQ(uploads.size(), 2u);
  for (const Upload& upload : uploads)
    EXPECT_EQ(as_text(upload.message.payload), R"({"state":"offline"})");
}

}  // namespace
}  // namespace slamgw
