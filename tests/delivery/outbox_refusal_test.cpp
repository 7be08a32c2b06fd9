// SPDX-License-Identifier: Apache-2.0
// A broker that answers a PUBLISH with a reason code of 0x80 or above: the message becomes a dead
// letter. Its topic is tried again after growing pauses, other topics do not wait, and no
// acknowledged message is lost.
#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <vector>

#include "daemon/delivery/outbox.hpp"
#include "tests/delivery/outbox_rig.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

constexpr int not_authorised = 0x87;
constexpr int quota_exceeded = 0x97;

class OutboxRefusalTest : public testing::Test, public test::OutboxRig {
 protected:
  /// Sorted, because a message may overtake a refused one.
  static std::vector<std::string> numbers(std::uint64_t first, std::uint64_t count) {
    std::vector<std::string> out;
    for (std::uint64_t i = 0; i < count; ++i) out.push_back(std::to_string(first + i));
    std::ranges::sort(out);
    return out;
  }
  std::vector<std::string> all_of(const std::string& topic) const {
    std::vector<std::string> all = received_of(topic);
    std::ranges::sort(all);
    return all;
  }
  std::ptrdiff_t count_notices(std::string_view words) const {
    return std::count_if(notices.begin(), notices.end(), [&](const std::string& notice) {
      return notice.find(words) != std::string::npos;
    });
  }
  /// Turns `count` messages into dead letters, one after the other, while there is room.
  void be_refused(std::uint64_t count, const std::string& topic = "t", std::uint64_t first = 1,
                  int code = not_authorised) {
    is_store_quick = true;
    if (!is_up) link_up();
    for (std::uint64_t i = 0; i < count; ++i) {
      submit(topic, first + i);
      refuse_all(code);
    }
  }
  void serve_all() {
    while (serve_store()) {
    }
  }
  /// Refuses messages on these topics and acknowledges all others.
  void answer_all(const std::vector<std::string>& refused, int code) {
    while (!under_way.empty()) {
      const std::string& topic = under_way.front().message.topic;
      const bool is_refused = std::find(refused.begin(), refused.end(), topic) != refused.end();
      is_refused ? refuse_first(code) : acknowledge_first();
      serve_all();
    }
  }
};

TEST_F(OutboxRefusalTest, StoresRefusedMessagesAndDeliversThemOnceTheBrokerAcceptsThem) {
  is_store_quick = true;
  link_up();
  for (std::uint64_t i = 1; i <= 100; ++i) {
    submit("t", i);
    answer_all({"t"}, not_authorised);
  }
  EXPECT_EQ(fired.size(), 100u) << "safely on disk, so the robot may forget them";
  EXPECT_EQ(store.dead_letters.size(), 100u);
  EXPECT_EQ(outbox->refused_topics().count(), 1u);
  EXPECT_EQ(outbox->refused_topics().list(1)[0].waiting, 100u);
  for (int i = 0; i < 20; ++i) {
    pass(1s);
    answer_all({"t"}, not_authorised);
  }
  EXPECT_TRUE(received_of("t").empty());
  EXPECT_LE(published_topics.size(), 1u + 5u) << "tried with a growing pause";
  settle();
  EXPECT_EQ(all_of("t"), numbers(1, 100));
  EXPECT_TRUE(store.rows.empty());
  EXPECT_TRUE(store.dead_letters.empty());
  EXPECT_TRUE(outbox->refused_topics().empty());
  EXPECT_EQ(outbox->statistics().dropped, 0u);
}

/// docs/topics.md, promise 3.
TEST_F(OutboxRefusalTest, LaterMessagesOfARefusedTopicMayOvertake) {
  is_store_quick = true;
  link_up();
  submit("t", 1);
  submit("t", 2);
  refuse_first();
  acknowledge_first();
  settle();
  EXPECT_EQ(received_of("t"), (std::vector<std::string>{"2", "1"}));
}

TEST_F(OutboxRefusalTest, DeliversMessagesAfterARefusalOfARobotsWholeWindowShare) {
  link_up();
  for (std::uint64_t i = 1; i <= 40; ++i) submit("t", i);
  ASSERT_EQ(under_way.size(), window / 2);
  std::swap(under_way[3], under_way[7]);  // answers may come in another order
  refuse_first();
  submit("t", 41);
  refuse_all();
  submit("t", 42);
  serve_all();
  settle();
  EXPECT_EQ(fired.size(), 42u);
  EXPECT_EQ(all_of("t"), numbers(1, 42));
}

