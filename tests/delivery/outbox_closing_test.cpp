// SPDX-License-Identifier: Apache-2.0
// A broker that closes the connection instead of refusing a message. The outbox finds the message
// by sending it alone, makes it a dead letter, and delivers all others.
#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <optional>
#include <set>
#include <string>

#include "daemon/delivery/outbox.hpp"
#include "tests/delivery/delivery_check.hpp"
#include "tests/delivery/outbox_rig.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

class OutboxClosingTest : public testing::Test, public test::OutboxRig {
 protected:
  OutboxClosingTest() { is_store_quick = true; }

  /// Returns true for messages for which the broker closes the connection.
  std::function<bool(const BrokerMessage&)> is_poison = [](const BrokerMessage& message) {
    return message.topic.find("bad") != std::string::npos;
  };
  Duration until_reconnected = 100ms;
  std::size_t closings = 0;
  std::uint64_t number = 0;
  std::map<std::uint64_t, std::string> topic_of;

  void say(const std::string& topic, Qos qos = Qos::at_least_once) {
    topic_of[++number] = topic;
    submit_bytes(topic, to_bytes(std::to_string(number)), qos == Qos::at_most_once ? 0 : number,
                 qos);
  }
  /// Answers messages in order until one closes the connection, then reconnects at once.
  void serve_broker() {
    if (!is_up) link_up();
    while (!under_way.empty()) {
      const BrokerMessage& first = under_way.front().message;
      if (!is_poison(first)) {
        acknowledge_first();
        continue;
      }
      ++closings;
      if (first.qos == Qos::at_most_once) {  // written, and never acknowledged
        const std::uint64_t sequence = under_way.front().sequence;
        under_way.pop_front();
        outbox->on_published(sequence, now);
        drain();
      }
      link_down();
      pass(until_reconnected);
      link_up();
    }
  }
  void run(Duration time, Duration step = 100ms) {
    for (const TimePoint end = now + time; now < end; pass(step)) serve_broker();
  }
  /// Lets the broker accept everything until nothing waits, then checks the promises.
  void expect_promises_kept_in_the_end() {
    is_poison = [](const BrokerMessage&) { return false; };
    run(2h, 1s);
    settle();
    EXPECT_EQ(depth(), 0u);
    EXPECT_TRUE(outbox->refused_topics().empty());
    test::expect_promises_kept(*this, topic_of, closings);
  }
  /// Refuses messages of robots that are not allowed, and then closes the connection.
  void serve_broker_that_closes_after_refusing(const std::set<std::string>& allowed) {
    while (!under_way.empty()) {
      if (allowed.contains(std::string(flow_of(under_way.front().message.topic)))) {
        acknowledge_first();
        continue;
      }
      refuse_first();
      link_down();
      ++closings;
      link_up();
    }
  }
  /// Answers no message on the topics of `mute`. The connection ends 60 s after one was sent.
  void serve_broker_that_does_not_answer(const std::set<std::string>& mute) {
    acknowledge_all_but(mute);
    if (under_way.empty()) unanswered_since.reset();
    if (!under_way.empty() && !unanswered_since) unanswered_since = now;
    if (!unanswered_since || now - *unanswered_since < 60s) return;
    unanswered_since.reset();
    ++closings;
    link_down();
    link_up();
  }
  std::optional<TimePoint> unanswered_since;
  bool all_dead_letters_are_retried() const {
    return std::ranges::all_of(store.dead_letters, [](const auto& known) {
      return is_retried(known.second.why.code, known.second.why.tries);
    });
  }
  std::ptrdiff_t count_notices(std::string_view words) const {
    return std::count_if(notices.begin(), notices.end(), [&](const std::string& notice) {
      return notice.find(words) != std::string::npos;
    });
  }
};

