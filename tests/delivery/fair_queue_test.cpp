// SPDX-License-Identifier: Apache-2.0
// Who waits behind whom for the broker.
#include "daemon/delivery/fair_queue.hpp"

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "tests/delivery/outbox_rig.hpp"

namespace slamgw {
namespace {

OutboxEntry entry(const std::string& topic, std::uint64_t order) {
  OutboxEntry made;
  made.order = order;
  made.message.topic = topic;
  return made;
}

std::vector<std::string> pop_topics(FairQueue& queue) {
  std::vector<std::string> topics;
  while (!queue.empty()) {
    const std::string turn = queue.front().message.topic;
    EXPECT_EQ(queue.pop().message.topic, turn);
    topics.push_back(turn);
  }
  return topics;
}

TEST(FairQueue, FlowsTakeTurnsAndEachKeepsItsOrder) {
  FairQueue queue;
  for (const char* topic : {"r/1/a", "r/1/b", "r/1/a", "r/2/a", "r/3/a", "r/2/b"})
    queue.push(entry(topic, queue.size() + 1));
  const std::vector<std::string> expected{"r/1/a", "r/2/a", "r/3/a", "r/1/b", "r/2/b", "r/1/a"};
  EXPECT_EQ(pop_topics(queue), expected);
}

TEST(FairQueue, GivesEverythingBackInTheOrderOfSubmission) {
  FairQueue queue;
  for (std::uint64_t order = 1; order <= 100; ++order)
    queue.push(entry("r/" + std::to_string(order % 7) + "/a", order));
  std::uint64_t expected = 0;
  for (const OutboxEntry& given : queue.take_all()) EXPECT_EQ(given.order, ++expected);
  EXPECT_EQ(expected, 100u);
  EXPECT_TRUE(queue.empty());
  EXPECT_EQ(queue.bytes_in_flow("r/1/a"), 0u);
}

TEST(FairQueue, CountsTheBytesOfEachFlow) {
  FairQueue queue;
  queue.push(entry("r/1/a", 1));
  queue.push(entry("r/1/bb", 2));
  queue.push(entry("r/2/a", 3));
  const std::size_t both = entry("r/1/a", 0).cost() + entry("r/1/bb", 0).cost();
  EXPECT_EQ(queue.bytes_in_flow("r/1/other"), both);
  queue.erase_if([](const OutboxEntry& e) { return e.order != 2; });
  EXPECT_EQ(queue.bytes_in_flow("r/1/a"), entry("r/1/bb", 0).cost());
  EXPECT_EQ(queue.size(), 1u);
  EXPECT_EQ(queue.pop().order, 2u) << "a flow whose messages are gone has no turn";
  EXPECT_TRUE(queue.empty());
}

class FloodTest : public testing::Test, public test::OutboxRig {};

TEST_F(FloodTest, DelaysAnotherRobotByWhatIsUnderWayOnly) {
  link_up();
  for (int i = 0; i < 1000; ++i) submit("robot/1/update", 0, Qos::at_most_once);
  submit("robot/2/update", 7, Qos::at_most_once);
  published_topics.clear();
  while (published_topics.empty()) acknowledge_first();
  ASSERT_GE(published_topics.size(), 2u);
  EXPECT_EQ(published_topics[0], "robot/1/update");
  EXPECT_EQ(published_topics[1], "robot/2/update");
}

TEST_F(FloodTest, IsHandedOverInBatchesOnceItIsHeldBack) {
  link_up();
  constexpr std::size_t most = PublishWindow::max_unacknowledged;
  for (std::size_t i = 0; i < 10 * most; ++i) submit("robot/1/update", 0, Qos::at_most_once);
  ASSERT_EQ(under_way.size(), most);
  for (std::size_t written = 1; written < most / 2; ++written) acknowledge_first();
  EXPECT_EQ(under_way.size(), most / 2 + 1) << "nothing came after them yet";
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