TEST_F(OutboxRefusalTest, RefusedTopicDelaysNoOtherTopic) {
  is_store_quick = true;
  link_up();
  std::uint64_t number = 0;
  for (int i = 0; i < 50; ++i) {
    for (const char* topic : {"r/1/bad", "r/1/good", "r/2/good"}) submit(topic, ++number);
    answer_all({"r/1/bad"}, quota_exceeded);
  }
  EXPECT_EQ(received_of("r/1/good").size(), 50u) << "another topic of the same robot";
  EXPECT_EQ(received_of("r/2/good").size(), 50u);
  EXPECT_EQ(store.dead_letters.size(), 50u);
  EXPECT_EQ(depth(), 0u);
}

TEST_F(OutboxRefusalTest, DeliversTheBacklogOfOtherTopicsPastARefusedOne) {
  for (std::uint64_t i = 1; i <= 2000; ++i) submit(i % 2 ? "bad" : "good", i);
  serve_all();
  link_up();
  serve_all();
  for (int i = 0; i < 3000 && received_of("good").size() < 1000; ++i) {
    answer_all({"bad"}, not_authorised);
    serve_all();
  }
  EXPECT_EQ(received_of("good").size(), 1000u);
  EXPECT_TRUE(received_of("bad").empty());
  settle();
  std::vector<std::string> odd;
  for (int i = 1; i <= 2000; i += 2) odd.push_back(std::to_string(i));
  std::ranges::sort(odd);
  EXPECT_EQ(all_of("bad"), odd);
}

TEST_F(OutboxRefusalTest, ReportsTopicAndReasonOnceAndWhenTheBrokerAcceptsThemAgain) {
  is_store_quick = true;
  link_up();
  submit("a", 1);
  answer_all({"a"}, not_authorised);
  submit("b", 2);
  answer_all({"b"}, quota_exceeded);
  for (int i = 0; i < 30; ++i) {
    pass(1s);
    submit("a", static_cast<std::uint64_t>(10 + i));
    answer_all({"a", "b"}, not_authorised);
  }
  EXPECT_EQ(count_notices("refuses messages on a: some reason (0x87)"), 1);
  EXPECT_EQ(count_notices("refuses messages on b: some reason (0x97)"), 1);
  EXPECT_EQ(count_notices("refuses messages on b: some reason (0x87)"), 1)
      << "the reason has changed";
  const std::vector<RefusedTopic> held = outbox->refused_topics().list(10);
  ASSERT_EQ(held.size(), 2u);
  const RefusedTopic& a = held[0].topic == "a" ? held[0] : held[1];
  EXPECT_EQ(a.waiting, 31u);
  EXPECT_EQ(a.refusal.code, not_authorised);
  settle();
  EXPECT_EQ(count_notices("accepts messages on a again"), 1);
  EXPECT_EQ(notices.size(), 5u);
}

TEST_F(OutboxRefusalTest, DeliversAThousandRefusedTopicsOnceTheBrokerAcceptsThem) {
  is_store_quick = true;
  link_up();
  for (std::uint64_t i = 1; i <= 1000; ++i) {
    submit("t/" + std::to_string(i), i);
    refuse_all();
  }
  EXPECT_EQ(notices.size(), 1000u) << "the log bounds their number";
  settle();
  for (std::uint64_t i = 1; i <= 1000; ++i)
    EXPECT_EQ(received_of("t/" + std::to_string(i)).size(), 1u);
}

