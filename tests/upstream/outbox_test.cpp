// SPDX-License-Identifier: Apache-2.0
#include "daemon/upstream/outbox.hpp"

#include <gtest/gtest.h>

#include <map>
#include <set>
#include <string>
#include <vector>

namespace slamgw {
namespace {

using namespace std::chrono_literals;

/// A broker and a store with a state that tests read.
class OutboxTest : public testing::Test {
 protected:
  void submit(const std::string& topic, std::uint64_t receipt, Qos qos = Qos::at_least_once) {
    outbox.submit({topic, to_bytes("payload"), qos, false}, {Mesh::thread, receipt}, now);
    drain();
  }

  void drain() {
    while (auto action = outbox.next_action()) std::visit([this](auto& a) { perform(a); }, *action);
  }
  void perform(PublishAtBroker& publish) {
    under_way.push_back(publish.sequence);
    published_topics.push_back(publish.message.topic);
  }
  void perform(FireReceipt& fire) { fired[fire.receipt.id].push_back(fire.outcome); }
  void perform(KeepInStore& keep) { EXPECT_TRUE(store.insert(keep.sequence).second); }
  void perform(ForgetInStore& forget) { EXPECT_EQ(store.erase(forget.sequence), 1u); }

  void link_up(std::uint16_t receive_maximum = 65535) {
    outbox.on_link_up(receive_maximum, now);
    drain();
  }
  void link_down() {
    under_way.clear();
    outbox.on_link_down(now);
    drain();
  }
  void acknowledge_first() {
    outbox.on_published(under_way.front(), now);
    under_way.erase(under_way.begin());
    drain();
  }
  bool has_fired(std::uint64_t receipt, ReceiptOutcome outcome) {
    return fired[receipt] == std::vector{outcome};
  }

