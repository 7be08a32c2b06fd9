// SPDX-License-Identifier: Apache-2.0
// The BLE robot on a virtual clock: what it publishes, repeats and answers.
#include "simulation/ble/robot/robot.hpp"

#include <gtest/gtest.h>

#include "tests/simulation/hex.hpp"

namespace slamgw::sim::ble {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

class RobotTest : public ::testing::Test {
 protected:
  struct Sent {
    Duration at;
    MeshMessage message;
  };

  void begin(RobotSettings settings) {
    robot_.emplace(settings, RobotBody(1, 1));
    robot_->on_start(now_);
  }
  static Robot::Publications groups() {
    return {Robot::Publication{min_com_group, default_ttl, {}},
            Robot::Publication{sensor_update_group, default_ttl, {}},
            Robot::Publication{0x0001, default_ttl, health_interval}};
  }
  void pass(Duration time, const Robot::Publications& publications = groups()) {
    const TimePoint end = now_ + time;
    while (robot_->deadline() <= end) {
      now_ = std::max(now_, robot_->deadline());
      robot_->on_deadline(publications, now_);
      collect();
    }
    now_ = end;
  }
  void collect() {
    while (auto outgoing = robot_->next_transmission()) {
      sent_.push_back({now_ - begin_, outgoing->message});
    }
  }
  /// Delivers a message from the gateway; returns the robot's answer, or "".
  std::string ask(std::string_view payload, Address destination = first_robot) {
    sent_.clear();
    robot_->on_message({0x0001, destination, 4, hex(payload)}, now_);
    collect();
    if (sent_.empty()) return "";
    EXPECT_EQ(sent_[0].message.destination, 0x0001);
    return to_hex(sent_[0].message.payload);
  }