TEST_F(OutboxRefusalTest, PermanentRefusalMakesADeadLetterOfThatMessageOnly) {
  link_up();
  for (std::uint64_t i = 1; i <= 3; ++i) submit("t", i);
  acknowledge_first();
  refuse_first(topic_name_invalid);
  acknowledge_first();
  EXPECT_TRUE(fired[2].empty()) << "not before it is on disk";
  serve_all();
  EXPECT_TRUE(has_fired(2, ReceiptOutcome::safe));
  ASSERT_EQ(store.dead_letters.size(), 1u);
  const auto& letter = store.dead_letters.begin()->second;
  EXPECT_EQ(letter.message.payload, to_bytes("2"));
  EXPECT_EQ(letter.why.code, topic_name_invalid);
  EXPECT_EQ(letter.why.reason, "some reason");
  EXPECT_EQ(outbox->statistics().dead_letters, 1u);
  EXPECT_EQ(count_notices("a message of 1 octets on t is a dead letter now: some reason (0x90)"),
            1);
  EXPECT_TRUE(outbox->refused_topics().empty()) << "its topic is not refused";
  EXPECT_EQ(depth(), 0u);
  EXPECT_EQ(outbox->queued_bytes(), 0u);
  EXPECT_EQ(outbox->backlog().bytes(), 0u);
  settle();
  EXPECT_EQ(received_of("t"), (std::vector<std::string>{"1", "3"}));
}

TEST_F(OutboxRefusalTest, RefusedMessageOfTheBacklogLeavesIt) {
  for (std::uint64_t i = 1; i <= 20; ++i) submit("t", i);
  serve_all();
  link_up();
  serve_all();
  refuse_first(topic_name_invalid);
  settle();
  EXPECT_EQ(store.dead_letters.size(), 1u);
  EXPECT_EQ(all_of("t"), numbers(2, 19));
  EXPECT_TRUE(store.rows.empty());
  EXPECT_EQ(outbox->backlog().bytes(), 0u);
}

TEST_F(OutboxRefusalTest, RetriesADeadLetterThatTheStoreFailedToWrite) {
  store.is_failing = true;
  link_up();
  submit("t", 1);
  refuse_first(topic_name_invalid);
  serve_all();
  EXPECT_TRUE(fired.empty());
  EXPECT_TRUE(store.dead_letters.empty());
  store.is_failing = false;
  for (int i = 0; i < 10; ++i) {
    pass(1s);
    serve_all();
    refuse_all(topic_name_invalid);
  }
  serve_all();
  EXPECT_EQ(store.dead_letters.size(), 1u);
  EXPECT_TRUE(has_fired(1, ReceiptOutcome::safe));
}

TEST_F(OutboxRefusalTest, WithoutAStorePermanentlyRefusedMessagesAreNotAcknowledged) {
  outbox->on_store_event(StoreAbsent{}, now);
  link_up();
  submit("t", 1);
  refuse_first(topic_name_invalid);
  EXPECT_TRUE(has_fired(1, ReceiptOutcome::refused));
  EXPECT_EQ(depth(), 0u);
  EXPECT_EQ(outbox->queued_bytes(), 0u);
  EXPECT_EQ(count_notices("was not delivered"), 1);
}

/// If an operator resent it, it would replace a newer one at the broker.
TEST_F(OutboxRefusalTest, GatewaysOwnRetainedMessageNeverBecomesADeadLetter) {
  constexpr int packet_too_large = 0x95;
  is_store_quick = true;
  link_up();
  const auto submit_state = [this](const std::string& text) {
    outbox->submit({"gateway/g/state", to_bytes(text), Qos::at_least_once, true}, no_receipt, now);
    drain();
  };
  submit_state("online");
  refuse_first(packet_too_large);
  EXPECT_TRUE(store.dead_letters.empty());
  EXPECT_EQ(outbox->statistics().dropped, 1u);
  EXPECT_NE(notices.back().find("was not delivered"), std::string::npos) << notices.back();
  submit_state("offline");
  acknowledge_all();
  EXPECT_EQ(received_of("gateway/g/state"), (std::vector<std::string>{"offline"}));
  EXPECT_EQ(depth(), 0u);
}

TEST_F(OutboxRefusalTest, WithoutAStoreRefusedMessagesAreNotAcknowledged) {
  outbox->on_store_event(StoreAbsent{}, now);
  link_up();
  for (std::uint64_t i = 1; i <= 40; ++i) submit("t", i);
  refuse_all();
  submit("t", 41);
  for (std::uint64_t i = 1; i <= 41; ++i)
    EXPECT_TRUE(has_fired(i, ReceiptOutcome::refused)) << i << ": the robot keeps it";
  EXPECT_EQ(depth(), 0u);
  EXPECT_EQ(outbox->queued_bytes(), 0u);
  pass(1s);
  submit("t", 42);
  submit("t", 43);
  EXPECT_EQ(under_way.size(), 1u) << "one is tried";
  EXPECT_TRUE(has_fired(43, ReceiptOutcome::refused));
  acknowledge_all();
  submit("t", 44);
  settle();
  EXPECT_EQ(received_of("t"), (std::vector<std::string>{"42", "44"}));
}

