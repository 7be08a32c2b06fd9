// SPDX-License-Identifier: Apache-2.0
// Timer: when it calls, and that no call comes late.
#include "daemon/runtime/timer.hpp"

#include <gtest/gtest.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/post.hpp>
#include <optional>
#include <string>

namespace slamgw {
namespace {

using namespace std::chrono_literals;

class TimerTest : public testing::Test {
 protected:
  auto say(char what) {
    return [this, what] { said += what; };
  }
  boost::asio::io_context io;
  std::string said;
};

TEST_F(TimerTest, CallsInOrderOfTime) {
  Timer first(io), second(io);
  second.after(2ms, say('b'));
  first.at(std::chrono::steady_clock::now(), say('a'));
  io.run();
  EXPECT_EQ(said, "ab");
}

TEST_F(TimerTest, AnotherCallTakesThePlaceOfTheFirst) {
  Timer timer(io);
  timer.after(0ms, say('a'));
  timer.after(1ms, say('b'));
  io.run();
  EXPECT_EQ(said, "b");
}

/// Both handlers are queued when the first one runs, so Asio can no longer cancel the second.
TEST_F(TimerTest, ACancelledCallThatIsQueuedAlreadyDoesNotCome) {
  const auto due = std::chrono::steady_clock::now();
  Timer first(io), second(io);
  std::optional<Timer> third;
  third.emplace(io);
  first.at(due, [&] {
    said += 'a';
    second.cancel();
    third.reset();
  });
  second.at(due, say('b'));
  third->at(due, say('c'));
  io.run();
  EXPECT_EQ(said, "a");
}

TEST_F(TimerTest, RepeatsUntilItsFunctionCancelsIt) {
  Timer timer(io);
  timer.every(0ms, [&] {
    said += 'a';
    if (said.size() == 3) timer.cancel();
  });
  io.run();
  EXPECT_EQ(said, "aaa");
}

TEST_F(TimerTest, MayEndInItsOwnCall) {
  std::optional<Timer> timer;
  timer.emplace(io);
  timer->every(0ms, [&, word = std::string("a word that needs memory of its own")] {
    timer.reset();
    said += word.front();
  });
  io.run();
  EXPECT_EQ(said, "a");
}

}  // namespace
}  // namespace slamgw
