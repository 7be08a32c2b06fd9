// SPDX-License-Identifier: Apache-2.0
// The outbox and its store: outages, slow brokers, a backlog that drains beside fresh traffic, a
// store that is full, fails or is damaged.
#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <vector>

#include "daemon/delivery/outbox.hpp"
#include "tests/delivery/outbox_rig.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

class OutboxStoreTest : public testing::Test, public test::OutboxRig {
 protected:
  void serve_all() {
    while (serve_store()) {
    }
  }
  /// `count` messages of `topic`, safely on disk, numbered from `first`.
  void store_backlog(const std::string& topic, std::uint64_t first, std::uint64_t count) {
    for (std::uint64_t i = 0; i < count; ++i) submit(topic, first + i);
    serve_all();
  }
  static std::vector<std::string> numbers(std::uint64_t first, std::uint64_t count) {
    std::vector<std::string> out;
    for (std::uint64_t i = 0; i < count; ++i) out.push_back(std::to_string(first + i));
    return out;
  }
  bool is_noticed(std::string_view words) const {
    return std::any_of(notices.begin(), notices.end(), [&](const std::string& notice) {
      return notice.find(words) != std::string::npos;
    });
  }
};

TEST_F(OutboxStoreTest, CommitsMessagesThatCameDuringACommitTogether) {
  for (std::uint64_t i = 1; i <= 500; ++i) submit("t", i);
  serve_all();
  EXPECT_EQ(store.commits, 2u) << "the first message, then all that came during its commit";
  EXPECT_EQ(store.rows.size(), 500u);
  EXPECT_EQ(outbox->backlog().stored_total(), 500u);
}

TEST_F(OutboxStoreTest, StoresQos1And2WithoutAReceiptAndNoQos0) {
  submit("ble", 0);
  submit("exactly", 0, Qos::exactly_once);
  submit("often", 0, Qos::at_most_once);
  serve_all();
  EXPECT_EQ(store.rows.size(), 2u);
  settle();
  EXPECT_EQ(received_of("ble").size(), 1u);
  EXPECT_EQ(received_of("exactly").size(), 1u);
}

TEST_F(OutboxStoreTest, DrainsALongBacklogInOrderAPageAtATime) {
  store_backlog("a", 1, 1000);
  store_backlog("b", 5000, 1000);
  EXPECT_EQ(outbox->queued_bytes(), 0u);
  settle();
  EXPECT_EQ(received_of("a"), numbers(1, 1000));
  EXPECT_EQ(received_of("b"), numbers(5000, 1000));
  EXPECT_LE(store.largest_page, Backlog::page_messages);
  EXPECT_TRUE(store.rows.empty());
  EXPECT_EQ(depth(), 0u);
  EXPECT_EQ(outbox->backlog().bytes(), 0u);
}

TEST_F(OutboxStoreTest, DeletesDeliveredMessagesInBatches) {
  store_backlog("a", 1, 2000);
  const std::size_t before = store.commits;
  settle();
  EXPECT_LE(store.commits - before, 2000 / Backlog::forget_batch + 3);
}