  const TimePoint begin_{seconds{1000}};
  TimePoint now_ = begin_;
  std::optional<Robot> robot_;
  std::vector<Sent> sent_;
};

TEST_F(RobotTest, IntroducesItselfThenPublishesToItsGroups) {
  RobotSettings settings;
  settings.messages = 2;
  begin(settings);
  pass(seconds{1});
  ASSERT_EQ(sent_.size(), 3U);
  EXPECT_EQ(to_hex(sent_[0].message.payload), "c7 59 00 01 00 0d 12 09 06");
  EXPECT_EQ(sent_[0].message.destination, min_com_group);
  EXPECT_EQ(sent_[1].message.destination, sensor_update_group);
  RobotBody body(1, 1);
  EXPECT_EQ(sent_[1].message.payload,
            vendor_message(Vendor::sensor_update_set_unreliable, body.next_update()));
  EXPECT_EQ(sent_[2].at - sent_[1].at, milliseconds{200});
  EXPECT_EQ(robot_->tally(), (Tally{2, 0, 0, 0}));
  EXPECT_TRUE(robot_->has_sent_everything());
}

/// The STATUS of a repeat acknowledges nothing after the next message was sent (the daemon's
/// README on BLE, "What robots' firmware should do").
TEST_F(RobotTest, ANumberedMessageTakesOnlyItsOwnStatus) {
  RobotSettings settings;
  settings.is_acknowledged = settings.is_numbered = true;
  begin(settings);
  pass(milliseconds{10});
  ASSERT_EQ(sent_.size(), 1U);
  EXPECT_EQ(to_hex(sent_[0].message.payload), "d1 59 00 01 01 00 0d 12 09 06");
  ask("c8 59 00 00 01");
  sent_.clear();
  pass(milliseconds{250});
  ASSERT_GE(sent_.size(), 1U);
  EXPECT_EQ(to_hex(sent_[0].message.payload).substr(0, 11), "d2 59 00 02");
  ask("cc 59 00 00 01");
  ask("cc 59 00 00");
  EXPECT_EQ(robot_->tally().acknowledged, 0U);
  ask("cc 59 00 00 02");
  EXPECT_EQ(robot_->tally().acknowledged, 1U);
}

TEST_F(RobotTest, WaitsUntilTheBoardCanHear) {
  begin({});
  pass(seconds{5}, {});
  EXPECT_TRUE(sent_.empty());
  pass(milliseconds{20});
  EXPECT_EQ(sent_.size(), 1U);
}

TEST_F(RobotTest, RepeatsAReliableMessageAtDoublingIntervalsUntilAMinute) {
  RobotSettings settings;
  settings.is_acknowledged = true;
  settings.messages = 1;
  begin(settings);
  pass(seconds{59});
  std::vector<Duration> at;
  for (const Sent& sent : sent_) {
    if (sent.message.payload[0] == 0xc5) at.push_back(sent.at);
  }
  EXPECT_EQ(at,
            (std::vector<Duration>{milliseconds{0}, milliseconds{280}, milliseconds{560},
                                   milliseconds{1120}, milliseconds{2240}, milliseconds{4480},
                                   milliseconds{8960}, milliseconds{17920}, milliseconds{35840}}));
  sent_.clear();
  pass(seconds{2});  // given up after 60 s: now the update
  std::erase_if(sent_, [](const Sent& sent) { return sent.message.payload[0] == 0x04; });
  ASSERT_FALSE(sent_.empty());
  EXPECT_EQ(sent_.front().message.payload[0], 0xc9);
  EXPECT_FALSE(robot_->has_sent_everything());
  pass(seconds{60});
  EXPECT_EQ(robot_->tally(), (Tally{1, 0, 1, 0}));
}

TEST_F(RobotTest, CompletesOnTheRightStatusSentToItsOwnAddress) {
  RobotSettings settings;
  settings.is_acknowledged = true;
  settings.messages = 1;
  begin(settings);
  pass(milliseconds{1});
  ask("cc 59 00 00");  // another status than the expected one
  pass(milliseconds{299});
  EXPECT_EQ(to_hex(ByteView(sent_.at(0).message.payload).first(1)), "c5");
  ask("c8 59 00 00", min_com_group);
  ask("c8 59 00 00");
  pass(milliseconds{220});
  EXPECT_EQ(sent_.at(0).message.payload[0], 0xc9);
  ask("cc 59 00 00");
  EXPECT_EQ(robot_->tally(), (Tally{1, 1, 0, 0}));
  EXPECT_TRUE(robot_->has_sent_everything());
}

TEST_F(RobotTest, LosesUpdatesBehindReliableOneUnlessTheirNumberIsSet) {
  RobotSettings settings;
  settings.is_acknowledged = true;
  begin(settings);
  pass(milliseconds{1});
  ask("c8 59 00 00");
  pass(milliseconds{1200});
  EXPECT_EQ(robot_->tally().sent, 1U);
  EXPECT_EQ(robot_->tally().lost, 5U);
}

TEST_F(RobotTest, RecordsUpdatesAndTheirAcknowledgements) {
  RobotSettings settings;
  settings.is_acknowledged = settings.is_recorded = true;
  begin(settings);
  pass(milliseconds{1});
  ask("c8 59 00 00");  // for the introduction, which is not an update
  pass(milliseconds{1200});
  ask("cc 59 00 00");
  RobotBody body(1, 1);
  const auto sent = robot_->next_event();
  ASSERT_TRUE(sent.has_value());
  EXPECT_FALSE(sent->is_acknowledged());
  EXPECT_EQ(sent->number, 1U);
  EXPECT_EQ(sent->payload, body.next_update());
  std::vector<UpdateEvent> later;
  while (auto event = robot_->next_event()) later.push_back(*event);
  ASSERT_FALSE(later.empty());
  EXPECT_TRUE(later.back().is_acknowledged());
  EXPECT_EQ(later.back().number, 1U);
  for (const UpdateEvent& event : later) {
    EXPECT_NE(event.kind, UpdateEvent::Kind::sent) << "updates that are lost are not sent";
  }
}

/// Thesis 9.1 and 9.2: one SET outstanding, cancelled when it has no STATUS by the next update.
TEST_F(RobotTest, CancelsWithoutStatusAndSkipsThatUpdate) {
  RobotSettings settings;
  settings.is_acknowledged = settings.is_recorded = true;
  settings.on_busy = OnBusy::cancel;
  settings.messages = 4;
  begin(settings);
  pass(milliseconds{1});
  ask("c8 59 00 00");  // of the introduction
  sent_.clear();
  pass(milliseconds{1000});
  ASSERT_EQ(sent_.size(), 2U) << "without any STATUS every other update is sent";
  EXPECT_EQ(sent_[1].at - sent_[0].at, milliseconds{400});
  EXPECT_EQ(robot_->tally(), (Tally{2, 0, 2, 0}));
}

TEST_F(RobotTest, RefusesUpdatesAndRepeatsTheOldOne) {
  RobotSettings settings;
  settings.is_acknowledged = true;
  settings.on_busy = OnBusy::refuse;
  settings.messages = 4;
  begin(settings);
  pass(milliseconds{1});
  ask("c8 59 00 00");
  sent_.clear();
  pass(milliseconds{1000});
  ASSERT_GE(sent_.size(), 3U);
  EXPECT_EQ(sent_[1].message.payload, sent_[0].message.payload);
  EXPECT_EQ(robot_->tally(), (Tally{1, 0, 3, 0}));
}

/// Thesis 9.1: about 2.6 s between segmented messages to a group, the 2.5 s of the transport
/// rounded up to the next update.
TEST_F(RobotTest, SegmentedMessagesToAGroupComeEach2600Milliseconds) {
  RobotSettings settings;
  settings.has_segment_timing = true;
  settings.on_busy = OnBusy::cancel;
  settings.messages = 30;
  begin(settings);
  pass(seconds{7});
  ASSERT_EQ(sent_.size(), 4U) << "the introduction and three updates";
  EXPECT_EQ(sent_[2].at - sent_[1].at, milliseconds{2600});
  EXPECT_EQ(sent_[3].at - sent_[2].at, milliseconds{2600});
}

TEST_F(RobotTest, SendsProbesOnModelOfFigure71) {
  RobotSettings settings;
  settings.messages = 2;
  now_ = begin_;
  BodySettings body;
  body.payload = BodySettings::Payload::probe;
  robot_.emplace(settings, RobotBody(1, 1, body));
  robot_->on_start(now_);
  pass(seconds{1});
  ASSERT_EQ(sent_.size(), 2U) << "no introduction";
  EXPECT_EQ(to_hex(sent_[0].message.payload), "c7 59 00 01 00 00 00 00 00");
  EXPECT_EQ(to_hex(sent_[1].message.payload), "c7 59 00 02 00 c8 00 00 00");
  EXPECT_EQ(segment_count(sent_[0].message.payload.size()), 1U);
}

TEST_F(RobotTest, AnswersPositionCommands) {
  begin({});
  EXPECT_EQ(ask("cd 59 00 0a 00 ec ff"), "d0 59 00 00");
  EXPECT_EQ(ask("cf 59 00 0a 00 ec ff"), "");
  EXPECT_EQ(ask("ce 59 00"), "d0 59 00 00");
  EXPECT_EQ(ask("c5 59 00 01"), "c8 59 00 00");
  EXPECT_EQ(ask("cd 58 00 0a 00 ec ff"), "");  // another company
  EXPECT_EQ(ask(""), "");
  EXPECT_EQ(robot_->tally().commands_received, 3U);
}

TEST_F(RobotTest, RecordsCommands) {
  RobotSettings settings;
  settings.is_recorded = true;
  begin(settings);
  for (const char* command : {"cd 59 00 0a 00 ec ff", "c5 59 00 01", "82 02 00 07", "82 02 00 07"})
    ask(command);
  const std::pair<const char*, const char*> expected[] = {
      {"cmd", "0a 00 ec ff"}, {"min_com", "01"}, {"run", "00"}};
  for (const auto& [type, payload] : expected) {
    const auto event = robot_->next_event();
    ASSERT_TRUE(event.has_value());
    EXPECT_EQ(event->kind, UpdateEvent::Kind::command);
    EXPECT_EQ(event->type, type);
    EXPECT_EQ(to_hex(event->payload), payload);
  }
  EXPECT_FALSE(robot_->next_event().has_value()) << "a repeat with the same transaction id";
}

TEST_F(RobotTest, SwitchesOncePerTransaction) {
  begin({});
  EXPECT_EQ(ask("82 02 00 07"), "82 04 00");
  EXPECT_EQ(ask("82 02 00 07"), "82 04 00");
  EXPECT_EQ(robot_->tally().commands_received, 1U);
  EXPECT_EQ(ask("82 03 01 08"), "");
  EXPECT_EQ(ask("82 01"), "82 04 01");
  EXPECT_EQ(ask("c1 59 00 00 09"), "c4 59 00 00");
  EXPECT_EQ(ask("c3 59 00 01 0a"), "");
  EXPECT_EQ(ask("c2 59 00"), "c4 59 00 01");
  now_ += same_transaction;
  EXPECT_EQ(ask("c3 59 00 01 0a"), "");  // too late to be a repeat
  EXPECT_EQ(robot_->tally().commands_received, 5U);
}

TEST_F(RobotTest, PublishesItsHealthEachTenSeconds) {
  RobotSettings settings;
  settings.messages = 1;
  begin(settings);
  pass(seconds{35});
  int health = 0;
  for (const Sent& sent : sent_) {
    if (to_hex(sent.message.payload) != "04 00 59 00") continue;
    EXPECT_EQ(sent.message.destination, 0x0001);
    ++health;
  }
  EXPECT_EQ(health, 3);
}

TEST_F(RobotTest, WaitsForSegmentedGroupMessagesOnRequest) {
  RobotSettings settings;
  settings.has_segment_timing = true;
  settings.messages = 3;
  begin(settings);
  pass(seconds{10});
  ASSERT_GE(sent_.size(), 4U);
  EXPECT_GE(sent_[2].at - sent_[1].at, milliseconds{2500});
}

TEST(Access, CountsSegmentsAndTimes) {
  const std::pair<std::size_t, std::size_t> sizes[] = {{7, 1},  {11, 1}, {12, 2}, {15, 2},
                                                       {20, 2}, {21, 3}, {24, 3}, {380, 32}};
  for (const auto& [octets, segments] : sizes) EXPECT_EQ(segment_count(octets), segments);
  EXPECT_EQ(segmented_session(0x0001, 4), milliseconds{350});
  EXPECT_EQ(segmented_session(sensor_update_group, 4), milliseconds{2500});
  EXPECT_EQ(reliable_interval(4, 11), milliseconds{280});
  EXPECT_EQ(reliable_interval(30, 11), milliseconds{800});
  EXPECT_EQ(reliable_interval(4, 12), milliseconds{320});
}

TEST_F(RobotTest, CountsUpdatesOfOtherMeshesWithoutAnswering) {
  RobotSettings settings;
  settings.is_recorded = true;
  begin(settings);
  EXPECT_EQ(ask("d4 59 00 0d 89 0a 00 ec ff", relay_group), "");
  EXPECT_EQ(ask("d4 59 00 0d 89", relay_group), "");
  EXPECT_EQ(ask("d4 59 00 0d", relay_group), "");
  EXPECT_EQ(robot_->tally().heard, (std::map<std::string, std::uint64_t>{{"0x890d", 2}}));
  const auto event = robot_->next_event();
  ASSERT_TRUE(event);
  EXPECT_EQ(event->kind, UpdateEvent::Kind::heard);
  EXPECT_EQ(event->sender, "0x890d");
  EXPECT_EQ(to_hex(event->payload), "0a 00 ec ff");
}

}  // namespace
}  // namespace slamgw::sim::ble
