// SPDX-License-Identifier: Apache-2.0
// What `slam-gatewayctl record` writes, `replay` reads.
#include "ctl/host/recording.hpp"

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include <sstream>

#include "ctl/connection.hpp"
#include "daemon/control/wire.hpp"

namespace slamgw::test {
namespace {

using namespace std::chrono_literals;

TraceEvent arrival(std::chrono::microseconds at, const std::string& topic) {
  TraceEvent event{{.kind = StepKind::arrived,
                    .mesh = {},
                    .robot = "r",
                    .topic = topic,
                    .qos = Qos::at_least_once},
                   WallTime{1'700'000'000s + at}};
  event.payload = Bytes{1, 0xff};
  return event;
}

std::vector<ctl::RecordedMessage> read(const std::string& text) {
  std::istringstream in(text);
  return ctl::read_recording(in, "file");
}

TEST(Recording, KeepsMessagesOfRobotsWithTiming) {
  TraceEvent command = arrival(1s, "p/server/r/cmd");
  command.kind = StepKind::command;
  std::string text;
  for (const TraceEvent& event :
       {arrival(0us, "p/robot/r/a"), command, arrival(1200ms + 42us, "p/robot/r/b")}) {
    EXPECT_TRUE(ctl::is_recorded(control::to_json(event)));
    text += control::to_json(event).dump() + "\n";
  }
  text += nlohmann::json::parse(control::lost_line(3, WallTime{}))["event"].dump() + "\n";
  const auto messages = read(text);
  ASSERT_EQ(messages.size(), 2u);
  EXPECT_EQ(messages[0].after, 0us);
  EXPECT_EQ(messages[0].message.topic, "p/robot/r/a");
  EXPECT_EQ(messages[0].message.payload, (Bytes{1, 0xff}));
  EXPECT_EQ(messages[0].message.qos, Qos::at_least_once);
  EXPECT_EQ(messages[1].after, 1200042us);
  EXPECT_EQ(messages[1].message.topic, "p/robot/r/b");
}

/// The recorder was killed, or its disk was full.
TEST(Recording, LeavesOutTruncatedLine) {
  const std::string line = control::to_json(arrival(0us, "p/robot/r/a")).dump();
  EXPECT_EQ(read(line + "\n" + line.substr(0, 40)).size(), 1u);
  EXPECT_EQ(read(line).size(), 1u) << "a whole line without line feed";
  EXPECT_THROW(read(line.substr(0, 40)), ctl::Failure) << "not a recording";
  EXPECT_EQ(read(line.substr(0, 40) + "\n" + line).size(), 1u) << "continued after the cut";
}

TEST(Recording, RefusesClockStepDuringRecording) {
  const auto text = [](std::chrono::microseconds at) {
    return control::to_json(arrival(at, "p/robot/r/a")).dump() + "\n";
  };
  EXPECT_EQ(read(text(0us) + text(29 * 24h)).size(), 2u);
  EXPECT_THROW(read(text(0us) + text(31 * 24h)), ctl::Failure);
  EXPECT_THROW(read(text(0us) + text(-365 * 24h)), ctl::Failure);
}

TEST(Recording, LeavesOutLaterStepsOfMessages) {
  TraceEvent event = arrival(0us, "t");
  for (const auto kind :
       {StepKind::published, StepKind::acknowledged, StepKind::repeat, StepKind::outcome}) {
    event.kind = kind;
    EXPECT_FALSE(ctl::is_recorded(control::to_json(event)));
  }
}

TEST(Recording, LeavesOutRejectedPayloads) {
  TraceEvent event = arrival(0us, "p/robot/r/update");
  event.why = "not a valid update";
  EXPECT_TRUE(read(control::to_json(event).dump() + "\n").empty());
}

TEST(Recording, NamesInvalidLine) {
  const std::string good = control::to_json(arrival(0us, "t")).dump() + "\n";
  EXPECT_TRUE(read("").empty());
  for (const std::string_view bad :
       {"x", "5", "{}", R"({"at": "yesterday", "event": "lost"})",
        R"({"at": "2023-11-14T22:13:20Z", "event": "arrived", "topic": "t", "payload": "0"})",
        R"({"at": "2023-11-14T22:13:20Z", "event": "arrived", "topic": "t/#", "payload": "00"})",
        R"({"at": "2023-11-14T22:13:20Z", "event": "arrived", "payload": "00", "qos": 1})"}) {
    try {
      read(good + std::string(bad) + "\n");
      ADD_FAILURE() << bad;
    } catch (const ctl::Failure& failure) {
      EXPECT_TRUE(std::string(failure.what()).starts_with("file:2: ")) << failure.what();
    }
  }
}

}  // namespace
}  // namespace slamgw::test
