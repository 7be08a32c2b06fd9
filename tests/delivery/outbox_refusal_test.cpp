// SPDX-License-Identifier: Apache-2.0
// A broker that answers a PUBLISH with a reason code of 0x80 or above: nothing acknowledged is
// lost, the topic waits and nobody else, and what can never be delivered becomes a dead letter.
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
  static std::vector<std::string> numbers(std::uint64_t first, std::uint64_t count) {
    std::vector<std::string> out;
    for (std::uint64_t i = 0; i < count; ++i) out.push_back(std::to_string(first + i));
    return out;
  }
  std::ptrdiff_t said(std::string_view words) const {
    return std::count_if(notices.begin(), notices.end(), [&](const std::string& notice) {
      return notice.find(words) != std::string::npos;
    });
  }
  void serve_all() {
    while (serve_store()) {
    }
  }
  /// The broker refuses all of these topics and takes the rest.
  void answer_all(const std::vector<std::string>& refused, int code) {
    while (!under_way.empty()) {
      const std::string& topic = under_way.front().message.topic;
      const bool is_refused = std::find(refused.begin(), refused.end(), topic) != refused.end();
      is_refused ? refuse_first(code) : acknowledge_first();
      serve_all();
    }
  }
};

TEST_F(OutboxRefusalTest, KeepsWhatIsRefusedAndDeliversItInOrderOnceTheBrokerTakesIt) {
  is_store_quick = true;
  link_up();
  for (std::uint64_t i = 1; i <= 100; ++i) {
    submit("t", i);
    answer_all({"t"}, not_authorised);
  }
  EXPECT_EQ(fired.size(), 100u) << "safely on disk, so the robot may forget them";
  EXPECT_EQ(store.rows.size(), 100u);
  EXPECT_EQ(outbox->held_topics().refused(), 1u);
  for (int i = 0; i < 20; ++i) {
    pass(1s);
    answer_all({"t"}, not_authorised);
  }
  EXPECT_TRUE(received_of("t").empty());
  EXPECT_LE(published_topics.size(), 1u + 5u) << "tried with a growing pause";
  settle();
  EXPECT_EQ(received_of("t"), numbers(1, 100));
  EXPECT_TRUE(store.rows.empty());
  EXPECT_TRUE(outbox->held_topics().empty());
  EXPECT_EQ(outbox->statistics().dropped, 0u);
}

TEST_F(OutboxRefusalTest, AWholeWindowThatIsRefusedKeepsItsOrder) {
  link_up();
  for (std::uint64_t i = 1; i <= 40; ++i) submit("t", i);
  ASSERT_EQ(under_way.size(), window);
  std::swap(under_way[3], under_way[9]);  // answers may come in another order
  refuse_first();
  submit("t", 41);
  refuse_all();
  submit("t", 42);
  serve_all();
  EXPECT_EQ(fired.size(), 42u);
  settle();
  EXPECT_EQ(received_of("t"), numbers(1, 42));
}

TEST_F(OutboxRefusalTest, NobodyElseWaits) {
  is_store_quick = true;
  link_up();
  std::uint64_t number = 0;
  for (int i = 0; i < 50; ++i) {
    for (const char* topic : {"r/1/bad", "r/1/good", "r/2/good"}) submit(topic, ++number);
    answer_all({"r/1/bad"}, quota_exceeded);
  }
  EXPECT_EQ(received_of("r/1/good").size(), 50u) << "another topic of the same robot";
  EXPECT_EQ(received_of("r/2/good").size(), 50u);
  EXPECT_EQ(store.rows.size(), 50u);
  EXPECT_EQ(depth(), 50u);
}

TEST_F(OutboxRefusalTest, ABacklogOfOthersPassesTheRefusedTopic) {
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
  EXPECT_EQ(received_of("bad"), odd);
}

TEST_F(OutboxRefusalTest, SaysTopicAndReasonOnceAndThatTheBrokerTakesThemAgain) {
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
  EXPECT_EQ(said("does not take messages on a: said so (0x87)"), 1);
  EXPECT_EQ(said("does not take messages on b: said so (0x97)"), 1);
  EXPECT_EQ(said("does not take messages on b: said so (0x87)"), 1) << "the reason has changed";
  const std::vector<HeldTopic> held = outbox->held_topics().list(10);
  ASSERT_EQ(held.size(), 2u);
  const HeldTopic& a = held[0].topic == "a" ? held[0] : held[1];
  EXPECT_EQ(a.waiting, 31u);
  EXPECT_EQ(a.refusal.code, not_authorised);
  settle();
  EXPECT_EQ(said("takes messages on a again"), 1);
  EXPECT_EQ(notices.size(), 5u);
}

TEST_F(OutboxRefusalTest, AThousandRefusedTopicsDoNotFillTheLog) {
  is_store_quick = true;
  link_up();
  for (std::uint64_t i = 1; i <= 1000; ++i) {
    submit("t/" + std::to_string(i), i);
    refuse_all();
  }
  EXPECT_EQ(notices.size(), RefusalNotices::most_lines);
  settle();
  for (std::uint64_t i = 1; i <= 1000; ++i)
    EXPECT_EQ(received_of("t/" + std::to_string(i)).size(), 1u);
  pass(RefusalNotices::interval);
  submit("other", 2000);
  refuse_all();
  EXPECT_GE(said("more lines like this were left out"), 1);
}

