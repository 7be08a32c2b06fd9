// SPDX-License-Identifier: Apache-2.0
// Work that is put off to the end of the loop's present handler: when it is done, and in which
// order.
#include "daemon/runtime/loop_turn.hpp"

#include <gtest/gtest.h>

#include <string>

namespace slamgw {
namespace {

class LoopTurnTest : public testing::Test {
 protected:
  auto put_off(const std::string& text) {
    return [this, text] { turn.at_end([this, text] { done += text; }); };
  }

  boost::asio::io_context io{1};
  LoopTurn& turn = LoopTurn::of(io);
  std::string done;
};

TEST_F(LoopTurnTest, CallsTasksAfterTheHandlerInTheirOrder) {
  turn.run([this] {
    put_off("b")();
    put_off("c")();
    done += "a";
  });
  EXPECT_EQ(done, "abc");
}

TEST_F(LoopTurnTest, PostsTasksThatATaskPutsOff) {
  boost::asio::post(io, [this] {
    turn.run([this] { turn.at_end(put_off("c")); });
    done += "a";
  });
  boost::asio::post(io, [this] { done += "b"; });
  io.run();
  EXPECT_EQ(done, "abc");
}

TEST_F(LoopTurnTest, LeavesTasksOfInnerRunToTheOuterOne) {
  turn.run([this] {
    turn.run(put_off("b"));
    done += "a";
  });
  EXPECT_EQ(done, "ab");
}

TEST_F(LoopTurnTest, CallsTaskAfterAHandlerThatIsNotInATurn) {
  boost::asio::post(io, [this] {
    put_off("b")();
    done += "a";
  });
  boost::asio::post(io, [this] { done += "c"; });
  io.run();
  EXPECT_EQ(done, "acb");
}

}  // namespace
}  // namespace slamgw
