// SPDX-License-Identifier: Apache-2.0
// The shell's half of a protocol machine: the order of draining, and deadlines.
#include "daemon/runtime/machine_driver.hpp"

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "tests/support/eventually.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

struct Emit {
  int number = 0;
};

/// Emits each number that it gets, and "0" at its deadline.
class Echo {
 public:
  void on_number(int number) { actions_.push(Emit{number}); }
  void on_deadline(const Now& now) {
    if (now.mono < *at) return;
    at.reset();
    on_number(0);
  }
  std::optional<std::variant<Emit>> next_action() { return actions_.pop(); }
  std::optional<TimePoint> deadline() const { return at; }
  std::optional<TimePoint> at;

 private:
  ActionQueue<std::variant<Emit>> actions_;
};

class MachineDriverTest : public testing::Test {
 protected:
  void send(MachineDriver<Echo>& driver, int number) { driver->on_number(number); }
  void note(const std::string& text) { lines.push_back(text); }

  boost::asio::io_context io;
  std::vector<std::string> lines;
  int depth = 0;
};

TEST_F(MachineDriverTest, DrainsMachinesOneAfterTheOtherNotInsideEachOther) {
  Echo first, second;
  MachineDriver<Echo>* to_second = nullptr;
  MachineDriver<Echo> a(
      io, first,
      [&](auto& action) {
        const int number = std::get<Emit>(action).number;
        EXPECT_EQ(++depth, 1);
        note("a" + std::to_string(number));
        send(*to_second, number);
        --depth;
      },
      [&] { note("a is empty"); });
  MachineDriver<Echo> b(io, second, [&](auto& action) {
    const int number = std::get<Emit>(action).number;
    EXPECT_EQ(++depth, 1);
    note("b" + std::to_string(number));
    if (number < 2) send(a, number + 1);  // back to its sender
    --depth;
  });
  to_second = &b;
  {
    MachineDriver<Echo>::Input echo(a);
    echo->on_number(1);
    echo->on_number(9);
  }
  EXPECT_EQ(lines, (std::vector<std::string>{"a1", "a9", "a is empty", "b1", "b9", "a2",
                                             "a is empty", "b2"}));
}

/// The core does this: it queries the fleet while it takes a message.
TEST_F(MachineDriverTest, DrainsAMachineThatGetsInputDuringAChangeAfterThatChange) {
  Echo first, second;
  MachineDriver<Echo>* to_first = nullptr;
  MachineDriver<Echo> b(io, second, [&](auto& action) {
    note("b" + std::to_string(std::get<Emit>(action).number));
    send(*to_first, 3);
  });
  MachineDriver<Echo> a(
      io, first, [&](auto& action) { note("a" + std::to_string(std::get<Emit>(action).number)); });
  to_first = &a;
  {
    MachineDriver<Echo>::Input echo(a);
    send(b, 1);
    note("changes");
    echo->on_number(2);
  }
  EXPECT_EQ(lines, (std::vector<std::string>{"changes", "b1", "a2", "a3"}));
}

TEST_F(MachineDriverTest, FiresDeadlinesUntilItIsStopped) {
  Echo echo;
  MachineDriver<Echo> driver(io, echo, [&](auto&) { note("fired"); });
  const auto arm = [&](Duration in) { driver->at = read_clocks().mono + in; };
  arm(1ms);
  EXPECT_TRUE(test::eventually(io, [&] { return lines.size() == 1; }));
  arm(1h);
  arm(1ms);  // earlier than the one that is armed
  EXPECT_TRUE(test::eventually(io, [&] { return lines.size() == 2; }));
  arm(1ms);
  driver.stop();
  io.restart();
  io.run();  // returns when nothing is pending
  EXPECT_EQ(lines.size(), 2u);
}

TEST_F(MachineDriverTest, MayBeDestroyedWhileItWaitsForItsTurn) {
  Echo first, second;
  auto b = std::make_unique<MachineDriver<Echo>>(io, second, [&](auto&) { note("b"); });
  MachineDriver<Echo> a(io, first, [&](auto&) {
    note("a");
    send(*b, 1);
    b.reset();
  });
  send(a, 1);
  EXPECT_EQ(lines, std::vector<std::string>{"a"});
}

}  // namespace
}  // namespace slamgw
