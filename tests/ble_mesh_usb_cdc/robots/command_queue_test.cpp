// SPDX-License-Identifier: Apache-2.0
// Repeats of commands to one robot: as soon as the robot should have answered, and never later than
// reliable publish would.
#include "adapters/ble_mesh_usb_cdc/robots/command_queue.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "adapters/ble_mesh_usb_cdc/access/robot_models.hpp"
#include "tests/ble_mesh_usb_cdc/hex.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;
using std::chrono::milliseconds;

constexpr Opcode position_status = 0xd05900;
constexpr Opcode text_status = 0xc85900;
const Duration repeat_interval = reliable_interval(4, 7);  // 280 ms

Command position(std::string_view type = "cmd") {
  return {CommandId::none, std::string(type), hex("cd 59 00 0a 00 ec ff"), position_status, false};
}

/// One robot behind a queue, on a virtual clock.
class Conversation {
 public:
  /// Sends a command that the robot answers at its first copy after `round_trip`.
  void exchange(Duration round_trip) {
    queue.add(position(), now);
    send();
    now += round_trip;
    send();
    end(queue.on_status(position_status, now));
  }
  /// Returns the waits before the first `count` repeats of a command without an answer.
  std::vector<milliseconds> waits(std::size_t count, Command command = position()) {
    std::vector<milliseconds> waits;
    queue.add(std::move(command), now);
    send();
    for (TimePoint last = now; waits.size() < count; last = now) {
      pass();
      waits.push_back(std::chrono::duration_cast<milliseconds>(now - last));
    }
    return waits;
  }
  /// Advances the clock to the queue's next deadline.
  void pass() {
    now = *queue.deadline();
    end(queue.on_deadline(now));
    send();
  }
  void send() {
    if (queue.next_transmission(now)) sent.push_back(now);
  }
  void end(EndedCommands ended) {
    for (auto& command : ended) outcomes.push_back(std::move(command));
  }

  CommandQueue queue{4};
  TimePoint now{};
  std::vector<TimePoint> sent;
  EndedCommands outcomes;
};

TEST(AnswerTime, FollowsTheRoundTripAndItsVariation) {
  AnswerTime time;
  EXPECT_EQ(time.timeout(repeat_interval), repeat_interval) << "nothing is measured";
  time.on_answer(60ms);
  EXPECT_EQ(time.timeout(repeat_interval), 180ms) << "60 ms and four times half of that";
  for (int i = 0; i < 30; ++i) time.on_answer(60ms);
  EXPECT_EQ(time.timeout(repeat_interval), AnswerTime::shortest_timeout);
  time.on_answer(150ms);
  EXPECT_GT(time.timeout(repeat_interval), 150ms);
  for (int i = 0; i < 30; ++i) time.on_answer(2s);
  EXPECT_EQ(time.timeout(repeat_interval), repeat_interval) << "no later than reliable publish";
}

TEST(AnswerTime, DoublesWhileNothingIsMeasured) {
  AnswerTime time;
  time.on_repeated();
  EXPECT_EQ(time.timeout(repeat_interval), repeat_interval);
  time.on_answer(20ms);
  EXPECT_EQ(time.timeout(1s), 100ms);
  time.on_repeated();
  time.on_repeated();
  EXPECT_EQ(time.timeout(1s), 400ms);
  for (int i = 0; i < 100; ++i) time.on_repeated();
  EXPECT_EQ(time.timeout(60s), AnswerTime::longest_timeout);
  time.on_answer(20ms);
  EXPECT_EQ(time.timeout(1s), 100ms);
}

TEST(CommandQueue, RepeatsLikeReliablePublishToUnknownRobot) {
  EXPECT_EQ(Conversation().waits(5),
            (std::vector<milliseconds>{280ms, 280ms, 560ms, 1120ms, 2240ms}));
}

TEST(CommandQueue, RepeatsAsSoonAsTheRobotShouldHaveAnswered) {
  Conversation robot;
  for (int i = 0; i < 20; ++i) robot.exchange(40ms);
  EXPECT_EQ(robot.waits(4), (std::vector<milliseconds>{100ms, 100ms, 200ms, 400ms}));
}

TEST(CommandQueue, NeverRepeatsLaterThanReliablePublish) {
  Conversation robot;
  for (int i = 0; i < 20; ++i) robot.exchange(270ms);
  EXPECT_EQ(robot.waits(3), (std::vector<milliseconds>{280ms, 280ms, 560ms}));
}

TEST(CommandQueue, RepeatsSegmentedMessagesNoSooner) {
  Conversation robot;
  for (int i = 0; i < 20; ++i) robot.exchange(40ms);
  Command text{CommandId::none, "text", hex("c5 59 00") + Bytes(20, 'x'), text_status, false};
  EXPECT_EQ(robot.waits(1, text).front(), reliable_interval(4, text.access.size()));
}

TEST(CommandQueue, AnswerToRepeatedCommandIsNotMeasured) {
  Conversation robot;
  robot.exchange(20ms);
  robot.queue.add(position(), robot.now);
  robot.send();
  robot.pass();  // 100 ms: the robot is slow, or the command was lost
  robot.now += 1ms;
  robot.end(robot.queue.on_status(position_status, robot.now));
  robot.now += 1s;
  EXPECT_EQ(robot.waits(1).front(), 200ms) << "backed off";
}