TEST_F(OutboxClosingTest, MakesADeadLetterOfThatMessageOnlyAndDeliversAllOthers) {
  is_poison = [](const BrokerMessage& message) { return number_in(message) == "20"; };
  link_up();
  for (int i = 0; i < 40; ++i) say("r/" + std::to_string(i % 8) + "/t");
  for (int i = 0; i < 100; ++i) {
    run(200ms);
    say("r/" + std::to_string(i % 8) + "/t");
  }
  run(1s);
  EXPECT_EQ(closings, 5u) << "twice among others, three times alone: first on a new connection";
  ASSERT_EQ(store.dead_letters.size(), 1u);
  const auto& letter = store.dead_letters.begin()->second;
  EXPECT_EQ(number_in(letter.message), "20");
  EXPECT_EQ(letter.why.reason, "the connection was lost each time the message was sent alone");
  EXPECT_EQ(letter.why.tries, 2u);
  EXPECT_EQ(count_notices("dead letter now"), 1);
  test::expect_promises_kept(*this, topic_of, closings);
  EXPECT_EQ(depth(), 0u);
  EXPECT_TRUE(outbox->refused_topics().empty());
  EXPECT_EQ(fired.size(), number) << "all are acknowledged, the dead letter once it was on disk";
}

TEST_F(OutboxClosingTest, TriesATopicThatAlwaysFailsAfterGrowingPauses) {
  link_up();
  for (int i = 0; i < 600; ++i) {
    say("r/1/bad");
    say("r/2/good");
    run(1s);
  }
  EXPECT_LE(closings, 15u) << "1 s, 2 s, ... pauses in ten minutes";
  EXPECT_EQ(received_of("r/2/good").size(), 600u);
  const std::size_t in_ten_minutes = closings;
  for (int i = 0; i < 120; ++i) {
    say("r/2/good");
    run(1min, 1s);
  }
  EXPECT_LE(closings - in_ten_minutes, 5u) << "then about one each hour";
  EXPECT_EQ(outbox->refused_topics().count(), 1u);
  EXPECT_EQ(fired.size(), number) << "kept on disk";
  expect_promises_kept_in_the_end();
}

TEST_F(OutboxClosingTest, ResumesTheTopicOnceTheBrokerAcceptsIt) {
  link_up();
  for (int i = 0; i < 60; ++i) {
    say("r/1/bad");
    say("r/2/good");
    run(1s);
  }
  is_poison = [](const BrokerMessage&) { return false; };
  run(5min, 1s);
  EXPECT_TRUE(outbox->refused_topics().empty());
  EXPECT_EQ(received_of("r/1/bad").size() + store.dead_letters.size(), 60u);
  EXPECT_EQ(count_notices("accepts messages on r/1/bad again"), 1);
  test::expect_promises_kept(*this, topic_of, closings);
}

TEST_F(OutboxClosingTest, ManyBadTopicsCostFewConnections) {
  link_up();
  for (int i = 0; i < 600; ++i) {
    say("r/1/bad" + std::to_string(i % 12));
    say("r/2/good");
    run(1s);
  }
  EXPECT_LE(closings, 12u * 3 + 12) << "three to find a topic, then fewer and fewer";
  EXPECT_EQ(received_of("r/2/good").size(), 600u);
  expect_promises_kept_in_the_end();
}

TEST_F(OutboxClosingTest, FindsATopicWhoseMessagesOfQos0CloseTheConnection) {
  link_up();
  for (int i = 0; i < 3000; ++i) {
    say("r/1/bad", Qos::at_most_once);
    say("r/2/good", Qos::at_most_once);
    if (i % 10 == 0) say("r/3/good");
    run(200ms);
  }
  EXPECT_LE(closings, 15u);
  EXPECT_GE(received_of("r/2/good").size(), 2950u);
  EXPECT_EQ(received_of("r/3/good").size(), 300u);
  EXPECT_EQ(count_notices("messages of QoS 0 on r/1/bad are dropped"), 1);
  is_poison = [](const BrokerMessage&) { return false; };
  for (int i = 0; i < 3000; ++i) {
    say("r/1/bad", Qos::at_most_once);
    run(2s);
  }
  EXPECT_GE(received_of("r/1/bad").size(), 1000u) << "the topic is tried again, and resumes";
  EXPECT_TRUE(outbox->refused_topics().empty());
}

/// Steady QoS 0 must not take every trial, nor come first on each connection.
TEST_F(OutboxClosingTest, TriesAStoredMessageAloneDespiteAFloodOfQos0) {
  until_reconnected = 16s;
  is_store_quick = false;  // QoS 0 is there before what is loaded
  link_up();
  say("r/1/bad-kept");
  for (int i = 0; i < 3000 && store.dead_letters.empty(); ++i) {
    for (int flood = 0; flood < 8; ++flood) say("r/1/bad", Qos::at_most_once);
    while (serve_store()) {
    }
    say("r/2/good");
    run(100ms);
  }
  is_store_quick = true;
  EXPECT_EQ(store.dead_letters.size(), 1u);
  EXPECT_LE(closings, 8u) << "two or three to suspect both, three trials, and one of QoS 0 between";
  expect_promises_kept_in_the_end();
}

