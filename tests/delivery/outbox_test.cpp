// SPDX-License-Identifier: Apache-2.0
// The outbox with a broker that comes and goes. More of the store in outbox_store_test.cpp.
#include "daemon/delivery/outbox.hpp"

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "tests/delivery/outbox_rig.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

class OutboxTest : public testing::Test, public test::OutboxRig {};

TEST_F(OutboxTest, FiresAReceiptOnlyWhenTheBrokerHasTheMessage) {
  link_up();
  submit("a", 1);
  EXPECT_TRUE(fired.empty());
  acknowledge_first();
  EXPECT_TRUE(has_fired(1, ReceiptOutcome::safe));
  EXPECT_EQ(depth(), 0u);
  EXPECT_EQ(outbox->queued_bytes(), 0u);
}

TEST_F(OutboxTest, ReportsStepsOfRobotsMessagesOnlyWhileTraced) {
  const auto submit_from_robot = [&](std::uint64_t receipt, Qos qos) {
    outbox->submit({"t", {1}, qos, false, Provenance{Mesh::ble, {}}}, {Mesh::ble, receipt}, now);
    drain();
  };
  link_up();
  submit_from_robot(1, Qos::at_least_once);
  acknowledge_all();
  EXPECT_TRUE(steps.empty()) << "nothing is traced";
  outbox->on_trace(true);
  outbox->submit({"own", {2}, Qos::at_least_once, false}, no_receipt, now);  // the gateway's own
  drain();
  submit_from_robot(3, Qos::at_least_once);
  acknowledge_all();
  ASSERT_EQ(steps.size(), 1u);
  EXPECT_EQ(steps[0].kind, StepKind::published);
  EXPECT_EQ(steps[0].receipt, (Receipt{Mesh::ble, 3}));
  link_down();
  submit_from_robot(4, Qos::at_least_once);
  serve_store();
  submit_from_robot(0, Qos::at_most_once);
  ASSERT_EQ(steps.size(), 2u);
  EXPECT_EQ(steps[1].kind, StepKind::stored);
  EXPECT_EQ(steps[1].receipt, (Receipt{Mesh::ble, 4}));
  now += 11s;
  outbox->on_deadline(now);
  drain();
  ASSERT_EQ(steps.size(), 3u);
  EXPECT_EQ(steps[2].kind, StepKind::refused);
  EXPECT_EQ(steps[2].qos, Qos::at_most_once);
}

/// The outbox checks the ages of all messages at most once a second.
TEST_F(OutboxTest, PublishesNoQos0MessageThatHasWaitedTooLong) {
  link_up();
  outbox->on_silence(true, now);
  submit("old", 0, Qos::at_most_once);
  now += 500ms;
  submit("t", 0, Qos::at_most_once);
  now += 9500ms;
  outbox->on_deadline(now);
  now += 600ms;
  outbox->on_silence(false, now);
  drain();
  EXPECT_TRUE(published_topics.empty());
  EXPECT_EQ(outbox->statistics().dropped, 2u);
}

TEST_F(OutboxTest, KeepsTheWindowAndTheOrder) {
  link_up();
  std::vector<std::string> expected;
  for (int i = 0; i < 40; ++i) {
    expected.push_back("t" + std::to_string(i));
    submit(expected.back(), static_cast<std::uint64_t>(i) + 1);
    EXPECT_LE(under_way.size(), 16u);
  }
  acknowledge_all();
  EXPECT_EQ(published_topics, expected);
  EXPECT_EQ(outbox->statistics().published, 40u);
}

/// A broker may publish a message of QoS 2 only when PUBREL comes.
TEST_F(OutboxTest, KeepsTheOrderOfATopicAcrossQos) {
  link_up();
  submit("t", 1, Qos::exactly_once);
  submit("t", 2, Qos::exactly_once);
  submit("t", 3);
  submit("t", 4, Qos::exactly_once);
  submit("t", 0, Qos::at_most_once);
  submit("other", 5);
  EXPECT_EQ(published_topics, (std::vector<std::string>{"t", "t", "other"}));
  acknowledge_quickest();
  acknowledge_first();
  EXPECT_EQ(under_way.size(), 1u);
  acknowledge_first();
  EXPECT_EQ(under_way.size(), 2u) << "3 and 4, but not the one after 4";
  link_down();
  link_up();
  serve_store();
  while (!under_way.empty()) acknowledge_quickest();
  EXPECT_EQ(received_of("t"), (std::vector<std::string>{"1", "2", "3", "4", "0"}));
  EXPECT_EQ(depth(), 0u);
}