TEST_F(OutboxRefusalTest, WhatTheBrokerCanNeverTakeBecomesADeadLetterAlone) {
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
  EXPECT_EQ(letter.why.reason, "said so");
  EXPECT_EQ(outbox->statistics().set_aside, 1u);
  EXPECT_EQ(said("a message of 1 octets on t was set aside: said so (0x90)"), 1);
  EXPECT_TRUE(outbox->held_topics().empty()) << "its topic goes on";
  EXPECT_EQ(depth(), 0u);
  EXPECT_EQ(outbox->queued_bytes(), 0u);
  EXPECT_EQ(outbox->backlog().bytes(), 0u);
  settle();
  EXPECT_EQ(received_of("t"), (std::vector<std::string>{"1", "3"}));
}

TEST_F(OutboxRefusalTest, ADeadLetterFromTheBacklogLeavesIt) {
  for (std::uint64_t i = 1; i <= 20; ++i) submit("t", i);
  serve_all();
  link_up();
  serve_all();
  refuse_first(topic_name_invalid);
  settle();
  EXPECT_EQ(store.dead_letters.size(), 1u);
  EXPECT_EQ(received_of("t"), numbers(2, 19));
  EXPECT_TRUE(store.rows.empty());
  EXPECT_EQ(outbox->backlog().bytes(), 0u);
}

TEST_F(OutboxRefusalTest, WhenTheDeadLetterCannotBeWrittenItIsTriedAgain) {
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

TEST_F(OutboxRefusalTest, WithoutAStoreWhatCanNeverBeTakenIsNotAcknowledged) {
  outbox->on_store_event(StoreAbsent{}, now);
  link_up();
  submit("t", 1);
  refuse_first(topic_name_invalid);
  EXPECT_TRUE(has_fired(1, ReceiptOutcome::refused));
  EXPECT_EQ(depth(), 0u);
  EXPECT_EQ(outbox->queued_bytes(), 0u);
  EXPECT_EQ(said("was not delivered"), 1);
}

TEST_F(OutboxRefusalTest, WithoutAStoreRefusedMessagesWaitInMemoryInOrder) {
  outbox->on_store_event(StoreAbsent{}, now);
  link_up();
  for (std::uint64_t i = 1; i <= 40; ++i) submit("t", i);
  refuse_all();
  submit("t", 41);
  EXPECT_TRUE(fired.empty());
  EXPECT_EQ(depth(), 41u);
  pass(1s);
  EXPECT_EQ(under_way.size(), 1u) << "one is tried";
  refuse_all();
  link_down();
  EXPECT_EQ(depth(), 41u);
  settle();
  EXPECT_EQ(received_of("t"), numbers(1, 41));
  EXPECT_EQ(fired.size(), 41u);
  EXPECT_EQ(outbox->queued_bytes(), 0u);
}

TEST_F(OutboxRefusalTest, ANewConnectionDoesNotEndThePause) {
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

TEST_F(OutboxRefusalTest, ARefusedTopicIsRefusedAgainAfterARestartAndLosesNothing) {
  is_store_quick = true;
  link_up();
  for (std::uint64_t i = 1; i <= 30; ++i) {
    submit("t", i);
    refuse_all();
  }
  die();
  start();
  link_up();
  for (int i = 0; i < 10; ++i) {
    refuse_all();
    pass(1s);
  }
  settle();
  EXPECT_EQ(received_of("t"), numbers(1, 30));
}

TEST_F(OutboxRefusalTest, AfterADayInVainAMessageIsSetAsideAndTheNextTried) {
  is_store_quick = true;
  link_up();
  submit("t", 1);
  refuse_all();
  pass(25h);
  submit("t", 2);
  for (int i = 0; i < 60 && store.dead_letters.empty(); ++i) {
    refuse_all();
    pass(10s);
  }
  ASSERT_EQ(store.dead_letters.size(), 1u);
  EXPECT_EQ(store.dead_letters.begin()->second.message.payload, to_bytes("1"));
  EXPECT_EQ(store.dead_letters.begin()->second.why.code, not_authorised);
  EXPECT_GE(store.dead_letters.begin()->second.why.tries, Outbox::hopeless_tries);
  settle();
  EXPECT_EQ(received_of("t"), std::vector<std::string>{"2"});
}

TEST_F(OutboxRefusalTest, ARefusedTopicLeavesHalfOfTheStoreToTheOthers) {
  max_bytes = 1000 * stored_cost(3, 4);
  start();
  is_store_quick = true;
  link_up();
  for (std::uint64_t i = 1; i <= 2000; ++i) {
    submit("bad", 1000 + i);
    refuse_all();
  }
  EXPECT_NEAR(static_cast<double>(store.rows.size()), 500, 20);
  EXPECT_TRUE(has_fired(3000, ReceiptOutcome::refused)) << "not acknowledged: the robot keeps it";
  link_down();
  for (std::uint64_t i = 1; i <= 300; ++i) submit("good", 5000 + i);
  EXPECT_TRUE(has_fired(5300, ReceiptOutcome::safe));
  const std::size_t acknowledged = store.rows.size();
  settle();
  EXPECT_EQ(received_of("bad").size() + received_of("good").size(), acknowledged);
}

TEST_F(OutboxRefusalTest, DeadLettersLeaveRoomForMessages) {
  max_bytes = 400 * stored_cost(3, 4);
  start();
  is_store_quick = true;
  link_up();
  for (std::uint64_t i = 1; i <= 400; ++i) {
    submit("bad", 1000 + i);
    refuse_all(topic_name_invalid);
  }
  EXPECT_EQ(store.dead_letters.size(), 100u);
  EXPECT_TRUE(has_fired(1400, ReceiptOutcome::refused));
}

TEST_F(OutboxRefusalTest, UnacknowledgedMessagesOfARefusedTopicDoNotWait) {
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