TEST_F(OutboxClosingTest, BlamesNoMessageWhenTheConnectionBreaksByItself) {
  link_up();
  for (int i = 0; i < 200; ++i) {
    for (int robot = 0; robot < 10; ++robot) {
      say("r/" + std::to_string(robot) + "/t");
      say("r/" + std::to_string(robot) + "/u", Qos::at_most_once);
    }
    link_down(3);
    run(2s);
  }
  EXPECT_TRUE(store.dead_letters.empty());
  EXPECT_EQ(count_notices("refuses messages"), 0);
  test::expect_promises_kept(*this, topic_of, 200);
}

/// A connection that ends soon after its start shows a bad line, not a bad message.
TEST_F(OutboxClosingTest, BlamesNoMessageOnABadLine) {
  for (int i = 0; i < 300; ++i) {
    for (int robot = 0; robot < 8; ++robot) say("r/" + std::to_string(robot) + "/t");
    if (!is_up) link_up();
    for (int answered = 0; answered < 5 && under_way.size() > 1; ++answered) acknowledge_first();
    pass(500ms);
    link_down();
    pass(until_reconnected);
    EXPECT_TRUE(all_dead_letters_are_retried()) << i;
  }
  run(2min);
  settle();
  EXPECT_TRUE(store.dead_letters.empty());
  EXPECT_EQ(depth(), 0u);
  test::expect_promises_kept(*this, topic_of, 300);
}

/// An operator gives the gateway another broker while the broker is slow.
TEST_F(OutboxClosingTest, BlamesNoMessageWhenTheGatewayLeavesABroker) {
  link_up();
  say("r/1/t");
  say("r/2/t");
  for (int i = 0; i < 4; ++i) {
    leave();
    pass(2s);
    link_up();
    EXPECT_EQ(under_way.size(), 2u) << "none is sent alone";
  }
  expect_promises_kept_in_the_end();
  EXPECT_EQ(count_notices("refuses"), 0);
}

TEST_F(OutboxClosingTest, TriesAMessageAloneAgainWhenTheGatewayLeftTheBroker) {
  link_up();
  say("r/1/t");
  for (int losses = 0; losses < 2; ++losses) {
    link_down();
    link_up();
  }
  say("r/2/t");
  for (int i = 0; i < 4; ++i) {
    ASSERT_EQ(under_way.size(), 1u) << "a message that was unanswered at two losses is sent alone";
    EXPECT_EQ(under_way.front().message.topic, "r/1/t");
    pass(2s);
    leave();
    link_up();
  }
  EXPECT_EQ(count_notices("refuses"), 0);
  EXPECT_TRUE(store.dead_letters.empty());
  acknowledge_first();
  EXPECT_EQ(under_way.size(), 1u) << "then the others follow";
  expect_promises_kept_in_the_end();
}

TEST_F(OutboxClosingTest, BlamesNoMessageWhileTheBrokerTakesNone) {
  is_poison = [](const BrokerMessage&) { return true; };
  for (int i = 0; i < 30; ++i) say("r/" + std::to_string(i % 3) + "/t");
  run(1h, 1s);
  EXPECT_TRUE(all_dead_letters_are_retried())
      << "the connection is lost with each message, so no message is the cause";
  is_poison = [](const BrokerMessage&) { return false; };
  run(2h, 1s);
  EXPECT_EQ(depth(), 0u);
  EXPECT_TRUE(store.dead_letters.empty());
  test::expect_promises_kept(*this, topic_of, closings);
}

TEST_F(OutboxClosingTest, FindsTheMessageAgainAfterARestartAndLosesNothing) {
  is_poison = [](const BrokerMessage& message) { return number_in(message) == "5"; };
  for (int i = 0; i < 20; ++i) say("r/" + std::to_string(i % 4) + "/t");
  for (int i = 0; i < 4; ++i) {
    run(200ms);  // too short to find the message
    die();
    start();
  }
  for (int i = 0; i < 100; ++i) {
    say("r/1/t");
    run(200ms);
  }
  ASSERT_EQ(store.dead_letters.size(), 1u);
  EXPECT_EQ(number_in(store.dead_letters.begin()->second.message), "5");
  die();
  start();
  const std::size_t before = closings;
  for (int i = 0; i < 20; ++i) {
    say("r/1/t");
    run(1s);
  }
  EXPECT_EQ(closings, before) << "a dead letter stays one";
  test::expect_promises_kept(*this, topic_of, closings + 5);
}