  TimePoint now{1h};
  Outbox outbox{16};
  std::vector<std::uint64_t> under_way;
  std::vector<std::string> published_topics;
  std::map<std::uint64_t, std::vector<ReceiptOutcome>> fired;
  std::set<std::uint64_t> store;
};

TEST_F(OutboxTest, FiresAReceiptOnlyWhenTheBrokerHasTheMessage) {
  link_up();
  submit("a", 1);
  EXPECT_TRUE(fired.empty());
  acknowledge_first();
  EXPECT_TRUE(has_fired(1, ReceiptOutcome::safe));
  EXPECT_EQ(outbox.depth(), 0u);
  EXPECT_EQ(outbox.queued_bytes(), 0u);
}

TEST_F(OutboxTest, KeepsTheWindowAndTheOrder) {
  link_up();
  std::vector<std::string> expected;
  for (int i = 0; i < 40; ++i) {
    expected.push_back("t" + std::to_string(i));
    submit(expected.back(), static_cast<std::uint64_t>(i) + 1);
    EXPECT_LE(under_way.size(), 16u);
  }
  while (!under_way.empty()) acknowledge_first();
  EXPECT_EQ(published_topics, expected);
  EXPECT_EQ(outbox.statistics().published, 40u);
}

TEST_F(OutboxTest, RespectsTheBrokersReceiveMaximum) {
  link_up(5);
  for (std::uint64_t i = 1; i <= 10; ++i) submit("t", i);
  EXPECT_EQ(under_way.size(), 4u) << "one slot is left free";
}

TEST_F(OutboxTest, PublishesAgainInOrderWhatWasUnderWay) {
  link_up();
  for (std::uint64_t i = 1; i <= 20; ++i) submit("t" + std::to_string(i), i);
  acknowledge_first();
  link_down();
  EXPECT_EQ(fired.size(), 1u) << "a lost link acknowledges nothing";
  published_topics.clear();
  link_up();
  while (!under_way.empty()) acknowledge_first();
  ASSERT_EQ(published_topics.size(), 19u);
  EXPECT_EQ(published_topics.front(), "t2");
  EXPECT_EQ(published_topics.back(), "t20");
  EXPECT_EQ(fired.size(), 20u);
}

TEST_F(OutboxTest, IgnoresAnswersFromBeforeAReconnect) {
  link_up();
  submit("t", 1);
  const std::uint64_t old = under_way.front();
  link_down();
  outbox.on_published(old, now);
  drain();
  EXPECT_TRUE(fired.empty()) << "the broker may not have it: it is published again";
  EXPECT_EQ(outbox.depth(), 1u);
}

TEST_F(OutboxTest, AsksTheStoreWhileTheBrokerIsAwayAndFiresOnCommit) {
  submit("t", 1);
  ASSERT_EQ(store.size(), 1u);
  EXPECT_TRUE(fired.empty());
  outbox.on_stored(*store.begin());
  drain();
  EXPECT_TRUE(has_fired(1, ReceiptOutcome::safe));
  link_up();
  acknowledge_first();
  EXPECT_TRUE(has_fired(1, ReceiptOutcome::safe)) << "and never again";
  EXPECT_TRUE(store.empty());
}

TEST_F(OutboxTest, TouchesNoStoreWhileTheBrokerIsThere) {
  link_up();
  submit("t", 1);
  acknowledge_first();
  EXPECT_TRUE(store.empty());
  submit("t", 2);
  link_down();
  EXPECT_EQ(store.size(), 1u) << "what was under way is kept when the link goes";
}

TEST_F(OutboxTest, KeepsUnacknowledgedMessagesNoLongerThanTenSeconds) {
  submit("old", 0, Qos::at_most_once);
  now += 6s;
  submit("young", 0, Qos::at_most_once);
  submit("kept", 1);
  now += 4s;
  ASSERT_TRUE(outbox.deadline());
  EXPECT_LE(*outbox.deadline(), now);
  outbox.on_deadline(now);
  link_up();
  EXPECT_EQ(published_topics, (std::vector<std::string>{"young", "kept"}));
  EXPECT_EQ(outbox.statistics().dropped, 1u);
}

TEST_F(OutboxTest, DeadlineAlwaysLiesAheadAfterItWasServed) {
  for (int i = 0; i < 50; ++i) {
    submit("t", 0, Qos::at_most_once);
    now += 500ms;
    if (outbox.deadline() && *outbox.deadline() <= now) {
      outbox.on_deadline(now);
      EXPECT_TRUE(!outbox.deadline() || *outbox.deadline() > now);
    }
  }
  EXPECT_LE(outbox.depth(), 24u);
}

TEST_F(OutboxTest, DropsUnacknowledgedMessagesThatWereUnderWay) {
  link_up();
  submit("t", 0, Qos::at_most_once);
  link_down();
  EXPECT_EQ(outbox.statistics().dropped, 1u);
  EXPECT_EQ(outbox.depth(), 0u);
}

TEST_F(OutboxTest, RefusesWhatItHasNoRoomForAndAcknowledgesNothing) {
  const Bytes large(1 << 20, 0);
  for (std::uint64_t i = 1; i <= 80; ++i) {
    outbox.submit({"t", large, Qos::at_least_once, false}, {Mesh::thread, i}, now);
    drain();
  }
  EXPECT_LE(outbox.queued_bytes(), Outbox::max_queued_bytes);
  EXPECT_TRUE(has_fired(80, ReceiptOutcome::refused));
  EXPECT_FALSE(fired.contains(1)) << "what is queued still waits for the broker";
  EXPECT_EQ(outbox.statistics().refused, 80u - outbox.depth());
}

TEST_F(OutboxTest, RefusesTheReceiptOfWhatTheBrokerWillNeverTake) {
  link_up();
  submit("t", 1);
  outbox.on_publish_refused(under_way.front(), now);
  drain();
  EXPECT_TRUE(has_fired(1, ReceiptOutcome::refused));
  EXPECT_EQ(outbox.depth(), 0u);
}

}  // namespace
}  // namespace slamgw
