// SPDX-License-Identifier: Apache-2.0
// The order in which messages of several robots go to the broker.
#include "daemon/delivery/fair_queue.hpp"

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "tests/delivery/outbox_rig.hpp"

namespace slamgw {
namespace {

OutboxItem item(const std::string& topic, std::uint64_t row) {
  OutboxItem made;
  made.row = row;
  made.message.topic = topic;
  return made;
}

std::vector<std::string> take_topics(FairQueue& queue) {
  std::vector<std::string> topics;
  while (const OutboxItem* const next = queue.front()) {
    topics.push_back(next->message.topic);
    queue.take_front();
  }
  return topics;
}

TEST(FairQueue, FlowsTakeTurnsAndEachKeepsItsOrder) {
  FairQueue queue;
  for (const char* topic : {"r/1/a", "r/1/b", "r/1/a", "r/2/a", "r/3/a", "r/2/b"})
    queue.enqueue(queue.add(item(topic, queue.items().size() + 1)));
  const std::vector<std::string> expected{"r/1/a", "r/2/a", "r/3/a", "r/1/b", "r/2/b", "r/1/a"};
  EXPECT_EQ(take_topics(queue), expected);
  EXPECT_FALSE(queue.front());
  EXPECT_EQ(queue.items().size(), 6u) << "they are under way";
}

TEST(FairQueue, RequeuesMessagesInTheOrderOfTheirRows) {
  FairQueue queue;
  for (std::uint64_t row = 1; row <= 4; ++row)
    queue.enqueue(queue.add(item("r/1/" + std::to_string(row), row)));
  OutboxItem& first = *queue.front();
  queue.take_front();
  queue.set_aside(*queue.front());
  queue.enqueue(first);
  queue.for_each_aside([&](OutboxItem& aside) { queue.enqueue(aside); });
  queue.renumber(10);
  EXPECT_EQ(queue.find(11), &first);
  EXPECT_EQ(take_topics(queue), (std::vector<std::string>{"r/1/1", "r/1/2", "r/1/3", "r/1/4"}));
}

TEST(FairQueue, CountsTheBytesOfEachFlow) {
  FairQueue queue;
  queue.enqueue(queue.add(item("r/1/a", 1)));
  queue.enqueue(queue.add(item("r/1/bb", 2)));
  queue.enqueue(queue.add(item("r/2/a", 3)));
  const std::size_t both = item("r/1/a", 0).cost() + item("r/1/bb", 0).cost();
  EXPECT_EQ(queue.bytes_in_flow("r/1/other"), both);
  queue.erase(*queue.find(1));
  queue.erase(*queue.find(3));
  EXPECT_EQ(queue.bytes_in_flow("r/1/a"), item("r/1/bb", 0).cost());
  EXPECT_EQ(take_topics(queue), std::vector<std::string>{"r/1/bb"})
      << "a flow whose messages are gone has no turn";
  EXPECT_EQ(queue.bytes_in_flow("r/1/a"), 0u);
}

class FloodTest : public testing::Test, public test::OutboxRig {};

TEST_F(FloodTest, DelaysAnotherRobotOnlyByMessagesUnderWay) {
  link_up();
  for (int i = 0; i < 1000; ++i) submit("robot/1/update", 0, Qos::at_most_once);
  submit("robot/2/update", 7, Qos::at_most_once);
  published_topics.clear();
  while (published_topics.empty()) acknowledge_first();
  ASSERT_GE(published_topics.size(), 2u);
  EXPECT_EQ(published_topics[0], "robot/1/update");
  EXPECT_EQ(published_topics[1], "robot/2/update");
}

TEST_F(FloodTest, IsPublishedInBatchesOnceItsWindowIsFull) {
  link_up();
  constexpr std::size_t most = PublishWindow::max_unacknowledged;
  for (std::size_t i = 0; i < 10 * most; ++i) submit("robot/1/update", 0, Qos::at_most_once);
  ASSERT_EQ(under_way.size(), most);
  for (std::size_t written = 1; written < most / 2; ++written) acknowledge_first();
  EXPECT_EQ(under_way.size(), most / 2 + 1) << "no more are published yet";
  acknowledge_first();
  EXPECT_EQ(under_way.size(), most);
}

TEST_F(FloodTest, LeavesRoomForOtherRobots) {
  link_up();
  std::uint64_t receipt = 0;
  const Bytes large(64u << 10);
  while (outbox->statistics().refused == 0) submit_bytes("robot/1/update", large, ++receipt);
  EXPECT_LE(outbox->queued_bytes(), Outbox::max_queued_bytes / 2 + (2u << 20));
  EXPECT_GE(outbox->queued_bytes(), Outbox::max_queued_bytes / 2 - (2u << 20));
  const std::uint64_t refused = receipt;
  EXPECT_TRUE(has_fired(refused, ReceiptOutcome::refused));
  for (int robot = 2; robot < 50; ++robot)
    submit_bytes("robot/" + std::to_string(robot) + "/update", large, ++receipt);
  EXPECT_EQ(outbox->statistics().refused, 1u);
  acknowledge_all();
  for (std::uint64_t sent = 1; sent <= receipt; ++sent)
    EXPECT_EQ(has_fired(sent, ReceiptOutcome::safe), sent != refused) << sent;
}

}  // namespace
}  // namespace slamgw