TEST_F(OutboxClosingTest, BlamesNoMessageAtABrokerThatClosesAfterRefusingAndRetriesSeldom) {
  link_up();
  for (int i = 0; i < 600; ++i) {
    for (int topic = 0; topic < 10; ++topic) say("denied/" + std::to_string(topic));
    say("r/2/good");
    say("r/3/good", Qos::at_most_once);
    for (int step = 0; step < 10; ++step, pass(100ms))
      serve_broker_that_closes_after_refusing({"r/2", "r/3"});
  }
  EXPECT_EQ(received_of("r/2/good").size(), 600u);
  EXPECT_TRUE(all_dead_letters_are_retried());
  EXPECT_EQ(count_notices("connection is lost"), 0);
  EXPECT_LE(closings, 40u) << "of 10 topics in ten minutes";
  settle();
  test::expect_promises_kept(*this, topic_of, closings);
}

/// A robot filled a hundred topics that the access list forbids while the broker was away.
TEST_F(OutboxClosingTest, OneRobotsForbiddenTopicsCostTheOthersFewConnections) {
  link_up();
  say("r/evil/adv");
  acknowledge_first();
  link_down();
  for (int topic = 0; topic < 120; ++topic) say("r/evil/t" + std::to_string(topic));
  say("r/evil/adv");
  for (int i = 0; i < 10; ++i) say("r/good/adv");
  std::optional<TimePoint> all_of_good;
  const TimePoint begin = now;
  link_up();
  const auto serve = [&](Duration time, bool is_list_corrected) {
    for (const TimePoint end = now + time; now < end; pass(100ms)) {
      while (!under_way.empty()) {
        const std::string topic = under_way.front().message.topic;
        if (is_list_corrected || !topic.starts_with("r/evil/t")) {
          acknowledge_first();
          continue;
        }
        refuse_first();
        link_down();
        ++closings;
        link_up();
      }
      if (!all_of_good && received_of("r/good/adv").size() == 10) all_of_good = now;
    }
  };
  serve(10min, false);
  ASSERT_TRUE(all_of_good);
  EXPECT_LE(*all_of_good - begin, 1s) << "others do not wait for it";
  EXPECT_EQ(received_of("r/evil/adv").size(), 2u)
      << "the topic that the broker accepted before resumes";
  EXPECT_LE(closings, 20u);
  serve(30min, true);
  EXPECT_EQ(depth(), 0u) << "the list was corrected";
  EXPECT_TRUE(store.dead_letters.empty());
  test::expect_promises_kept(*this, topic_of, closings);
}

TEST_F(OutboxClosingTest, ARobotWithCorrectedRightsSendsNewTopicsThoughAnotherIsStillRefused) {
  link_up();
  say("r/a/t");
  say("r/b/t");
  serve_broker_that_closes_after_refusing({});
  say("r/a/u");
  EXPECT_TRUE(under_way.empty()) << "counted as refused without a try";
  for (int i = 0; i < 300; ++i, pass(1s)) serve_broker_that_closes_after_refusing({"r/a"});
  ASSERT_EQ(received_of("r/a/u").size(), 1u);
  ASSERT_EQ(outbox->refused_topics().count(), 1u) << "the other robot's topic";
  say("r/a/new");
  EXPECT_EQ(published_topics.back(), "r/a/new");
  say("r/b/new");
  EXPECT_EQ(published_topics.back(), "r/a/new") << "the other robot's rights are as before";
}

TEST_F(OutboxClosingTest, ARobotWhoseRefusalIsForgottenSendsNewTopics) {
  link_up();
  say("r/a/t");
  say("r/b/t");
  serve_broker_that_closes_after_refusing({});
  outbox->on_store_event(store.discard_all(), now);
  drain();
  for (int minutes = 0; minutes < 130; ++minutes, pass(1min)) {
    say("r/b/t");
    serve_broker_that_closes_after_refusing({});
  }
  ASSERT_EQ(outbox->refused_topics().count(), 1u) << "the other robot's topic";
  say("r/a/new");
  EXPECT_EQ(published_topics.back(), "r/a/new");
}