/// The whole store may wait behind one unanswered message of QoS 2.
TEST_F(OutboxTest, ReadsNoMoreThanAPageForATopicThatWaits) {
  submit("t", 1, Qos::exactly_once);
  for (std::uint64_t i = 2; i <= 2000; ++i) submit("t", i);
  while (serve_store()) {
  }
  link_up();
  while (serve_store()) {
  }
  EXPECT_EQ(under_way.size(), 1u);
  EXPECT_LE(store.loads, 3u);
  settle();
  EXPECT_EQ(depth(), 0u);
  EXPECT_EQ(received_of("t").size(), 2000u);
}

TEST_F(OutboxTest, WithoutAStoreRefusesMessagesBehindARefusedOneOfTheirTopic) {
  outbox = std::make_unique<Outbox>(window, max_bytes);
  outbox->on_store_event(StoreAbsent{"no disk"}, now);
  drain();
  link_up();
  submit("t", 1, Qos::exactly_once);
  submit("t", 2);
  refuse_first();
  EXPECT_TRUE(has_fired(1, ReceiptOutcome::refused));
  EXPECT_TRUE(has_fired(2, ReceiptOutcome::refused));
}

TEST_F(OutboxTest, MakesDeadLettersOfMessagesBehindARefusedOneOfTheirTopic) {
  submit("t", 1, Qos::exactly_once);
  submit("t", 2);
  is_store_quick = true;
  drain();
  link_up();
  ASSERT_EQ(under_way.size(), 1u);
  refuse_first();
  EXPECT_EQ(store.dead_letters.size(), 2u);
}

TEST_F(OutboxTest, RespectsTheBrokersReceiveMaximum) {
  link_up(5);
  for (std::uint64_t i = 1; i <= 10; ++i) submit("t" + std::to_string(i), i);
  EXPECT_EQ(under_way.size(), 4u) << "one slot is left free";
}

TEST_F(OutboxTest, ARobotHasHalfOfTheWindowAtMost) {
  link_up();
  for (std::uint64_t i = 1; i <= 40; ++i) submit("r/1/" + std::to_string(i % 4), i);
  EXPECT_EQ(under_way.size(), window / 2);
  submit("r/1/unacknowledged", 0, Qos::at_most_once);
  submit("r/2/t", 41);
  submit("r/3/t", 42);
  EXPECT_EQ(under_way.size(), window / 2 + 2) << "other robots have their turns";
  EXPECT_EQ(published_topics.back(), "r/3/t");
  acknowledge_all();
  EXPECT_EQ(fired.size(), 42u);
  link_up(2);
  submit("r/1/t", 43);
  EXPECT_EQ(under_way.size(), 1u) << "a window of one";
}

TEST_F(OutboxTest, PublishesNothingBeforeTheStoreHasAnswered) {
  outbox = std::make_unique<Outbox>(window, max_bytes);
  link_up();
  submit("t", 1);
  submit("t", 0, Qos::at_most_once);
  EXPECT_TRUE(under_way.empty());
  outbox->on_store_event(StoreAbsent{}, now);
  drain();
  EXPECT_EQ(under_way.size(), 2u);
}

TEST_F(OutboxTest, WithoutAStoreRepublishesUnacknowledgedMessagesInOrder) {
  outbox->on_store_event(StoreAbsent{}, now);
  link_up();
  for (std::uint64_t i = 1; i <= 20; ++i) submit("t" + std::to_string(i), i);
  acknowledge_first();
  link_down();
  EXPECT_EQ(fired.size(), 1u) << "a lost link acknowledges nothing";
  EXPECT_FALSE(store.is_asked());
  published_topics.clear();
  link_up();
  acknowledge_all();
  ASSERT_EQ(published_topics.size(), 19u);
  EXPECT_EQ(published_topics.front(), "t2");
  EXPECT_EQ(published_topics.back(), "t20");
  EXPECT_EQ(fired.size(), 20u);
}

TEST_F(OutboxTest, IgnoresAnswersFromBeforeAReconnect) {
  link_up();
  submit("t", 1);
  const std::uint64_t old = under_way.front().sequence;
  link_down();
  outbox->on_published(old, now);
  drain();
  EXPECT_TRUE(fired.empty()) << "the broker may not have it: it is published again";
  EXPECT_EQ(outbox->unsaved(), 1u);
}

