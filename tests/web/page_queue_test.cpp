// SPDX-License-Identifier: Apache-2.0
// The queue of a page that reads slowly or not at all.
#include "web/server/page_queue.hpp"

#include <gtest/gtest.h>

#include "web/server/last_known.hpp"

namespace slamgw::web::test {
namespace {

SharedText text(std::string value) { return std::make_shared<const std::string>(std::move(value)); }

TEST(WebQueue, KeepsTheOrderOfEvents) {
  PageQueue queue;
  for (const char* word : {"a", "b", "c"}) queue.push_event(text(word));
  EXPECT_EQ(*queue.pop(), "a");
  EXPECT_EQ(*queue.pop(), "b");
  EXPECT_EQ(*queue.pop(), "c");
  EXPECT_EQ(queue.pop(), nullptr);
}

TEST(WebQueue, KeepsOnlyNewestValueOfState) {
  PageQueue queue;
  for (int i = 0; i < 1000; ++i) queue.push_state("stats", text(std::to_string(i)));
  queue.push_state("state", text("online"));
  EXPECT_EQ(*queue.pop(), "999");
  EXPECT_EQ(*queue.pop(), "online");
  EXPECT_EQ(queue.pop(), nullptr);
  queue.push_state("stats", text("new"));
  EXPECT_EQ(*queue.pop(), "new");
}

TEST(WebQueue, DropsOldestEventsAndReportsTheirNumber) {
  PageQueue queue;
  queue.push_state("state", text("online"));
  constexpr std::size_t size = 1000;
  constexpr std::size_t fitting = PageQueue::max_event_bytes / size;
  std::uint64_t dropped = 0;
  for (std::size_t i = 0; i < fitting + 10; ++i)
    dropped += queue.push_event(text(std::string(size - 3, 'x') + std::to_string(100 + i % 900)));
  EXPECT_EQ(dropped, 10u);
  EXPECT_EQ(*queue.pop(), R"({"topic":"$web/dropped","payload":{"messages":10}})");
  EXPECT_EQ(*queue.pop(), "online") << "a state is not dropped";
  EXPECT_TRUE(queue.pop()->ends_with("110")) << "the eleventh event is the oldest now";
  std::size_t left = 0;
  while (queue.pop()) ++left;
  EXPECT_EQ(left, fitting - 1);
}

TEST(WebQueue, ResetDropsWaitingStatesAndKeepsEvents) {
  PageQueue queue;
  queue.push_state("ghost", text("old"));
  queue.push_state("stats", text("old"));
  queue.push_event(text("event"));
  queue.reset("hello", text("hello"));
  queue.push_state("stats", text("new"));
  for (const char* expected : {"hello", "new", "event"}) EXPECT_EQ(*queue.pop(), expected);
  EXPECT_EQ(queue.pop(), nullptr);
}

TEST(WebQueue, ResetKeepsPast) {
  PageQueue queue;
  queue.push_state("ghost", text("old"));
  for (const char* topic : {"$web/past", "$web/past/r"}) queue.push_state(topic, text(topic));
  queue.reset("hello", text("hello"));
  EXPECT_EQ(queue.take(), "$web/past\n$web/past/r\nhello");
}

/// Topics that are published and withdrawn must not fill the memory.
TEST(WebQueue, RefusesNewStatesWhenFull) {
  PageQueue queue;
  const SharedText large = text(std::string(1000, 'x'));
  std::size_t number = 0;
  while (queue.push_state("topic" + std::to_string(number), large)) ASSERT_LT(++number, 100'000u);
  EXPECT_GT(number, LastKnown::max_topics) << "all known topics fit";
  EXPECT_TRUE(queue.push_state("topic0", large)) << "a waiting state may be replaced";
  for (int i = 0; i < 5; ++i) EXPECT_EQ(queue.pop(), large);
  EXPECT_TRUE(queue.push_state("new", large));
}

TEST(WebQueue, TakesWaitingMessagesTogetherOnePerLine) {
  PageQueue queue;
  EXPECT_EQ(queue.take(), "");
  queue.push_event(text("event"));
  queue.push_state("state", text("online"));
  EXPECT_EQ(queue.take(), "online\nevent");
  EXPECT_EQ(queue.take(), "");
}

TEST(WebQueue, TakesBoundedBatch) {
  PageQueue queue;
  constexpr std::size_t size = 1000;
  for (int i = 0; i < 200; ++i) queue.push_event(text(std::string(size, 'x')));
  const std::string first = queue.take();
  EXPECT_GE(first.size(), PageQueue::enough_bytes);
  EXPECT_LT(first.size(), PageQueue::enough_bytes + size + 1);
  std::size_t octets = first.size();
  for (std::string next = queue.take(); !next.empty(); next = queue.take()) octets += next.size();
  EXPECT_GT(octets, 200 * size);
}

TEST(WebQueue, PassesSingleEventBeyondItsBound) {
  PageQueue queue;
  queue.push_event(text(std::string(PageQueue::max_event_bytes * 2, 'x')));
  EXPECT_EQ(queue.pop()->size(), PageQueue::max_event_bytes * 2);
}

}  // namespace
}  // namespace slamgw::web::test