TEST_F(OutboxClosingTest, UnansweredTrialDelaysOtherMessagesOnlyForTrialPatience) {
  is_poison = [](const BrokerMessage& message) { return number_in(message) == "1"; };
  link_up();
  say("t");
  for (int i = 0; i < 2; ++i) {
    link_down();
    link_up();
  }
  pass(1s);
  ASSERT_EQ(under_way.size(), 1u) << "alone";
  say("other");
  EXPECT_EQ(under_way.size(), 1u);
  pass(Outbox::trial_patience);
  EXPECT_EQ(under_way.size(), 2u);
}

TEST_F(OutboxClosingTest, AbandonsATrialThatWaitsBehindAnUnansweredMessage) {
  link_up();
  say("t");
  for (int i = 0; i < 2; ++i) {
    link_down();
    link_up();
  }
  say("silent");
  ASSERT_EQ(under_way.size(), 1u);  // never answered
  pass(1s);
  say("other");
  EXPECT_EQ(under_way.size(), 1u);
  pass(Outbox::trial_patience);
  EXPECT_EQ(under_way.size(), 3u) << "all are published";
}

TEST_F(OutboxClosingTest, UnansweredTopicStopsNoOtherRobot) {
  link_up();
  for (std::uint64_t i = 1; i <= 600; ++i) {
    for (int flood = 0; flood < 10; ++flood) say("r/evil/mute");
    say("r/good/t");
    for (int step = 0; step < 10; ++step, pass(100ms))
      serve_broker_that_does_not_answer({"r/evil/mute"});
    ASSERT_GE(received_of("r/good/t").size() + 6, i) << "one trial at a time";
  }
  EXPECT_LE(closings, 8u) << "after growing pauses";
  EXPECT_EQ(fired.size(), number) << "kept on disk";
  EXPECT_EQ(count_notices("refuses messages on r/evil/mute: the broker does not answer messages"),
            1);
  EXPECT_GE(count_notices("dead letter now: the broker did not answer"), 1);
  ASSERT_EQ(outbox->refused_topics().count(), 1u);
  expect_promises_kept_in_the_end();
}

TEST_F(OutboxClosingTest, FindsUnansweredTopicsOfSeveralRobotsWithOneConnection) {
  const std::set<std::string> mute{"r/a/mute", "r/b/mute", "r/b/mute2"};
  link_up();
  for (int i = 0; i < 20; ++i) {
    for (const std::string& topic : mute) say(topic);
    if (i == 0) say("r/good/t");
  }
  for (int i = 0; i < 700; ++i, pass(100ms)) serve_broker_that_does_not_answer(mute);
  say("r/good/t");
  for (int i = 0; i < 60; ++i, pass(100ms)) serve_broker_that_does_not_answer(mute);
  EXPECT_EQ(received_of("r/good/t").size(), 2u);
  EXPECT_EQ(closings, 1u);
  EXPECT_EQ(outbox->refused_topics().count(), 3u);
  expect_promises_kept_in_the_end();
}

TEST_F(OutboxClosingTest, FindsAnUnansweredTopicInAWindowOfOne) {
  link_up();
  const auto run_mute = [&](int steps) {
    for (int i = 0; i < steps; ++i, pass(100ms)) {
      serve_broker_that_does_not_answer({"r/evil/mute"});
    }
  };
  link_down();
  link_up(2);
  say("r/evil/mute");
  say("r/evil/mute");
  say("r/good/t");
  run_mute(700);
  EXPECT_EQ(received_of("r/good/t").size(), 1u);
  EXPECT_EQ(closings, 1u) << "nothing else was under way";
  expect_promises_kept_in_the_end();
}

/// The broker has refused the topic before, so its tries are not made alone.
TEST_F(OutboxClosingTest, ARefusedTopicThatIsNoLongerAnsweredCostsFewConnections) {
  link_up();
  say("r/1/mute");
  refuse_first();
  for (int i = 0; i < 1200; ++i, pass(500ms)) {
    say("r/2/good");
    serve_broker_that_does_not_answer({"r/1/mute"});
  }
  EXPECT_EQ(closings, 2u) << "once among others, once alone";
  EXPECT_EQ(received_of("r/2/good").size(), 1200u);
  EXPECT_EQ(count_notices("dead letter now: the broker did not answer"), 1);
  expect_promises_kept_in_the_end();
}