TEST_F(OutboxStoreTest, WaitingMessagesLeaveMemoryForOtherRobotsWhileTheStoreFails) {
  store_backlog("robot/a/x", 1, 1);
  store.is_failing = true;
  link_up();  // the stored message is asked for, and is not read
  std::uint64_t receipt = 1;
  while (outbox->statistics().refused == 0 && receipt < 100'000)
    submit_bytes("robot/a/x", Bytes(1024), ++receipt);
  EXPECT_TRUE(has_fired(receipt, ReceiptOutcome::refused));
  EXPECT_LE(outbox->queued_bytes(), Outbox::max_queued_bytes / 2 + (2u << 20));
  EXPECT_GE(outbox->queued_bytes(), Outbox::max_queued_bytes / 2 - (2u << 20));
  submit_bytes("robot/b/x", Bytes(1024), ++receipt);
  ASSERT_FALSE(under_way.empty());
  EXPECT_EQ(under_way.back().message.topic, "robot/b/x");
}

TEST_F(OutboxStoreTest, AFreshMessageQueuesBehindItsTopicAndPassesOthers) {
  store_backlog("a", 1, 1000);
  link_up();
  serve_store();  // the first page
  submit("a", 2000);
  submit("b", 3000);
  for (int i = 0; i < 20; ++i) acknowledge_first();
  EXPECT_EQ(received_of("b").size(), 1u) << "does not wait for another topic's backlog";
  settle();
  std::vector<std::string> expected = numbers(1, 1000);
  expected.push_back("2000");
  EXPECT_EQ(received_of("a"), expected);
}

TEST_F(OutboxStoreTest, ABacklogTakesTurnsWithAnotherRobotsFreshMessages) {
  store_backlog("old", 1, 2000);
  link_up();
  serve_all();
  for (std::uint64_t i = 1; i <= 200; ++i) submit("fresh/" + std::to_string(i), 10000 + i);
  published_topics.clear();
  for (int i = 0; i < 100; ++i) {
    acknowledge_first();
    serve_all();
  }
  const auto old = std::count(published_topics.begin(), published_topics.end(), "old");
  EXPECT_NEAR(static_cast<double>(old), 50, 10);
}

TEST_F(OutboxStoreTest, ABacklogTakesTurnsInAWindowOfOneToo) {
  store_backlog("old", 1, 100);
  link_up(2);
  serve_all();
  for (std::uint64_t i = 1; i <= 50; ++i) submit("fresh/" + std::to_string(i), 10000 + i);
  published_topics.clear();
  for (int i = 0; i < 20; ++i) acknowledge_first();
  EXPECT_EQ(std::count(published_topics.begin(), published_topics.end(), "old"), 10);
}

TEST_F(OutboxStoreTest, StoresMessagesWhileTheBrokerDoesNotAcknowledge) {
  link_up();
  for (std::uint64_t i = 1; i <= 40; ++i) submit("t" + std::to_string(i), i);
  pass(1s);
  EXPECT_FALSE(store.is_asked());
  pass(1s);
  serve_all();
  EXPECT_EQ(fired.size(), 40u) << "in flight or waiting: all are safe";
  submit("late", 41);
  serve_all();
  EXPECT_TRUE(has_fired(41, ReceiptOutcome::safe)) << "at once while the broker is stalled";
  EXPECT_EQ(outbox->queued_bytes(), 0u);
  settle();
  for (int i = 1; i <= 40; ++i) {
    EXPECT_EQ(received_of("t" + std::to_string(i)).size(), 1u) << "once, though stored as well";
  }
  EXPECT_TRUE(store.rows.empty());
  submit("after", 42);
  EXPECT_EQ(under_way.size(), 1u);
  EXPECT_FALSE(store.is_asked()) << "the broker is quick again";
}

TEST_F(OutboxStoreTest, StoresMessagesWhileTheBrokerIsSlowerThanTheRobots) {
  link_up();
  std::uint64_t number = 0;
  for (int i = 0; i < 100; ++i) {  // ten come, one is acknowledged, each 100 ms
    for (int k = 0; k < 10; ++k, ++number) submit("t" + std::to_string(number % 50), number + 1);
    acknowledge_first();
    pass(100ms);
    serve_all();
  }
  EXPECT_LT(outbox->unsaved(), 300u) << "about two seconds' worth";
  settle();
  EXPECT_EQ(fired.size(), number);
  std::size_t total = 0;
  for (const auto& [topic, messages] : received) total += messages.size();
  EXPECT_EQ(total, number);
}

TEST_F(OutboxStoreTest, QueuesAMessageOfQos0BehindTheBacklogOfItsTopic) {
  store_backlog("t", 1, 3);
  link_up();
  submit("t", 0, Qos::at_most_once);
  EXPECT_TRUE(under_way.empty());
  settle();
  EXPECT_EQ(received_of("t"), (std::vector<std::string>{"1", "2", "3", "0"}));
}

TEST_F(OutboxStoreTest, DeletesTheStoredCopyOfAMessageAcknowledgedDuringTheWrite) {
  link_up();
  submit("t", 1);
  pass(2s);
  acknowledge_first();  // and then the copy is written
  EXPECT_TRUE(has_fired(1, ReceiptOutcome::safe));
  serve_all();
  EXPECT_EQ(store.rows.size(), 1u);
  settle();
  EXPECT_TRUE(store.rows.empty());
  EXPECT_EQ(received_of("t").size(), 1u);
  EXPECT_EQ(outbox->backlog().rows(), 0u);
}

TEST_F(OutboxStoreTest, PublishesFromTheStoreWhenTheLinkIsLostDuringTheWrite) {
  link_up();
  submit("t", 1);
  pass(2s);
  link_down();
  submit("t", 2);
  serve_all();
  EXPECT_EQ(fired.size(), 2u);
  settle();
  EXPECT_EQ(received_of("t"), numbers(1, 2));
}

TEST_F(OutboxStoreTest, FullStoreRefusesMessagesAndReportsThatOnce) {
  max_bytes = 100 * stored_cost(1, 2);
  start();
  is_store_quick = true;
  for (std::uint64_t i = 10; i <= 99; ++i) submit("t", i);
  for (std::uint64_t i = 1; i <= 50; ++i) submit("u", 1000 + i);
  EXPECT_TRUE(outbox->backlog().is_full());
  EXPECT_LE(outbox->backlog().bytes(), max_bytes);
  EXPECT_TRUE(has_fired(1050, ReceiptOutcome::refused));
  EXPECT_EQ(std::count_if(notices.begin(), notices.end(),
                          [](const auto& n) { return n.find("full") != std::string::npos; }),
            1);
  const std::size_t acknowledged = store.rows.size();
  EXPECT_EQ(outbox->statistics().refused, 140 - acknowledged);
  submit("t", 0);
  EXPECT_EQ(outbox->statistics().dropped, 1u) << "it has no receipt";

  link_up();
  submit("other", 5000);
  EXPECT_EQ(fired.count(5000), 0u) << "it goes to the broker without the store";
  settle();
  EXPECT_FALSE(outbox->backlog().is_full());
  EXPECT_EQ(received_of("t").size() + received_of("u").size(), acknowledged);
  EXPECT_TRUE(has_fired(5000, ReceiptOutcome::safe));
}

TEST_F(OutboxStoreTest, DeliversInOrderFromAStoreThatCanOnlyBeRead) {
  is_store_quick = true;
  for (std::uint64_t i = 1; i <= 600; ++i) submit("t", i);
  die();
  store.is_failing = true;
  start();
  EXPECT_EQ(outbox->store_trouble(), "it cannot be written: read-only file system");
  submit("t", 601);
  EXPECT_EQ(outbox->backlog().rows(), 600u);
  link_up();
  for (int pages = 0; pages < 10; ++pages, pass(1s)) acknowledge_all();
  EXPECT_EQ(received_of("t"), numbers(1, 601));
  EXPECT_TRUE(has_fired(601, ReceiptOutcome::safe)) << "the broker has it";
  EXPECT_EQ(outbox->backlog().rows(), 0u);
  EXPECT_EQ(store.rows.size(), 600u);

  store.is_failing = false;
  settle();
  EXPECT_TRUE(store.rows.empty());
  EXPECT_TRUE(is_noticed("the store works again"));
}

/// Robots with small stores: one sends a hundred messages while each other sends one.
class StoreShare : public OutboxStoreTest {
 protected:
  static constexpr std::uint64_t messages = 4000;
  StoreShare() {
    max_bytes = messages * cost("r1");
    start();
    is_store_quick = true;
  }
  static std::string topic(const std::string& robot) { return "p/robot/" + robot + "/update"; }
  static std::uint64_t cost(const std::string& robot) {
    return stored_cost(topic(robot).size(), 6);
  }
  /// Returns true when it was acknowledged.
  bool send(const std::string& robot) {
    const std::uint64_t receipt = ++last_receipt;
    submit(topic(robot), receipt);
    if (!has_fired(receipt, ReceiptOutcome::safe)) return false;
    acknowledged[robot].push_back(std::to_string(receipt));
    return true;
  }
  std::map<std::string, std::vector<std::string>> acknowledged;
  std::uint64_t last_receipt = 100000;
};

TEST_F(StoreShare, OfManyInventedNamesIsTheWholeStore) {
  int names = 0;
  while (send("made-up-" + std::to_string(names))) ASSERT_LT(++names, 100000);
  EXPECT_TRUE(outbox->backlog().is_full());
  EXPECT_FALSE(send("r1")) << "as docs/security.md describes";
}

TEST_F(StoreShare, OfAFloodingRobotLeavesRoomForOthers) {
  for (int round = 0; round < 100; ++round) {
    for (int i = 0; i < 100; ++i) send("r0");
    for (const std::string robot : {"r1", "r2", "r3", "r4", "r5"})
      EXPECT_TRUE(send(robot)) << robot << " round " << round;
  }
  EXPECT_TRUE(outbox->backlog().is_full()) << "the flood was refused";
  EXPECT_EQ(outbox->backlog().largest_share().name, "p/robot/r0");
  EXPECT_TRUE(is_noticed("bytes of p/robot/r0")) << "it is named";
  EXPECT_LE(outbox->backlog().bytes(), max_bytes);

  die();
  start();
  EXPECT_FALSE(send("r0")) << "the shares are known after a restart";
  EXPECT_TRUE(send("r1"));
  settle();
  for (const auto& [robot, numbers] : acknowledged) EXPECT_EQ(received_of(topic(robot)), numbers);
  EXPECT_EQ(outbox->backlog().largest_share().value, 0u);
  link_down();
  EXPECT_TRUE(send("r0"));
}

TEST_F(StoreShare, OfALoneRobotIsThreeQuartersOfTheStore) {
  for (std::uint64_t i = 0; i < messages; ++i) send("r0");
  EXPECT_GE(acknowledged["r0"].size(), messages * 3 / 4);
  EXPECT_LE(acknowledged["r0"].size(), messages * 3 / 4 + 1);
}

TEST_F(StoreShare, IsEqualAmongRobotsThatSendAlike) {
  for (std::uint64_t i = 0; i < messages; ++i) {
    for (const std::string robot : {"r1", "r2", "r3"}) send(robot);
  }
  EXPECT_LE(acknowledged["r1"].size() - acknowledged["r3"].size(), 1u);
  EXPECT_GE(3 * acknowledged["r1"].size(), messages * 5 / 6);
}

TEST_F(StoreShare, OfOneRobotRefusesASmallMessageAfterALargerOne) {
  while (send("r0")) {
  }
  submit_bytes(topic("r0"), {}, 1);
  EXPECT_TRUE(has_fired(1, ReceiptOutcome::refused)) << "it would overtake the refused one";
}

TEST_F(OutboxStoreTest, RetriesAFailingStoreAndAcknowledgesNothingUntilItWorks) {
  store.is_failing = true;
  for (std::uint64_t i = 1; i <= 100; ++i) submit("t", i);
  serve_all();
  for (int i = 0; i < 30; ++i) {
    pass(1s);
    serve_all();
  }
  EXPECT_TRUE(fired.empty());
  EXPECT_TRUE(is_noticed("no space left"));
  EXPECT_GE(outbox->store_failures(), 4u);
  EXPECT_LE(outbox->store_failures(), 7u) << "with back-off";
  store.is_failing = false;
  for (int i = 0; i < 61; ++i) {
    pass(1s);
    serve_all();
  }
  EXPECT_EQ(fired.size(), 100u);
  EXPECT_TRUE(is_noticed("works again"));
  settle();
  EXPECT_EQ(received_of("t"), numbers(1, 100));
}

TEST_F(OutboxStoreTest, ReportsAFailingStoreOnceAMinute) {
  const auto reports = [this] {
    return std::count_if(notices.begin(), notices.end(), [](const std::string& notice) {
      return notice.find("cannot be written") != std::string::npos;
    });
  };
  store.is_failing = true;
  submit("t", 1);
  for (int i = 0; i < 59; ++i) {
    serve_all();
    pass(1s);
  }
  EXPECT_EQ(reports(), 1);
  EXPECT_EQ(outbox->store_trouble(), "it cannot be written: no space left on device");
  store.is_failing = false;
  for (int i = 0; i < 61; ++i) {
    pass(1s);
    serve_all();
  }
  EXPECT_EQ(outbox->store_trouble(), "");
  store.is_failing = true;
  submit("t", 2);
  serve_all();
  EXPECT_EQ(reports(), 2) << "a new failure is no repetition";
}

TEST_F(OutboxStoreTest, NoticesThatTheStoreWorksAgainWithoutAMessageToStore) {
  link_up();
  store.is_failing = true;
  submit("t", 1);
  pass(Outbox::broker_patience);
  serve_all();
  EXPECT_EQ(outbox->store_trouble(), "it cannot be written: no space left on device");
  acknowledge_all();
  store.is_failing = false;
  for (int i = 0; i < 61; ++i) {
    pass(1s);
    serve_all();
  }
  EXPECT_EQ(outbox->store_trouble(), "");
  EXPECT_TRUE(is_noticed("works again"));
}

TEST_F(OutboxStoreTest, WithdrawsTheReadErrorOnceTheStoreCanBeReadAgain) {
  store_backlog("t", 1, 3);
  link_up();
  outbox->on_store_event(StoreLoadFailed{"Input/output error"}, now);
  drain();
  EXPECT_EQ(outbox->store_trouble(), "it cannot be read: Input/output error");
  settle();
  EXPECT_EQ(outbox->store_trouble(), "");
  EXPECT_EQ(received_of("t"), numbers(1, 3));
}

TEST_F(OutboxStoreTest, AStoreThatFailsToWriteStillDrains) {
  store_backlog("t", 1, 600);
  store.is_failing = true;
  submit("t", 601);
  submit("u", 1);
  serve_all();
  link_up();
  for (int i = 0; i < 50; ++i) {
    acknowledge_all();
    serve_all();
  }
  acknowledge_all();
  EXPECT_EQ(received_of("t"), numbers(1, 601)) << "the last from memory, in its turn";
  EXPECT_EQ(received_of("u").size(), 1u);
  EXPECT_EQ(store.rows.size(), 600u) << "not deleted yet";
  store.is_failing = false;
  pass(60s);
  settle();
  EXPECT_TRUE(store.rows.empty());
  EXPECT_EQ(received_of("t").size(), 601u);
}

TEST_F(OutboxStoreTest, AFullDiskDrainsAndHasRoomAgain) {
  const std::uint64_t many = Backlog::max_unforgotten + 5000;
  store_backlog("t", 1, many);
  store.is_full = true;
  link_up();
  for (std::uint64_t i = 1; received_of("t").size() < many && i <= 1000; ++i) {
    submit("t", many + i);  // should be stored, because it waits for earlier ones
    for (int k = 0; k < 64; ++k) {
      acknowledge_all();
      serve_store();
    }
    pass(100ms);
  }
  ASSERT_GE(received_of("t").size(), many);
  pass(500ms);
  serve_all();
  EXPECT_LT(store.rows.size(), Backlog::forget_batch) << "erased, though nothing can be stored";
  store.is_full = false;
  for (int i = 0; i < 3; ++i) {
    pass(1s);
    serve_all();
  }
  EXPECT_EQ(outbox->store_trouble(), "") << "soon";
  settle();
  EXPECT_EQ(depth(), 0u);
}

TEST_F(OutboxStoreTest, RetriesErasuresSeldomOnADiskThatTakesNone) {
  store_backlog("t", 1, 20);
  store.is_failing = true;
  link_up();
  for (int i = 0; i < 300; ++i) {
    acknowledge_all();
    serve_all();
    pass(100ms);
  }
  EXPECT_EQ(received_of("t"), numbers(1, 20));
  EXPECT_LE(outbox->store_failures(), 14u) << "two for each of five or six attempts in 30 s";
  store.is_failing = false;
  pass(60s);
  settle();
  EXPECT_TRUE(store.rows.empty());
}

TEST_F(OutboxStoreTest, AfterARestartTheBacklogComesBeforeFreshMessages) {
  store_backlog("t", 1, 300);
  pass(90s);
  die();
  start();
  EXPECT_TRUE(is_noticed("300 undelivered messages are in the store, the oldest 90 s old"));
  EXPECT_EQ(depth(), 300u);
  link_up();
  submit("t", 301);
  settle();
  EXPECT_EQ(received_of("t"), numbers(1, 301));
}

TEST_F(OutboxStoreTest, DeliversResentDeadLettersOnceAndInTheirOldOrder) {
  store_backlog("t", 1, 4);
  store_backlog("u", 1000, 600);
  for (const std::uint64_t row : {1u, 2u, 4u}) {
    store.dead_letters[row] = {std::move(store.rows.at(row).message),
                               {row, "", topic_name_invalid, 1}};
    store.rows.erase(row);
  }
  die();
  start();
  link_up();
  serve_store();
  for (int i = 0; i < 200; ++i) acknowledge_first();
  ASSERT_TRUE(store.is_asked()) << "the next page is under way";
  for (int times = 0; times < 2; ++times) {
    outbox->on_store_event(store.revive_all(now), now);
    drain();
  }
  EXPECT_EQ(depth(), 604u - 200u);
  settle();
  EXPECT_EQ(received_of("t"), (std::vector<std::string>{"3", "1", "2", "4"}));
  EXPECT_EQ(received_of("u"), numbers(1000, 600)) << "each once";
  EXPECT_TRUE(store.dead_letters.empty());
  EXPECT_TRUE(store.rows.empty());
  EXPECT_EQ(outbox->queued_bytes(), 0u);
  EXPECT_EQ(outbox->backlog().bytes(), 0u);
}

TEST_F(OutboxStoreTest, SkipsDamagedRowsAndDeliversAllOthers) {
  store_backlog("t", 1, 600);
  store.damaged = {1, 100, 256, 257, 600};
  link_up();
  settle();
  std::vector<std::string> expected = numbers(1, 600);
  for (const char* const lost : {"1", "100", "256", "257", "600"}) std::erase(expected, lost);
  EXPECT_EQ(received_of("t"), expected);
  EXPECT_EQ(depth(), 0u);
  EXPECT_EQ(outbox->backlog().bytes(), 0u);
  const std::size_t commits = store.commits;
  submit("t", 601);
  settle();
  EXPECT_EQ(store.commits, commits) << "no detour through the store for its topic";
}

/// The disk was full for a minute, so the next regular try is far away.
TEST_F(OutboxStoreTest, AnOrderlyStopTriesAFailingStoreOnceMore) {
  store_backlog("t", 1, 20);
  link_up();
  for (int i = 0; i < 4; ++i) serve_store();
  store.is_failing = true;
  for (int i = 0; i < 60; ++i) {
    acknowledge_all();
    pass(1s);
    while (serve_store()) {
    }
  }
  ASSERT_EQ(received_of("t"), numbers(1, 20));
  ASSERT_EQ(store.rows.size(), 20u);
  store.is_failing = false;
  outbox->on_stop(now);
  drain();
  while (serve_store()) {
  }
  EXPECT_TRUE(outbox->is_settled());
  EXPECT_TRUE(store.rows.empty()) << "otherwise all of them are delivered twice";
}

TEST_F(OutboxStoreTest, RetriesAStoreThatCannotBeRead) {
  store_backlog("t", 1, 5);
  link_up();
  store.on_process_died();  // the answer to the load comes from here
  outbox->on_store_event(StoreLoadFailed{"input/output error"}, now);
  drain();
  EXPECT_TRUE(is_noticed("read: input/output error"));
  EXPECT_FALSE(store.is_asked());
  pass(1s);
  settle();
  EXPECT_EQ(received_of("t"), numbers(1, 5));
}

}  // namespace
}  // namespace slamgw
