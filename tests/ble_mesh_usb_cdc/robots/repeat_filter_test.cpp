// SPDX-License-Identifier: Apache-2.0
// Distinguishes new SETs from repeats. Each acknowledged message is delivered on a lossy radio, for
// robots that use reliable publish with any period of their own.
#include "adapters/ble_mesh_usb_cdc/robots/repeat_filter.hpp"

#include <gtest/gtest.h>

#include <functional>
#include <optional>
#include <random>

#include "adapters/ble_mesh_usb_cdc/access/robot_models.hpp"
#include "tests/ble_mesh_usb_cdc/hex.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;
using std::chrono::milliseconds;

const Duration set_interval = reliable_interval(4, 7);  // 280 ms

/// Returns how many of a robot's equal copies at these times, each answered at once, are new.
int count_delivered(std::initializer_list<milliseconds> times,
                    RepeatFilter::Doubt doubt = RepeatFilter::Doubt::take_for_repeat) {
  RepeatFilter filter;
  int delivered = 0;
  for (const auto time : times) {
    if (filter.on_set(hex("0a 00"), set_interval, doubt, TimePoint{} + time) ==
        RepeatFilter::Verdict::fresh)
      delivered += 1 + filter.missed();
    filter.on_answered(TimePoint{} + time);
  }
  return delivered;
}

TEST(SetRepeats, RecognizesWholeScheduleOfRepeats) {
  EXPECT_EQ(count_delivered({0ms, 280ms, 560ms, 1120ms, 2240ms, 4480ms, 8960ms}), 1);
  EXPECT_EQ(count_delivered({280ms, 560ms, 1120ms, 2240ms}), 1) << "the first copy was lost";
  EXPECT_EQ(count_delivered({0ms, 295ms, 555ms, 1140ms}), 1) << "with jitter";
  EXPECT_EQ(count_delivered({0ms, 560ms, 1120ms, 2240ms}), 1) << "the second was lost";
  EXPECT_EQ(count_delivered({280ms, 1120ms, 2240ms}), 1) << "the first and the third were lost";
  EXPECT_EQ(count_delivered({0ms, 1120ms, 8960ms}), 1) << "two were lost in a row, twice";
}

TEST(SetRepeats, AcceptsEqualMessagesAtRobotsOwnPeriod) {
  for (const auto doubt :
       {RepeatFilter::Doubt::take_for_repeat, RepeatFilter::Doubt::take_for_new}) {
    EXPECT_EQ(count_delivered({0ms, 200ms, 400ms, 600ms, 800ms}, doubt), 5);
    EXPECT_EQ(count_delivered({0ms, 1000ms, 2000ms, 3000ms}, doubt), 4);
    EXPECT_EQ(count_delivered({0ms, 250ms, 500ms, 750ms}, doubt), 4);
    EXPECT_EQ(count_delivered({0ms, 500ms, 1000ms, 1500ms}, doubt), 4);
    EXPECT_EQ(count_delivered({0ms, 2000ms, 4000ms}, doubt), 3);
  }
  EXPECT_EQ(count_delivered({0ms, 280ms, 400ms, 600ms}), 3) << "one STATUS lost, then new ones";
}

TEST(SetRepeats, TreatsDoubtfulUpdateAsNew) {
  const auto doubt = RepeatFilter::Doubt::take_for_new;
  EXPECT_EQ(count_delivered({0ms, 280ms, 560ms, 840ms, 1120ms}, doubt), 5);
  EXPECT_EQ(count_delivered({0ms, 559ms, 1118ms, 1677ms}, doubt), 4);
}

TEST(SetRepeats, RecognizesRobotsPeriodAfterThreeEqualGaps) {
  EXPECT_EQ(count_delivered({0ms, 280ms, 560ms, 840ms}), 4)
      << "two suppressed ones are published later";
  EXPECT_EQ(count_delivered({0ms, 280ms, 560ms, 840ms, 1120ms, 1400ms}), 6);
  EXPECT_EQ(count_delivered({0ms, 559ms, 1118ms, 1677ms, 2236ms}), 5);
}

