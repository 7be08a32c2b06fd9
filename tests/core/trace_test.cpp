// SPDX-License-Identifier: Apache-2.0
// One stream of events from the core, the meshes and delivery.
#include "daemon/core/trace.hpp"

#include <gtest/gtest.h>

#include <vector>

namespace slamgw {
namespace {

using namespace std::chrono_literals;

class TraceTest : public testing::Test {
 protected:
  TrafficEvent message(std::uint64_t receipt) const {
    return {.direction = Direction::up,
            .mesh = Mesh::thread,
            .robot = "r",
            .type = "adv",
            .topic = "p/robot/r/adv",
            .payload = {1, 2},
            .qos = Qos::at_least_once,
            .update = {},
            .wall = now.wall,
            .at = now.mono,
            .receipt = {Mesh::thread, receipt},
            .wire = {7, false}};
  }
  void pass(std::chrono::microseconds time) {
    now.mono += time;
    now.wall += time;
  }
  std::vector<StepKind> kinds() const {
    std::vector<StepKind> found;
    for (const TraceEvent& event : events) found.push_back(event.kind);
    return found;
  }

  Now now{TimePoint{1h}, WallTime{1'700'000'000s}};
  std::vector<TraceEvent> events;
  Trace trace{TopicScheme("p", "g"),
              [](const std::string& robot, Mesh) { return robot == "r" ? "[::1]:5" : ""; },
              [this](const TraceEvent& event) { events.push_back(event); }};
};

TEST_F(TraceTest, ReportsAndKeepsNothingWhileTurnedOff) {
  trace.on_traffic(message(1));
  trace.on_step({.kind = StepKind::repeat, .mesh = Mesh::thread, .robot = "r"}, now);
  trace.on_step({.kind = StepKind::published, .mesh = Mesh::thread, .topic = "t"}, now);
  trace.on_outcome({}, now);
  EXPECT_TRUE(events.empty());
  EXPECT_EQ(trace.followed(), 0u);
}

TEST_F(TraceTest, ShowsTheSenderOfAMessageThatAnotherSendsAsTheRobot) {
  trace.turn(true);
  TrafficEvent event = message(1);
  event.address = "[::1]:9";
  trace.on_traffic(event);
  trace.on_traffic(message(2));
  ASSERT_EQ(events.size(), 2U);
  EXPECT_EQ(events[0].address, "[::1]:9");
  EXPECT_EQ(events[1].address, "[::1]:5");
}

TEST_F(TraceTest, NamesTheRobotWhoseUpdateIsRelayedToAGroup) {
  trace.turn(true);
  trace.on_step({.kind = StepKind::sent,
                 .mesh = Mesh::ble,
                 .robot = "r",
                 .address = "0xc100",
                 .topic = "p/robot/r/update"},
                now);
  ASSERT_EQ(events.size(), 1u);
  EXPECT_EQ(events[0].kind, StepKind::sent);
  EXPECT_TRUE(is_down(events[0].kind));
  EXPECT_EQ(events[0].robot, "r");
  EXPECT_EQ(events[0].type, "update");
  EXPECT_EQ(events[0].address, "0xc100") << "not the robot's own";
}

TEST_F(TraceTest, JoinsTheStepsOfAMessageToTheBroker) {
  trace.turn(true);
  trace.on_traffic(message(1));
  pass(1500us);
  trace.on_step({.kind = StepKind::published,
                 .mesh = Mesh::thread,
                 .topic = "p/robot/r/adv",
                 .qos = Qos::at_least_once,
                 .bytes = 2,
                 .receipt = {Mesh::thread, 1},
                 .since = now.mono - 1500us},
                now);
  pass(200us);
  trace.on_step({.kind = StepKind::acknowledged,
                 .mesh = Mesh::thread,
                 .robot = "r",
                 .receipt = {Mesh::thread, 1}},
                now);
  ASSERT_EQ(kinds(), (std::vector{StepKind::arrived, StepKind::published, StepKind::acknowledged}));
  EXPECT_EQ(events[0].payload, (Bytes{1, 2}));
  EXPECT_EQ(events[1].latency, 1500us);
  for (const TraceEvent& event : events) {
    EXPECT_EQ(event.robot, "r");
    EXPECT_EQ(event.address, "[::1]:5");
    EXPECT_EQ(event.topic, "p/robot/r/adv");
    EXPECT_EQ(event.type, "adv");
    EXPECT_EQ(event.wire.message_id, 7);
    EXPECT_EQ(event.bytes, 2u);
  }
  EXPECT_EQ(events[2].latency, 1700us);
  EXPECT_EQ(events[2].at, now.wall);
  EXPECT_EQ(trace.followed(), 0u);
}

TEST_F(TraceTest, FollowsARefusedMessageToItsAcknowledgement) {
  trace.turn(true);
  trace.on_traffic(message(1));
  MessageStep step{.kind = StepKind::refused, .mesh = Mesh::thread, .receipt = {Mesh::thread, 1}};
  step.since = now.mono;
  trace.on_step(step, now);
  EXPECT_EQ(trace.followed(), 1u);
  step.kind = StepKind::acknowledged;
  step.since.reset();
  trace.on_step(step, now);
  EXPECT_EQ(events.back().type, "adv");
  EXPECT_EQ(trace.followed(), 0u);
  trace.on_traffic(message(1));
  step.kind = StepKind::refused;
  trace.on_step(step, now);
  EXPECT_EQ(trace.followed(), 0u) << "refused by the mesh: no acknowledgement follows";
}

TEST_F(TraceTest, NamesTheRobotOfAStoredMessageByItsTopic) {
  trace.turn(true);
  trace.on_step({.kind = StepKind::published, .mesh = Mesh::thread, .topic = "p/robot/r/update"},
                now);
  ASSERT_EQ(events.size(), 1u);
  EXPECT_EQ(events[0].robot, "r");
  EXPECT_EQ(events[0].type, "update");
}

TEST_F(TraceTest, GivesTheReasonForMessagesUnderRejected) {
  trace.turn(true);
  trace.on_traffic(message(1));
  TrafficEvent rejected = message(2);
  rejected.is_rejected = true;
  trace.on_traffic(rejected);
  ASSERT_EQ(kinds(), (std::vector{StepKind::arrived, StepKind::arrived}));
  EXPECT_EQ(events[0].why, "");
  EXPECT_NE(events[1].why, "");
}

TEST_F(TraceTest, JoinsTheStepsOfACommandToItsOutcome) {
  trace.turn(true);
  TrafficEvent command = message(0);
  command.direction = Direction::down;
  command.topic = "p/server/r/cmd";
  command.type = "cmd";
  command.wire = {};
  command.command = CommandId{9};
  trace.on_traffic(command);
  pass(30ms);
  trace.on_step({.kind = StepKind::sent,
                 .mesh = Mesh::thread,
                 .robot = "r",
                 .topic = "p/server/r/cmd",
                 .wire = {4, true},
                 .command = CommandId{9}},
                now);
  pass(10ms);
  trace.on_outcome({Mesh::thread, CommandId{9}, "r", "cmd", CommandResult::delivered, 40ms, ""},
                   now);
  ASSERT_EQ(kinds(), (std::vector{StepKind::command, StepKind::sent, StepKind::outcome}));
  EXPECT_EQ(events[1].wire.message_id, 4);
  EXPECT_EQ(events[1].wire.is_dup, true);
  EXPECT_EQ(events[1].latency, 30ms);
  EXPECT_EQ(events[1].type, "cmd");
  EXPECT_EQ(events[2].outcome, CommandResult::delivered);
  EXPECT_EQ(events[2].latency, 40ms);
  for (const TraceEvent& event : events) {
    EXPECT_TRUE(is_down(event.kind));
    EXPECT_EQ(event.bytes, 2u);
  }
  EXPECT_EQ(trace.followed(), 0u);
}

TEST_F(TraceTest, ForgetsTheOldestMessageAboveItsBound) {
  trace.turn(true);
  for (std::uint64_t i = 1; i <= Trace::max_followed + 10; ++i) trace.on_traffic(message(i));
  EXPECT_EQ(trace.followed(), Trace::max_followed);
  events.clear();
  trace.on_step({.kind = StepKind::acknowledged,
                 .mesh = Mesh::thread,
                 .robot = "r",
                 .receipt = {Mesh::thread, 1}},
                now);
  ASSERT_EQ(events.size(), 1u);
  EXPECT_FALSE(events[0].latency) << "forgotten, but still reported";
  trace.turn(false);
  EXPECT_EQ(trace.followed(), 0u);
}

}  // namespace
}  // namespace slamgw