TEST(CommandQueue, ALateAnswerDoesNotEndTheNextCommand) {
  Conversation robot;
  robot.exchange(20ms);
  robot.queue.add(position("first"), robot.now);
  robot.queue.add(position("second"), robot.now);
  robot.send();
  robot.pass();  // a second copy: 100 ms
  robot.now += 5ms;
  robot.end(robot.queue.on_status(position_status, robot.now));  // for the first copy
  robot.send();
  robot.now += 100ms;
  robot.end(robot.queue.on_status(position_status, robot.now));  // for the second copy
  ASSERT_EQ(robot.outcomes.size(), 2u);
  EXPECT_EQ(robot.outcomes[1].type, "first");
  robot.pass();
  EXPECT_EQ(robot.sent.size(), 4u) << "the second command is sent now";
}

TEST(CommandQueue, LateAnswersOfOneKindAreExpectedWhileAnotherKindIsRepeated) {
  Conversation robot;
  robot.exchange(20ms);
  const TimePoint begin = robot.now;
  robot.queue.add(position("first"), robot.now);
  robot.queue.add({CommandId::none, "text", hex("c5 59 00 01"), text_status, false}, robot.now);
  robot.queue.add(position("second"), robot.now);
  robot.send();
  robot.pass();  // a second copy of the first command
  robot.now = begin + 150ms;
  robot.end(robot.queue.on_status(position_status, robot.now));
  robot.send();
  robot.pass();  // a second copy of the text
  EXPECT_EQ(robot.now, begin + 350ms);
  robot.now = begin + 360ms;
  robot.end(robot.queue.on_status(text_status, robot.now));
  robot.send();
  ASSERT_EQ(robot.sent.size(), 5u) << "the first command's second copy may still be answered";
  EXPECT_EQ(robot.queue.deadline(), begin + 150ms + repeat_interval);
  robot.end(robot.queue.on_status(position_status, robot.now));
  EXPECT_EQ(robot.outcomes.size(), 3u) << "the second command is not delivered";
  robot.pass();
  EXPECT_EQ(robot.sent.size(), 6u);
}

TEST(CommandQueue, CommandOfAnotherKindDoesNotWaitForLateAnswers) {
  Conversation robot;
  robot.exchange(20ms);
  robot.queue.add(position(), robot.now);
  robot.queue.add({CommandId::none, "text", hex("c5 59 00 01"), text_status, false}, robot.now);
  robot.send();
  robot.pass();
  robot.end(robot.queue.on_status(position_status, robot.now));
  robot.send();
  EXPECT_EQ(robot.sent.size(), 4u);
}

TEST(CommandQueue, DoesNotSendACommandThatCameTooLate) {
  Conversation robot;
  Command late = position();
  late.message.waited = 29s;
  robot.end(robot.queue.add(late, robot.now));
  robot.send();
  EXPECT_TRUE(robot.sent.empty());
  ASSERT_LE(*robot.queue.deadline(), robot.now);
  robot.end(robot.queue.on_deadline(robot.now));
  ASSERT_EQ(robot.outcomes.size(), 1u);
  EXPECT_EQ(robot.outcomes[0].result, CommandResult::timeout);
  EXPECT_EQ(robot.outcomes[0].why, "not sent: it waited too long");
}

TEST(CommandQueue, SendsAndRepeatsNothingThatIsOverdue) {
  Conversation robot;
  robot.queue.add(position("first"), robot.now);
  robot.queue.add(position("second"), robot.now);
  robot.send();
  robot.now += 30s;
  robot.send();
  EXPECT_EQ(robot.sent.size(), 1u);
  robot.end(robot.queue.on_status(position_status, robot.now));
  robot.send();
  EXPECT_EQ(robot.sent.size(), 1u);
  robot.end(robot.queue.on_deadline(robot.now));
  ASSERT_EQ(robot.outcomes.size(), 2u);
  EXPECT_EQ(robot.outcomes[0].result, CommandResult::delivered);
  EXPECT_EQ(robot.outcomes[1].result, CommandResult::timeout);
}

/// A fifth of all messages lost each way; the robot answers in 30 to 60 ms.
TEST(CommandQueue, ALossyRadioDelaysCommandsLittle) {
  std::mt19937_64 random(5);
  const auto is_lost = [&] { return random() % 5 == 0; };
  Conversation robot;
  std::vector<Duration> times;
  int copies = 0;
  for (int i = 0; i < 1000; ++i) {
    robot.now += 1s;
    const TimePoint begun = robot.now;
    robot.queue.add(position(), robot.now);
    robot.send();
    while (robot.queue.size() > 0) {
      ++copies;
      const bool is_answered = !is_lost() && !is_lost();
      const TimePoint answered = robot.now + milliseconds(30 + random() % 30);
      if (is_answered && answered < robot.queue.deadline()) {
        robot.now = answered;
        robot.end(robot.queue.on_status(position_status, robot.now));
      } else {
        robot.pass();
      }
    }
    times.push_back(robot.now - begun);
  }
  std::ranges::sort(times);
  EXPECT_LT(times[900], 500ms) << "at the schedule of reliable publish: 600 ms";
  EXPECT_LT(copies, 1700) << "an answer takes 1.56 copies";
  for (const EndedCommand& command : robot.outcomes)
    EXPECT_EQ(command.result, CommandResult::delivered);
}

TEST(ReliablePublish, IntervalGrowsWithTtlAndSegments) {
  EXPECT_EQ(reliable_interval(4, 7), 280ms);
  EXPECT_EQ(reliable_interval(4, 12), 320ms);
  EXPECT_EQ(reliable_interval(30, 11), 800ms);
}

}  // namespace
}  // namespace slamgw::ble
