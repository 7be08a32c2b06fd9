// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/robot_numbers.hpp"

#include <gtest/gtest.h>

#include "daemon/core/gateway.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

TEST(RateMeter, MeasuresASteadyRateAndForgetsIt) {
  RateMeter meter;
  TimePoint now{1h};
  for (int i = 0; i < 100; ++i) meter.on_message(now += 200ms);
  EXPECT_NEAR(meter.per_second(now), 5.0, 0.5);
  EXPECT_EQ(meter.per_second(now + 20s), 0.0);
}

TEST(LatencyWindow, ReturnsPercentilesOfTheLastMinute) {
  LatencyWindow window;
  TimePoint now{1h};
  EXPECT_FALSE(window.percentiles(now));
  for (int i = 1; i <= 100; ++i) window.add(std::chrono::microseconds(i), now);
  EXPECT_EQ(window.percentiles(now)->p50, 50us);
  EXPECT_EQ(window.percentiles(now)->p99, 99us);
  now += 59s;
  window.add(7s, now);
  EXPECT_EQ(window.percentiles(now)->p99, 100us);
  now += 1s;
  EXPECT_EQ(window.percentiles(now)->p50, 7s) << "the others are older than a minute";
  EXPECT_FALSE(window.percentiles(now + 60s));
}

TEST(LatencyWindow, KeepsTheNewestLatenciesAboveItsBound) {
  LatencyWindow window;
  const TimePoint now{1h};
  for (std::size_t i = 0; i < LatencyWindow::max_samples; ++i) window.add(9s, now);
  for (std::size_t i = 0; i < LatencyWindow::max_samples; ++i) window.add(2ms, now + 1s);
  EXPECT_EQ(window.percentiles(now + 1s)->p99, 2ms);
}

TEST(LatencyWindow, WorksWhenItsTimeStampsWrapAround) {
  LatencyWindow window;
  const TimePoint now = TimePoint{} + std::chrono::milliseconds((std::int64_t{1} << 32) - 5);
  window.add(1ms, now);
  EXPECT_TRUE(window.percentiles(now + 30s));
  EXPECT_FALSE(window.percentiles(now + 61s));
}

TEST(RobotNumbers, CountsAnUnusualPauseAsAGap) {
  RobotNumbers numbers;
  TimePoint now{1h};
  for (int i = 0; i < 20; ++i) numbers.on_up(9, now += i % 2 == 0 ? 180ms : 220ms);
  EXPECT_EQ(numbers.gaps(), 0u) << "jitter is not a gap";
  numbers.on_up(9, now += 2s);
  EXPECT_EQ(numbers.gaps(), 1u);
  for (int i = 0; i < 20; ++i) numbers.on_up(9, now += 200ms);
  EXPECT_EQ(numbers.gaps(), 1u);
  EXPECT_EQ(numbers.up(), 41u);
  EXPECT_EQ(numbers.bytes_up(), 41u * 9);
}

TEST(RobotNumbers, LearnsNothingFromMessagesThatAreReadTogether) {
  RobotNumbers numbers;
  TimePoint now{1h};
  for (int i = 0; i < 5; ++i) numbers.on_up(9, now += 50us);
  for (int i = 0; i < 50; ++i) numbers.on_up(9, now += 200ms);
  EXPECT_EQ(numbers.gaps(), 0u);
  numbers.on_up(9, now += 2s);
  EXPECT_EQ(numbers.gaps(), 1u);
}

class GatewayNumbers : public testing::Test {
 protected:
  void say(MeshEvent event) { gateway.on_mesh_event(std::move(event), now); }
  std::vector<std::string> presences() {
    std::vector<std::string> found;
    while (auto action = gateway.next_action()) {
      const auto* upload = std::get_if<Upload>(&*action);
      if (upload && upload->message.retain) found.emplace_back(as_text(upload->message.payload));
    }
    return found;
  }
  Report report(std::uint64_t receipt) const {
    return {.mesh = Mesh::thread,
            .robot = "r",
            .topic = "p/robot/r/adv",
            .payload = {1, 2, 3},
            .receipt = {Mesh::thread, receipt}};
  }