TEST_F(OutboxClosingTest, CountsNoLossFromBeforeTheBrokerAcceptedTheTopic) {
  link_up();
  for (int i = 0; i < 400; ++i) say("r/1/bad");
  const auto tries = [this] {
    const auto refused = outbox->refused_topics().list(1);
    return refused.empty() ? 0 : refused.front().tries;
  };
  for (int i = 0; i < 100 && tries() < 2; ++i) run(100ms);
  ASSERT_EQ(tries(), 2u) << "the second loss is the first that counts";
  is_poison = [](const BrokerMessage& message) { return number_in(message) == "2"; };
  const std::size_t before = closings;
  for (int i = 0; i < 600; ++i) {
    run(100ms);
    say("r/2/good");
  }
  ASSERT_EQ(store.dead_letters.size(), 1u);
  EXPECT_EQ(closings - before, 4u) << "once among others, three times alone: first on a new "
                                      "connection";
  test::expect_promises_kept(*this, topic_of, closings);
}

TEST_F(OutboxClosingTest, RedeliversAMessageWhoseAcknowledgementWasLost) {
  link_up();
  say("r/1/t");
  say("r/2/t");
  for (int i = 0; i < 605; ++i, pass(100ms)) serve_broker_that_does_not_answer({"r/1/t"});
  EXPECT_EQ(closings, 1u);
  run(10s);
  EXPECT_EQ(received_of("r/1/t").size(), 1u);
  EXPECT_EQ(depth(), 0u);
  EXPECT_TRUE(store.dead_letters.empty());
}

/// The broker is slow, but skips no message.
TEST_F(OutboxClosingTest, BlamesNoMessageWhenTheBrokerIsSilentForAMinute) {
  link_up();
  for (int i = 0; i < 20; ++i) say("r/" + std::to_string(i % 4) + "/t");
  pass(60s);
  link_down();
  EXPECT_TRUE(outbox->refused_topics().empty());
  settle();
  EXPECT_EQ(count_notices("refuses messages"), 0);
  test::expect_promises_kept(*this, topic_of, 1);
}

TEST_F(OutboxClosingTest, DoesNotBlameTheOnlyMessageUnderWayAtABrokerThatHangs) {
  for (const bool is_silent : {true, false}) {
    link_up();
    say(is_silent ? "r/1/t" : "r/2/t");
    outbox->on_silence(is_silent, now);
    pass(is_silent ? 90s : 50s);  // the hang is not noticed at first
    link_down();
    EXPECT_TRUE(outbox->refused_topics().empty()) << is_silent;
    link_up();
    acknowledge_all();
  }
  EXPECT_EQ(count_notices("does not answer"), 0);
}

/// This host refuses the message because it is too large.
TEST_F(OutboxClosingTest, DoesNotCountALocalRefusalAsAnAnswerOfTheBroker) {
  link_up();
  for (int i = 0; i < 4; ++i) say("r/" + std::to_string(i) + "/t");
  say("r/large/t");
  std::rotate(under_way.begin(), std::prev(under_way.end()), under_way.end());
  refuse_first(0x95);
  pass(60s);
  link_down();
  EXPECT_EQ(count_notices("does not answer"), 0);
  link_up();
  acknowledge_all();
  EXPECT_EQ(received_of("r/0/t").size(), 1u) << "published again at once";
}

/// A message of QoS 2 takes two round trips, so later ones of QoS 1 pass it.
TEST_F(OutboxClosingTest, DoesNotBlameAMessageOfQos2ThatLaterOnesOvertake) {
  link_up();
  say("r/exact/t", Qos::exactly_once);
  say("r/1/t");
  pass(35s);
  acknowledge_quickest();
  link_down();
  EXPECT_EQ(count_notices("does not answer"), 0);
  link_up();
  acknowledge_all();
  EXPECT_EQ(received_of("r/exact/t").size(), 1u) << "published again at once";
}

TEST_F(OutboxClosingTest, WithoutAStoreTheMessageIsNotAcknowledged) {
  outbox->on_store_event(StoreAbsent{}, now);
  link_up();
  say("r/1/bad");
  for (int i = 0; i < 20; ++i) {
    say("r/2/good");
    run(1s);
  }
  EXPECT_TRUE(has_fired(1, ReceiptOutcome::refused));
  EXPECT_EQ(received_of("r/2/good").size(), 20u);
  EXPECT_LE(closings, 4u);
}

}  // namespace
}  // namespace slamgw