TEST_F(OutboxTest, StoresWhileTheBrokerIsAwayAndFiresReceiptsOnCommit) {
  submit("t", 1);
  EXPECT_TRUE(store.is_asked());
  EXPECT_TRUE(fired.empty());
  serve_store();
  EXPECT_TRUE(has_fired(1, ReceiptOutcome::safe));
  EXPECT_EQ(outbox->queued_bytes(), 0u) << "a stored message is not in memory";
  settle();
  EXPECT_TRUE(has_fired(1, ReceiptOutcome::safe)) << "and never again";
  EXPECT_EQ(received_of("t"), std::vector<std::string>{"1"});
  EXPECT_TRUE(store.rows.empty());
}

TEST_F(OutboxTest, WritesNothingToTheStoreWhileTheBrokerAcknowledges) {
  link_up();
  for (std::uint64_t i = 1; i <= 1000; ++i) {
    submit("t" + std::to_string(i % 7), i);
    pass(100ms);
    acknowledge_all();
  }
  EXPECT_FALSE(store.is_asked());
  submit("t", 2000);
  link_down();
  EXPECT_TRUE(store.is_asked()) << "messages under way are stored when the link is lost";
}

TEST_F(OutboxTest, DropsMessagesOfQos0ThatWaitedForTenSeconds) {
  submit("old", 0, Qos::at_most_once);
  pass(6s);
  submit("young", 0, Qos::at_most_once);
  pass(4s);
  EXPECT_EQ(outbox->statistics().dropped, 1u);
  link_up();
  EXPECT_EQ(published_topics, std::vector<std::string>{"young"});
  EXPECT_FALSE(store.is_asked());
}

TEST_F(OutboxTest, DeadlineAlwaysLiesAheadAfterItWasServed) {
  for (int i = 0; i < 50; ++i) {
    submit("t", 0, Qos::at_most_once);
    pass(500ms);  // checks the deadline
  }
  EXPECT_LE(depth(), 24u);
}

TEST_F(OutboxTest, DropsMessagesOfQos0UnderWayWhenTheConnectionIsLost) {
  link_up();
  submit("t", 0, Qos::at_most_once);
  link_down();
  EXPECT_EQ(outbox->statistics().dropped, 1u);
  EXPECT_EQ(depth(), 0u);
}

TEST_F(OutboxTest, RefusesMessagesBeyondItsMemoryBoundAndReportsThatOnce) {
  for (std::uint64_t i = 1; i <= 80; ++i) {  // and the store does not answer
    submit_bytes("t", Bytes(1 << 20, 0), i);
  }
  EXPECT_LE(outbox->queued_bytes(), Outbox::max_queued_bytes);
  EXPECT_TRUE(has_fired(80, ReceiptOutcome::refused));
  EXPECT_FALSE(fired.contains(1)) << "a queued message still waits for broker or store";
  EXPECT_EQ(outbox->statistics().refused, 80u - outbox->unsaved());
  EXPECT_EQ(notices.size(), 1u) << "reported once";
}

TEST_F(OutboxTest, SettlesWhenItStopsAndLeavesTheBacklogOnDisk) {
  for (std::uint64_t i = 1; i <= 100; ++i) submit("old", i);
  while (serve_store()) {
  }
  link_up();
  serve_store();
  submit("fresh", 200);
  outbox->on_stop(now);
  drain();
  EXPECT_FALSE(outbox->is_settled());
  acknowledge_all();
  while (serve_store()) {
  }
  EXPECT_TRUE(outbox->is_settled());
  EXPECT_EQ(store.rows.size() + received_of("old").size(), 100u) << "and no row twice";
  EXPECT_EQ(received_of("fresh").size(), 1u);
}

TEST_F(OutboxTest, StoresMessagesInMemoryWhenStoppedWhileTheBrokerIsSilent) {
  link_up();
  for (std::uint64_t i = 1; i <= 20; ++i) submit("t", i);
  outbox->on_stop(now);
  drain();
  pass(Outbox::stop_patience);
  while (serve_store()) {
  }
  EXPECT_EQ(store.rows.size(), 20u);
  EXPECT_EQ(fired.size(), 20u);
}

}  // namespace
}  // namespace slamgw