  Now now{TimePoint{1h}, WallTime{1'700'000'000s}};
  BrokerLink broker{true, {}, {}};
  Gateway gateway{TopicScheme("p", "g"),
                  {"1", UpdateMode::positions, {}},
                  broker,
                  [](Mesh, const std::string&) { return Presence::online; }};
};

TEST_F(GatewayNumbers, CountMessagesFromAndToARobot) {
  say(report(1));
  now.mono += 3ms;
  gateway.on_receipt({Mesh::thread, 1}, ReceiptOutcome::safe, now);
  gateway.on_receipt({Mesh::thread, 1}, ReceiptOutcome::safe, now);
  say(report(2));
  gateway.on_receipt({Mesh::thread, 2}, ReceiptOutcome::refused, now);
  say(MessageStep{.kind = StepKind::repeat, .mesh = Mesh::thread, .robot = "r"});
  say(MessageStep{.kind = StepKind::sent, .mesh = Mesh::thread, .robot = "r"});
  gateway.commands().on_robot_message({"r", {"p/server/r/cmd", {1, 2}, Qos::at_least_once, false}},
                                      now);
  const RobotNumbers& numbers = gateway.registry().find("r")->numbers;
  EXPECT_EQ(numbers.up(), 2u);
  EXPECT_EQ(numbers.bytes_up(), 6u);
  EXPECT_EQ(numbers.down(), 1u);
  EXPECT_EQ(numbers.bytes_down(), 2u);
  EXPECT_EQ(numbers.repeats(), 1u);
  EXPECT_EQ(numbers.latency(now.mono)->p99, 3ms) << "of the one that became safe";
  const MeshPresence& there = gateway.registry().find("r")->on_mesh[Mesh::thread];
  EXPECT_EQ(there.up, 2u);
  EXPECT_EQ(there.down, 1u);
  EXPECT_EQ(there.repeats, 1u);
  EXPECT_EQ(gateway.latencies(Mesh::thread).count(), 1u);
  EXPECT_EQ(gateway.latencies(Mesh::thread).sum(), 3ms);
  EXPECT_EQ(gateway.latencies(Mesh::ble).count(), 0u);
}

TEST(LatencyHistogram, CountsLatenciesUpToEachBound) {
  LatencyHistogram latencies;
  for (const auto latency : {500us, 501us, 1000us, 11'000'000us}) latencies.add(latency);
  EXPECT_EQ(latencies.at_most()[0], 1u) << "500 us";
  EXPECT_EQ(latencies.at_most()[1], 3u) << "1 ms";
  EXPECT_EQ(latencies.at_most().back(), 3u) << "10 s";
  EXPECT_EQ(latencies.count(), 4u);
  EXPECT_EQ(latencies.sum(), 11'002'001us);
}

TEST_F(GatewayNumbers, LastSeenOfThePresenceIsRenewedForAHeardRobot) {
  say(PresenceChange{Mesh::thread, "r", Presence::online, "a"});
  EXPECT_EQ(presences().size(), 1u);
  const auto pass = [&](std::chrono::seconds time) {
    now.mono += time;
    now.wall += time;
  };
  pass(299s);
  say(SignOfLife{Mesh::thread, "r"});
  EXPECT_TRUE(presences().empty());
  pass(1s);
  say(SignOfLife{Mesh::thread, "r"});
  const auto published = presences();
  ASSERT_EQ(published.size(), 1u);
  EXPECT_NE(published[0].find(R"("last_seen":"2023-11-14T22:18:20Z")"), std::string::npos)
      << published[0];
  pass(1s);
  say(report(0));
  EXPECT_TRUE(presences().empty());
}

}  // namespace
}  // namespace slamgw
