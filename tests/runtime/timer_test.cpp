// SPDX-License-Identifier: Apache-2.0
// Timer: when it calls, and that no cancelled call comes.
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
  auto record(char what) {
    return [this, what] { calls += what; };
  }
  boost::asio::io_context io;
  std::string calls;
};

TEST_F(TimerTest, CallsInOrderOfTime) {
  Timer first(io), second(io);
  second.after(2ms, record('b'));
  first.at(std::chrono::steady_clock::now(), record('a'));
  io.run();
  EXPECT_EQ(calls, "ab");
}

TEST_F(TimerTest, NewCallReplacesTheFirst) {
  Timer timer(io);
  timer.after(0ms, record('a'));
  timer.after(1ms, record('b'));
  io.run();
  EXPECT_EQ(calls, "b");
}

/// Both handlers are queued when the first one runs, so Asio can no longer cancel the second.
TEST_F(TimerTest, DropsACancelledCallThatIsAlreadyQueued) {
  const auto due = std::chrono::steady_clock::now();
  Timer first(io), second(io);
  std::optional<Timer> third;
  third.emplace(io);
  first.at(due, [&] {
    calls += 'a';
    second.cancel();
    third.reset();
  });
  second.at(due, record('b'));
  third->at(due, record('c'));
  io.run();
  EXPECT_EQ(calls, "a");
}

TEST_F(TimerTest, RepeatsUntilItsFunctionCancelsIt) {
  Timer timer(io);
  timer.every(0ms, [&] {
    calls += 'a';
    if (calls.size() == 3) timer.cancel();
  });
  io.run();
  EXPECT_EQ(calls, "aaa");
}

TEST_F(TimerTest, MayBeDestroyedInItsOwnCall) {
  std::optional<Timer> timer;
  timer.emplace(io);
  timer->every(0ms, [&, text = std::string("a text that needs memory of its own")] {
    timer.reset();
    calls += text.front();
  });
  io.run();
  EXPECT_EQ(calls, "a");
}

}  // namespace
}  // namespace slamgw