/// Of presence and state only the last message of a topic counts.
TEST_F(OutboxRefusalTest, PublishesNoOlderRetainedGatewayMessageAfterANewerOne) {
  is_store_quick = true;
  link_up();
  const auto state = [&](const char* text) {
    outbox->submit({"gateway/g/state", to_bytes(text), Qos::at_least_once, true}, no_receipt, now);
    drain();
  };
  state("1");
  refuse_all();
  now += 1s;  // the next message is the try, before the deadline is served
  state("2");
  acknowledge_all();
  settle();
  EXPECT_EQ(received_of("gateway/g/state"), std::vector<std::string>{"2"});

  received.clear();
  state("3");
  refuse_all();
  pass(1s);
  ASSERT_EQ(under_way.size(), 1u);
  state("4");  // while an older one is tried
  refuse_first();
  settle();
  EXPECT_EQ(received_of("gateway/g/state"), std::vector<std::string>{"4"});

  received.clear();
  state("5");
  state("6");  // while the older one is under way
  refuse_first();
  acknowledge_first();
  settle();
  EXPECT_EQ(received_of("gateway/g/state"), std::vector<std::string>{"6"});
  EXPECT_EQ(outbox->queued_bytes(), 0u);
}

TEST_F(OutboxRefusalTest, RetriesOnlyTheLastOfTheGatewaysOwnRetainedMessages) {
  is_store_quick = true;
  link_up();
  for (const char* state : {"1", "2", "3"}) {
    outbox->submit({"gateway/g/state", to_bytes(state), Qos::at_least_once, true}, no_receipt, now);
    drain();
    refuse_all();
  }
  EXPECT_TRUE(store.dead_letters.empty());
  EXPECT_EQ(depth(), 1u);
  ASSERT_EQ(outbox->list_refused(10).size(), 1u);
  EXPECT_EQ(outbox->list_refused(10)[0].waiting, 1u);
  settle();
  EXPECT_EQ(received_of("gateway/g/state"), std::vector<std::string>{"3"});
  EXPECT_EQ(outbox->queued_bytes(), 0u);
}

TEST_F(OutboxRefusalTest, NewConnectionDoesNotEndThePauseOfARefusedTopic) {
  is_store_quick = true;
  link_up();
  submit("t", 1);
  std::size_t closings = 0;
  for (int i = 0; i < 120; ++i) {  // a broker that refuses, and then closes the connection
    if (!under_way.empty()) {
      refuse_all();
      link_down();
      ++closings;
      link_up();
    }
    pass(1s);
  }
  EXPECT_LE(closings, 8u) << "1 s, 2 s, ... 60 s";
  settle();
  EXPECT_EQ(received_of("t"), std::vector<std::string>{"1"});
}

TEST_F(OutboxRefusalTest, RefusedTopicLosesNothingOverARestart) {
  be_refused(30);
  die();
  start();
  link_up();
  for (int i = 0; i < 10; ++i) {
    refuse_all();
    pass(1s);
  }
  settle();
  EXPECT_EQ(all_of("t"), numbers(1, 30));
}

TEST_F(OutboxRefusalTest, RetriesDeadLettersAfterARestartWithoutANewMessage) {
  be_refused(300);
  die();
  start();
  link_up();
  EXPECT_EQ(under_way.size(), 1u) << "one is tried";
  settle();
  EXPECT_EQ(all_of("t"), numbers(1, 300));
}

TEST_F(OutboxRefusalTest, DeadLetterStaysOneWhileTheDiskFails) {
  is_store_quick = true;
  link_up();
  submit("t", 1);
  refuse_all();
  store.is_failing = true;
  pass(1s);
  pass(1s);
  EXPECT_TRUE(under_way.empty());
  EXPECT_EQ(store.dead_letters.size(), 1u);
  store.is_failing = false;
  for (int i = 0; i < 10; ++i) pass(1s);
  settle();
  EXPECT_EQ(received_of("t"), std::vector<std::string>{"1"});
  EXPECT_TRUE(store.dead_letters.empty());
}