TEST(SetRepeats, TreatsEveryEqualSetAsRepeatUntilItIsAnswered) {
  RepeatFilter filter;
  const auto set = [&](std::string_view payload, milliseconds at) {
    return filter.on_set(hex(payload), set_interval, RepeatFilter::Doubt::take_for_new,
                         TimePoint{} + at);
  };
  EXPECT_EQ(set("01", 0ms), RepeatFilter::Verdict::fresh);
  EXPECT_EQ(set("01", 200ms), RepeatFilter::Verdict::repeat_open);
  EXPECT_EQ(set("02", 280ms), RepeatFilter::Verdict::fresh);
}

TEST(SetRepeats, ARepeatThatCrossedItsStatusIsNotAnswered) {
  for (const auto doubt :
       {RepeatFilter::Doubt::take_for_repeat, RepeatFilter::Doubt::take_for_new}) {
    RepeatFilter filter;
    const auto set = [&](milliseconds at) {
      return filter.on_set(hex("01"), set_interval, doubt, TimePoint{} + at);
    };
    EXPECT_EQ(set(0ms), RepeatFilter::Verdict::fresh);
    filter.on_answered(TimePoint{} + 260ms);
    EXPECT_EQ(set(280ms), RepeatFilter::Verdict::repeat_open);
    EXPECT_EQ(set(560ms), doubt == RepeatFilter::Doubt::take_for_new
                              ? RepeatFilter::Verdict::fresh
                              : RepeatFilter::Verdict::repeat_answered);
  }
}

/// A busy host delivers a repeat late, just after the STATUS was sent.
TEST(SetRepeats, ALateRepeatThatCrossedItsStatusIsNeitherNewNorAnswered) {
  for (const auto doubt :
       {RepeatFilter::Doubt::take_for_repeat, RepeatFilter::Doubt::take_for_new}) {
    RepeatFilter filter;
    const auto set = [&](milliseconds at) {
      return filter.on_set(hex("01"), set_interval, doubt, TimePoint{} + at);
    };
    EXPECT_EQ(set(0ms), RepeatFilter::Verdict::fresh);
    filter.on_answered(TimePoint{} + 330ms);
    EXPECT_EQ(set(420ms), RepeatFilter::Verdict::repeat_open) << "140 ms late";
    EXPECT_EQ(set(700ms), RepeatFilter::Verdict::fresh)
        << "the second was new, and this is its first repeat";
  }
}

TEST(SetRepeats, TheFirstMessageMayBeEmpty) {
  RepeatFilter filter;
  EXPECT_EQ(filter.on_set({}, set_interval, RepeatFilter::Doubt::take_for_repeat, TimePoint{}),
            RepeatFilter::Verdict::fresh);
}

TEST(SetRepeats, TransactionNumberDistinguishesRepeatsFromNewMessages) {
  RepeatFilter filter;
  const auto set = [&](std::uint8_t number, milliseconds at, std::string_view payload = "0a 00") {
    const auto verdict = filter.on_numbered_set(number, hex(payload), TimePoint{} + at);
    filter.on_answered(TimePoint{} + at);
    return verdict;
  };
  EXPECT_EQ(set(7, 0ms), RepeatFilter::Verdict::fresh);
  EXPECT_EQ(set(8, 280ms), RepeatFilter::Verdict::fresh) << "equal, and due as a copy of the last";
  EXPECT_EQ(set(8, 400ms), RepeatFilter::Verdict::repeat_answered) << "due as a new one";
  EXPECT_EQ(set(8, 430ms), RepeatFilter::Verdict::repeat_open) << "it crossed the STATUS";
  EXPECT_EQ(set(8, 20s, "0b 00"), RepeatFilter::Verdict::fresh) << "the robot was restarted";
  EXPECT_EQ(set(8, 81s, "0b 00"), RepeatFilter::Verdict::fresh) << "reliable publish has ended";
}

