// SPDX-License-Identifier: Apache-2.0
// Commands over a radio that loses a fifth of the datagrams each way, on a virtual clock. Also the
// gateway's estimate of a client's round trip (RFC 6298).
#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <random>

#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

/// A client behind a lossy radio that answers every PUBLISH.
class LossyLink {
 public:
  LossyLink(std::uint64_t seed, double loss, Duration round_trip)
      : random_(seed), loss_(loss), round_trip_(round_trip) {
    rig_.connect(1, "r1", true, 6000);
    rig_.subscribe(1, r1_command, 1);
    rig_.datagrams.clear();
  }

  void command(int number) {
    sent_[number] = rig_.now;
    rig_.broker(r1_command, std::to_string(number), 1);
  }

  void pass(Duration time) {
    constexpr milliseconds step{10};
    for (Duration passed{}; passed < time; passed += step) {
      rig_.pass(step);
      take_datagrams();
      while (!answers_.empty() && answers_.begin()->first <= rig_.now) {
        const Puback answer = answers_.begin()->second;
        answers_.erase(answers_.begin());
        if (!is_lost()) rig_.send(1, answer);
      }
    }
  }

  /// Returns the time that the command took to the robot; nullopt if it never arrived.
  std::optional<Duration> delay(int number) const {
    const auto came = came_.find(number);
    if (came == came_.end()) return std::nullopt;
    return came->second - sent_.at(number);
  }
  unsigned copies() const { return copies_; }
  const SnRig& rig() const { return rig_; }

 private:
  bool is_lost() { return std::uniform_real_distribution<double>(0, 1)(random_) < loss_; }

  void take_datagrams() {
    for (const SendDatagram& datagram : std::exchange(rig_.datagrams, {})) {
      const Packet packet = *decode(datagram.bytes);
      const auto* publish = std::get_if<Publish>(&packet);
      if (!publish) continue;
      ++copies_;
      if (is_lost()) continue;
      came_.emplace(std::stoi(std::string(as_text(publish->payload))), rig_.now + round_trip_ / 2);
      answers_.emplace(rig_.now + round_trip_,
                       Puback{publish->topic_id, publish->msg_id, ReturnCode::accepted});
    }
  }

  SnRig rig_;
  std::mt19937_64 random_;
  double loss_;
  Duration round_trip_;
  unsigned copies_ = 0;
  std::map<int, TimePoint> sent_;
  std::map<int, TimePoint> came_;
  std::multimap<TimePoint, Puback> answers_;
};

TEST(Commands, AllArriveWithinSecondsOverALossyRadio) {
  std::vector<Duration> delays;
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    LossyLink link(seed, 0.2, milliseconds(80));
    for (int i = 0; i < 36; ++i) {
      link.command(i);
      link.pass(seconds(5));
    }
    link.pass(seconds(30));
    for (int i = 0; i < 36; ++i) {
      const auto delay = link.delay(i);
      ASSERT_TRUE(delay) << "seed " << seed << ", command " << i;
      delays.push_back(*delay);
    }
    for (const CommandOutcome& outcome : link.rig().outcomes)
      EXPECT_EQ(outcome.result, CommandResult::delivered);
    EXPECT_EQ(link.rig().outcomes.size(), 36U);
  }
  std::ranges::sort(delays);
  EXPECT_LE(delays[delays.size() * 95 / 100], seconds(3));
  EXPECT_LE(delays.back(), seconds(10));
}

TEST(Commands, AreNotRepeatedToASlowClient) {
  // Nordic's sleepy end device polls once a second, another takes three seconds for each answer.
  for (const Duration round_trip : {milliseconds(1050), milliseconds(3000)}) {
    LossyLink link(1, 0, round_trip);
    for (int i = 0; i < 30; ++i) {
      link.command(i);
      link.pass(seconds(5));
    }
    const unsigned learning = link.copies() - 30;
    EXPECT_LE(learning, 8U);
    for (int i = 30; i < 60; ++i) {
      link.command(i);
      link.pass(seconds(5));
    }
    EXPECT_LE(link.copies() - 60 - learning, 1U) << "after the round trip is learned";
  }
}

TEST(Commands, AreRepeatedRetryCountTimes) {
  Settings settings;
  settings.retry_interval = seconds(1);
  SnRig rig(settings);
  rig.connect(1, "r1", true, 6000);
  rig.subscribe(1, r1_command, 1);
  rig.broker(r1_command, "1", 1);
  rig.pass_s(100);
  EXPECT_EQ(rig.sent_to(1).size(), 4U) << "the first time and retry_count repetitions";
}

TEST(RetransmissionTimeout, FollowsTheRoundTripAndItsVariation) {
  RetransmissionTimeout timeout;
  EXPECT_EQ(timeout.first(seconds(10)), RetransmissionTimeout::initial);
  timeout.on_answer(seconds(2));
  EXPECT_EQ(timeout.first(seconds(10)), seconds(6)) << "R + 4 * R/2";
  timeout.on_answer(seconds(2));
  EXPECT_EQ(timeout.first(seconds(10)), seconds(5)) << "the variation falls by a quarter";
  EXPECT_EQ(timeout.first(seconds(3)), seconds(3));
  for (int i = 0; i < 100; ++i) timeout.on_answer(milliseconds(50));
  EXPECT_EQ(timeout.first(seconds(10)), RetransmissionTimeout::shortest);
}

TEST(RetransmissionTimeout, LearnsNoRoundTripFromAnAmbiguousAnswer) {
  RetransmissionTimeout timeout;
  timeout.on_answer(milliseconds(100));
  timeout.on_ambiguous_answer(seconds(2), milliseconds(100));
  EXPECT_EQ(timeout.first(seconds(10)), seconds(1)) << "the first copy was lost";
  timeout.on_ambiguous_answer(seconds(5), milliseconds(900));
  EXPECT_EQ(timeout.first(seconds(10)), seconds(2)) << "it may take longer now";
}

TEST(RetransmissionTimeout, GrowsAfterTheFirstRepetitions) {
  Duration wait = seconds(2);
  std::vector<Duration> waits;
  for (unsigned repeats = 1; repeats <= 9; ++repeats)
    waits.push_back(wait = RetransmissionTimeout::next(wait, repeats, seconds(10)));
  EXPECT_EQ(waits, (std::vector<Duration>{seconds(2), seconds(2), seconds(2), seconds(2),
                                          seconds(3), milliseconds(4500), milliseconds(6750),
                                          seconds(10), seconds(10)}));
}

}  // namespace
}  // namespace slamgw::mqttsn