TEST_F(OutboxRefusalTest, DeliversDeadLettersOnceTheDiskIsNoLongerFull) {
  be_refused(100);
  pass(2min);
  ASSERT_EQ(under_way.size(), 1u) << "one is tried";
  store.is_failing = true;
  acknowledge_all();
  pass(1s);
  EXPECT_EQ(store.dead_letters.size(), 99u);
  EXPECT_NE(outbox->store_trouble(), "");
  for (int i = 0; i < 30; ++i) pass(1s);
  EXPECT_EQ(count_notices("the store cannot be written: no space left"), 1) << "once a minute";
  store.is_failing = false;
  for (int i = 0; i < 60; ++i) {
    pass(1s);
    acknowledge_all();
  }
  EXPECT_EQ(all_of("t"), numbers(1, 100)) << "though nothing else was stored in between";
  EXPECT_EQ(outbox->store_trouble(), "");
}

/// A loss during the retry counts against the topic for a moment.
TEST_F(OutboxRefusalTest, DeliversDeadLettersThoughTheConnectionBreaksDuringTheirRetry) {
  be_refused(400);
  for (int losses = 0; losses < 2; ++losses) {
    pass(2min);
    if (losses == 0) acknowledge_first();
    ASSERT_FALSE(under_way.empty());
    link_down();
    link_up();
  }
  settle();
  EXPECT_EQ(all_of("t"), numbers(1, 400));
  EXPECT_TRUE(store.dead_letters.empty());
}

TEST_F(OutboxRefusalTest, PublishesDeadLettersAtOnceWhenAnOperatorResendsThem) {
  be_refused(100);
  for (int i = 0; i < 100; ++i) {
    pass(1s);
    refuse_all();
  }
  pass(1s);
  ASSERT_TRUE(under_way.empty()) << "the topic pauses for a minute";
  outbox->on_store_event(store.revive_all(now), now);
  drain();
  EXPECT_EQ(under_way.size(), 1u);
  for (int i = 0; i < 10; ++i) {
    acknowledge_all();
    pass(100ms);
  }
  EXPECT_EQ(all_of("t"), numbers(1, 100));
  EXPECT_TRUE(store.dead_letters.empty());
}

/// The store makes messages of some of them at a time, and the outbox asks for one in between.
TEST_F(OutboxRefusalTest, PublishesDeadLettersInTheirOrderWhenAnOperatorResendsThem) {
  be_refused(700);
  pass(1s);
  refuse_all();
  is_store_quick = false;
  ASSERT_EQ(store.dead_letters.size(), 700u);
  const auto revived = store.revive_all(now);
  for (std::size_t first = 0; first < 700; first += 50) {
    DeadLettersRevived part;
    part.messages.assign(revived.messages.begin() + static_cast<std::ptrdiff_t>(first),
                         revived.messages.begin() + static_cast<std::ptrdiff_t>(first + 50));
    outbox->on_store_event(part, now);
    drain();
  }
  serve_all();
  EXPECT_EQ(under_way.size(), 1u) << "the topic is tried";
  settle();
  std::vector<std::string> in_order;
  for (int number = 1; number <= 700; ++number) in_order.push_back(std::to_string(number));
  EXPECT_EQ(received_of("t"), in_order);
  EXPECT_TRUE(store.dead_letters.empty());
}

TEST_F(OutboxRefusalTest, DiscardedDeadLettersNoLongerCountAsWaiting) {
  be_refused(100);
  ASSERT_EQ(outbox->list_refused(1)[0].waiting, 100u);
  outbox->on_store_event(store.discard_all(), now);
  drain();
  EXPECT_EQ(outbox->list_refused(1)[0].waiting, 0u);
  now += 1s;  // the pause is over, and the store is not asked yet
  submit("t", 101);
  EXPECT_EQ(under_way.size(), 1u) << "the new message is the try";
  settle();
  EXPECT_EQ(received_of("t"), std::vector<std::string>{"101"});
}