/// Nordic's reliable publish on a robot with a message each period: it sends copies at 0, iv, 2iv,
/// 4iv ... until a STATUS arrives, and skips messages that are due in that time.
class RobotWalk {
 public:
  struct Radio {
    Duration jitter{};  ///< maximum delay of each message to the gateway
    std::function<bool()> loses_set = [] { return false; };
    std::function<bool()> loses_status = [] { return false; };
  };

  RobotWalk(Duration period, Radio radio, std::uint64_t seed = 1)
      : period_(period), radio_(std::move(radio)), random_(seed) {}

  void set_period(Duration period) { period_ = period; }
  /// Sends `count` messages; each differs from the last when the robot moves.
  void say(int count, bool is_moving) {
    while (count > 0) {
      next_ += period_;
      if (next_ < busy_until_) continue;
      --count;
      if (is_moving) ++content_;
      exchange(next_);
    }
  }

  int acknowledged = 0;
  int delivered = 0;
  int unheard = 0;  ///< copies at which the filter believed that the robot hears nothing
  int heard = 0;    ///< copies at which it knew that the robot had heard a STATUS

 private:
  static constexpr Duration receipt_time = 5ms;  // broker
  static constexpr Duration status_time = 10ms;  // on the air

  /// Sends copies until the robot has its STATUS. The next message is due after that.
  void exchange(TimePoint first) {
    for (Duration offset{}; offset < RepeatFilter::longest_exchange;
         offset = offset == Duration{} ? set_interval : 2 * offset) {
      const TimePoint sent = first + offset;
      if (acknowledged_at_ && *acknowledged_at_ <= sent) break;
      if (!radio_.loses_set()) arrive(sent + jitter());
    }
    if (acknowledged_at_) ++acknowledged;
    busy_until_ = acknowledged_at_.value_or(first + RepeatFilter::longest_exchange);
    acknowledged_at_.reset();
  }

  Duration jitter() {
    if (radio_.jitter == Duration{}) return {};
    return Duration(
        std::uniform_int_distribution<Duration::rep>(0, radio_.jitter.count())(random_));
  }

  void arrive(TimePoint now) {
    const Bytes payload = ByteWriter{}.write_u16_le(content_).take();
    const auto verdict =
        filter_.on_set(payload, set_interval, RepeatFilter::Doubt::take_for_new, now);
    unheard += filter_.is_unheard() ? 1 : 0;
    heard += filter_.was_heard() ? 1 : 0;
    if (verdict == RepeatFilter::Verdict::repeat_open) return;
    if (verdict == RepeatFilter::Verdict::fresh) delivered += 1 + filter_.missed();
    filter_.on_answered(now + receipt_time);
    if (!radio_.loses_status() && !acknowledged_at_)
      acknowledged_at_ = now + receipt_time + status_time;
  }

  Duration period_;
  Radio radio_;
  std::mt19937_64 random_;
  RepeatFilter filter_;
  TimePoint next_{};
  TimePoint busy_until_{};
  std::uint16_t content_ = 0;
  std::optional<TimePoint> acknowledged_at_;
};

/// Loses only the message with this number.
std::function<bool()> lose_number(int number) {
  return [left = number]() mutable { return left-- == 0; };
}

constexpr int still_count = 60;

/// Runs periods from 200 ms to 2 s, and those equal or close to gaps of the schedule.
void with_each_period(milliseconds step, const std::function<void(milliseconds)>& test) {
  for (milliseconds period = 200ms; period <= 2000ms; period += step) test(period);
  for (const auto period :
       {279ms, 280ms, 281ms, 559ms, 560ms, 561ms, 840ms, 1120ms, 1680ms, 1960ms})
    test(period);
}

TEST(AnyPeriod, AStandingRobotLosesNothing) {
  with_each_period(7ms, [](milliseconds period) {
    SCOPED_TRACE(period.count());
    RobotWalk walk(period, {});
    walk.say(still_count, false);
    EXPECT_EQ(walk.acknowledged, still_count);
    EXPECT_EQ(walk.delivered, still_count);
  });
}