/// Otherwise the store would accept more messages than it has room for.
TEST_F(OutboxRefusalTest, CountsDeadLettersThatAreNotWrittenYet) {
  be_refused(1);
  is_store_quick = false;
  submit("t", 2);
  ASSERT_EQ(outbox->backlog().dead_letters().count, 2u);
  outbox->on_store_event(store.discard_all(), now);
  drain();
  EXPECT_EQ(outbox->backlog().dead_letters().count, 1u);
  EXPECT_EQ(outbox->backlog().dead_letters().bytes, stored_cost(1, 1));
  settle();
}

/// The operator discards letters 1 and 2 while they are requested; letter 3 is not written yet.
TEST_F(OutboxRefusalTest, RetriesADeadLetterThoughEarlierOnesWereDiscarded) {
  be_refused(2);
  is_store_quick = false;
  pass(1s);  // the store is asked for a letter
  outbox->on_store_event(store.discard_all(), now);
  drain();
  submit("t", 3);
  EXPECT_EQ(outbox->list_refused(1)[0].waiting, 1u);
  settle();
  EXPECT_EQ(received_of("t"), std::vector<std::string>{"3"});
  EXPECT_TRUE(store.dead_letters.empty());
}

TEST_F(OutboxRefusalTest, RetriesADeadLetterThoughAResentOneOfItsTopicWasRefusedAgain) {
  is_store_quick = true;
  link_up();
  submit("t", 1);
  refuse_all(topic_name_invalid);
  submit("t", 2);
  refuse_all();
  ASSERT_EQ(store.dead_letters.size(), 2u);
  outbox->on_store_event(store.revive_one(store.dead_letters.begin()->first, now), now);
  drain();
  pass(1s);
  while (!under_way.empty())
    number_in(under_way.front().message) == "1" ? refuse_first(topic_name_invalid)
                                                : acknowledge_first();
  settle();
  EXPECT_EQ(received_of("t"), std::vector<std::string>{"2"});
}

TEST_F(OutboxRefusalTest, DeliversALaterMessageThoughAnOperatorResentTheRequestedLetter) {
  link_up();
  submit("t", 1);
  refuse_all();
  serve_all();
  pass(1s);  // the store is asked for the letter
  outbox->on_store_event(store.revive_all(now), now);
  drain();
  submit("t", 2);
  settle();
  EXPECT_EQ(all_of("t"), (std::vector<std::string>{"1", "2"}));
  EXPECT_TRUE(store.dead_letters.empty());
}

TEST_F(OutboxRefusalTest, DeliversAMessageThatTheStoreFirstFailedToMakeADeadLetter) {
  submit("t", 1);
  serve_all();
  link_up();
  serve_all();
  store.fail_countdown = 1;
  refuse_all();
  pass(1s);  // the store is asked for the letter, which it does not have
  settle();
  EXPECT_EQ(received_of("t"), std::vector<std::string>{"1"});
}

/// Between these requests the store takes writes that need no room.
TEST_F(OutboxRefusalTest, ReportsAStoreThatTakesOnlySomeWritesOnceAMinute) {
  be_refused(1);
  store.is_full = true;
  for (std::uint64_t i = 0; i < 150; ++i) {
    submit("u", 10 + i);
    pass(Outbox::broker_patience);
    acknowledge_all();
    for (int second = 0; second < 2; ++second) pass(1s);
  }
  EXPECT_LE(count_notices("cannot be written"), 10) << "in ten minutes";
  EXPECT_LE(count_notices("works again"), 10);
  store.is_full = false;
  settle();
  EXPECT_EQ(received_of("t"), std::vector<std::string>{"1"});
  EXPECT_EQ(outbox->store_trouble(), "");
}

TEST_F(OutboxRefusalTest, RetriesDeadLettersSeldomWhileTheStoreIsFull) {
  be_refused(1);
  store.is_full = true;
  for (int i = 0; i < 300; ++i) pass(1s);
  EXPECT_LE(outbox->store_failures(), 31u) << "each RefusedTopics::store_pause";
  store.is_full = false;
  settle();
  EXPECT_EQ(received_of("t"), std::vector<std::string>{"1"});
}

TEST_F(OutboxRefusalTest, DoesNotMistakeAnOldAnswerOfTheStoreForANewOne) {
  be_refused(2);
  pass(1s);
  is_store_quick = false;
  acknowledge_all();  // the store is asked for letter 2
  submit("t", 3);
  submit("t", 4);
  refuse_first();
  acknowledge_first();
  store.dead_letters.clear();  // an operator has discarded letter 2
  serve_store();
  serve_store();
  store.is_failing = true;
  serve_store();
  store.is_failing = false;
  settle();
  EXPECT_EQ(all_of("t"), (std::vector<std::string>{"1", "3", "4"}));
}