TEST(AnyPeriod, ARobotThatStopsLosesNothing) {
  with_each_period(7ms, [](milliseconds period) {
    SCOPED_TRACE(period.count());
    RobotWalk walk(period, {});
    walk.say(20, true);
    walk.say(still_count, false);
    EXPECT_EQ(walk.acknowledged, 20 + still_count);
    EXPECT_EQ(walk.delivered, walk.acknowledged);
  });
}

TEST(AnyPeriod, OneLostCopyLosesNothing) {
  with_each_period(53ms, [](milliseconds period) {
    SCOPED_TRACE(period.count());
    for (int lost = 20; lost < 26; ++lost) {
      for (const int moving : {0, 20}) {
        RobotWalk walk(period, {.loses_set = lose_number(lost)});
        walk.say(moving, true);
        walk.say(still_count, false);
        EXPECT_EQ(walk.acknowledged, moving + still_count);
        EXPECT_EQ(walk.delivered, walk.acknowledged) << lost << " after moving " << moving;
      }
    }
  });
}

TEST(AnyPeriod, OneLostStatusLosesNothingAndDoublesAtMostOne) {
  with_each_period(53ms, [](milliseconds period) {
    SCOPED_TRACE(period.count());
    for (int lost = 20; lost < 26; ++lost) {
      for (const int moving : {0, 20}) {
        RobotWalk walk(period, {.loses_status = lose_number(lost)});
        walk.say(moving, true);
        walk.say(still_count, false);
        EXPECT_EQ(walk.acknowledged, moving + still_count);
        EXPECT_GE(walk.delivered, walk.acknowledged) << lost << " after moving " << moving;
        EXPECT_LE(walk.delivered, walk.acknowledged + 1) << lost << " after moving " << moving;
      }
    }
  });
}

TEST(AnyPeriod, JitterLosesNothing) {
  with_each_period(53ms, [](milliseconds period) {
    SCOPED_TRACE(period.count());
    for (const Duration jitter : {5ms, 10ms, 20ms, 40ms, 100ms}) {
      for (std::uint64_t seed = 1; seed <= 4; ++seed) {
        RobotWalk walk(period, {.jitter = std::min<Duration>(jitter, period / 2)}, seed);
        walk.say(20, true);
        walk.say(still_count, false);
        EXPECT_GE(walk.delivered, walk.acknowledged) << jitter / 1ms << " ms, seed " << seed;
      }
    }
  });
}

TEST(AnyPeriod, ALossyRadioWithJitterLosesNothing) {
  with_each_period(53ms, [](milliseconds period) {
    SCOPED_TRACE(period.count());
    for (const Duration jitter : {0ms, 5ms, 10ms, 20ms}) {
      std::mt19937_64 random(3);
      const auto lose = [&] { return random() % 5 == 0; };
      RobotWalk walk(period, {jitter, lose, lose});
      for (int i = 0; i < 5; ++i) {
        walk.say(30, true);
        walk.say(30, false);
      }
      EXPECT_GE(walk.delivered, walk.acknowledged) << jitter / 1ms << " ms";
    }
  });
}

TEST(AnyPeriod, AnotherPeriodWhileItStandsLosesNothing) {
  with_each_period(7ms, [](milliseconds period) {
    SCOPED_TRACE(period.count());
    RobotWalk walk(200ms, {});
    walk.say(20, true);
    walk.set_period(period);
    walk.say(still_count, false);
    EXPECT_GE(walk.delivered, walk.acknowledged);
  });
}

TEST(AnyPeriod, ARobotThatHearsIsNeverTakenForDeaf) {
  with_each_period(7ms, [](milliseconds period) {
    SCOPED_TRACE(period.count());
    RobotWalk walk(period, {});
    walk.say(20, true);
    EXPECT_EQ(walk.heard, 19) << "each message but the last has a successor";
    walk.say(still_count, false);
    EXPECT_EQ(walk.unheard, 0);
  });
}

TEST(AnyPeriod, ARobotThatHearsNothingIsNoticedAtItsSixthCopy) {
  with_each_period(53ms, [](milliseconds period) {
    SCOPED_TRACE(period.count());
    for (const bool is_moving : {false, true}) {
      RobotWalk walk(period, {.loses_status = [] { return true; }});
      walk.say(1, is_moving);
      EXPECT_EQ(walk.unheard, 4) << "of nine copies";
      walk.say(3, is_moving);
      EXPECT_EQ(walk.unheard, 16);
      EXPECT_EQ(walk.heard, 0) << "a message that it gave up does not count";
    }
  });
}

TEST(SetRepeats, ALossyRadioSeldomMakesARobotLookDeaf) {
  std::mt19937_64 random(1);
  const auto lose = [&] { return random() % 10 < 3; };
  RobotWalk walk(200ms, {3ms, lose, lose});
  walk.say(10000, true);
  EXPECT_LE(walk.unheard, 150) << "of 10000 messages";
  EXPECT_GE(walk.heard, 6500) << "messages that needed no repeat";
}

/// The firmware replaces an update by the next one, so each has time for a single repeat.
TEST(SetRepeats, MessagesThatAreAllRepeatedShowDeafRobot) {
  RepeatFilter filter;
  const auto set = [&](int content, milliseconds at) {
    const Bytes payload{static_cast<std::uint8_t>(content)};
    filter.on_set(payload, set_interval, RepeatFilter::Doubt::take_for_new, TimePoint{} + at);
    filter.on_answered(TimePoint{} + at + 10ms);
  };
  for (int message = 0; message < 5; ++message) {
    EXPECT_FALSE(filter.is_unheard()) << message;
    set(message, message * 1000ms);
    EXPECT_FALSE(filter.was_heard()) << message;
    set(message, message * 1000ms + 280ms);
  }
  EXPECT_TRUE(filter.is_unheard());
  set(100, 5000ms);
  set(101, 6000ms);
  EXPECT_TRUE(filter.was_heard());
  EXPECT_FALSE(filter.is_unheard());
}

TEST(SetRepeats, UnansweredMessageShowsNoDeafRobot) {
  RepeatFilter filter;
  const auto set = [&](milliseconds at) {
    filter.on_set(hex("01"), set_interval, RepeatFilter::Doubt::take_for_new, TimePoint{} + at);
  };
  for (const auto at : {0ms, 280ms, 560ms, 1120ms, 2240ms, 4480ms}) set(at);
  filter.on_answered(TimePoint{} + 5000ms);
  set(8960ms);
  EXPECT_FALSE(filter.is_unheard()) << "one STATUS left so far";
}

TEST(SetRepeats, NumberedRepeatsOfAnsweredMessageShowDeafRobot) {
  RepeatFilter filter;
  const auto set = [&](std::uint8_t number, milliseconds at) {
    filter.on_numbered_set(number, hex("0a"), TimePoint{} + at);
    filter.on_answered(TimePoint{} + at);
  };
  for (const auto at : {0ms, 300ms, 600ms, 1200ms, 2400ms}) set(7, at);
  EXPECT_FALSE(filter.is_unheard());
  set(7, 4800ms);
  EXPECT_TRUE(filter.is_unheard());
  set(8, 9600ms);
  EXPECT_FALSE(filter.was_heard()) << "the robot gave up the last message";
  set(9, 9900ms);
  EXPECT_TRUE(filter.was_heard());
}

TEST(SetRepeats, LostStatusSeldomDoublesMessagesOfMovingRobot) {
  std::mt19937_64 random(1);
  RobotWalk walk(200ms, {.jitter = 3ms, .loses_status = [&] { return random() % 10 == 0; }});
  walk.say(10000, true);
  EXPECT_EQ(walk.acknowledged, 10000);
  EXPECT_GE(walk.delivered, 10000);
  EXPECT_LE(walk.delivered, 10050)
      << "of 1000 that were repeated; the period is not known at first";
}

}  // namespace
}  // namespace slamgw::ble