TEST_F(OutboxRefusalTest, AnswerAboutDeadLettersDoesNotHideThatTheStoreFails) {
  link_up();
  submit("t", 1);
  refuse_all();
  serve_all();
  pass(1s);  // the store is asked for the letter
  store.dead_letters.clear();
  outbox->on_store_event(StoreWriteFailed{"no space left on device"}, now);
  serve_all();
  EXPECT_NE(outbox->store_trouble(), "");
}

TEST_F(OutboxRefusalTest, RefusedTopicLeavesMostOfTheStoreToOtherTopics) {
  max_bytes = 1000 * stored_cost(3, 4);
  start();
  be_refused(2000, "bad", 1001);
  EXPECT_EQ(store.dead_letters.size(), 188u) << "three quarters of a quarter";
  EXPECT_TRUE(has_fired(3000, ReceiptOutcome::refused)) << "not acknowledged: the robot keeps it";
  link_down();
  for (std::uint64_t i = 1; i <= 300; ++i) submit("good", 5000 + i);
  EXPECT_TRUE(has_fired(5300, ReceiptOutcome::safe));
  settle();
  EXPECT_EQ(received_of("bad").size(), 188u);
  EXPECT_EQ(received_of("good").size(), 300u);
}

TEST_F(OutboxRefusalTest, LogLineOfRefusedTopicsCountsNoMessagesOfAFullStore) {
  max_bytes = 1000 * stored_cost(3, 4);
  start();
  is_store_quick = true;
  for (std::uint64_t i = 1; i <= 1100; ++i) submit("full", i);
  ASSERT_TRUE(has_fired(1100, ReceiptOutcome::refused));
  settle();
  be_refused(2000, "bad", 2001);
  const auto line = std::ranges::find_if(notices, [](const std::string& notice) {
    return notice.find("the broker refuses their topics") != std::string::npos;
  });
  ASSERT_NE(line, notices.end());
  EXPECT_TRUE(line->starts_with("1 new messages")) << *line;
}

TEST_F(OutboxRefusalTest, DeadLettersLeaveRoomForMessages) {
  max_bytes = 400 * stored_cost(3, 4);
  start();
  be_refused(400, "bad", 1001, topic_name_invalid);
  EXPECT_EQ(store.dead_letters.size(), 75u);
  EXPECT_TRUE(has_fired(1400, ReceiptOutcome::refused));
}

TEST_F(OutboxRefusalTest, ARobotWithARefusedTopicLeavesRoomForDeadLettersOfOthers) {
  max_bytes = 4000 * stored_cost(7, 4);
  start();
  be_refused(2000, "r/1/bad", 1001);
  EXPECT_TRUE(has_fired(3000, ReceiptOutcome::refused));
  EXPECT_TRUE(outbox->backlog().has_little_room_for_letters());
  EXPECT_EQ(outbox->backlog().largest_share().name, "r/1");
  for (std::uint64_t i = 1; i <= 50; ++i) {
    submit("r/2/bad", 4000 + i);
    refuse_all();
    EXPECT_TRUE(has_fired(4000 + i, ReceiptOutcome::safe)) << i;
  }
  die();
  start();
  link_up();
  submit("r/1/bad", 5000);
  refuse_all();
  EXPECT_TRUE(has_fired(5000, ReceiptOutcome::refused)) << "the shares are known after a restart";
  settle();
  EXPECT_EQ(outbox->backlog().largest_share().value, 0u);
  EXPECT_FALSE(outbox->backlog().has_little_room_for_letters());
}

TEST_F(OutboxRefusalTest, DropsMessagesOfQos0OfARefusedTopic) {
  is_store_quick = true;
  link_up();
  submit("t", 1);
  refuse_all();
  submit("t", 0, Qos::at_most_once);
  EXPECT_TRUE(under_way.empty());
  EXPECT_EQ(outbox->statistics().dropped, 1u);
  settle();
  EXPECT_EQ(received_of("t"), std::vector<std::string>{"1"});
}

}  // namespace
}  // namespace slamgw
