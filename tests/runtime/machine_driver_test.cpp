// SPDX-License-Identifier: Apache-2.0
// The shell's half of a protocol machine: who is drained when, and that deadlines fire.
#include "daemon/runtime/machine_driver.hpp"

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "tests/support/eventually.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

struct Say {
  int number = 0;
};

/// Says each number that it is given, and "0" at its deadline.
class Echo {
 public:
  void on_number(int number) { actions_.push(Say{number}); }
  void on_deadline(const Now& now) {
    if (now.mono < *at) return;
    at.reset();
    on_number(0);
  }
  std::optional<std::variant<Say>> next_action() { return actions_.pop(); }
  std::optional<TimePoint> deadline() const { return at; }
  std::optional<TimePoint> at;

 private:
  ActionQueue<std::variant<Say>> actions_;
};

class MachineDriverTest : public testing::Test {
 protected:
  void tell(MachineDriver<Echo>& whom, int number) { whom->on_number(number); }
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
        const int number = std::get<Say>(action).number;
        EXPECT_EQ(++depth, 1);
        note("a" + std::to_string(number));
        tell(*to_second, number);
        --depth;
      },
      [&] { note("a is empty"); });
  MachineDriver<Echo> b(io, second, [&](auto& action) {
    const int number = std::get<Say>(action).number;
    EXPECT_EQ(++depth, 1);
    note("b" + std::to_string(number));
    if (number < 2) tell(a, number + 1);  // back to where it came from
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

/// As the core asks the fleet about a message while it takes it.
TEST_F(MachineDriverTest, DrainsAMachineThatIsAskedInsideAChangeAfterThatChange) {
  Echo first, second;
  MachineDriver<Echo>* to_first = nullptr;
  MachineDriver<Echo> b(io, second, [&](auto& action) {
    note("b" + std::to_string(std::get<Say>(action).number));
    tell(*to_first, 3);
  });
  MachineDriver<Echo> a(
      io, first, [&](auto& action) { note("a" + std::to_string(std::get<Say>(action).number)); });
  to_first = &a;
  {
    MachineDriver<Echo>::Input echo(a);
    tell(b, 1);
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
  io.run();  // nothing is left to wait for
  EXPECT_EQ(lines.size(), 2u);
}

TEST_F(MachineDriverTest, MayEndWhileItWaitsForItsTurn) {
  Echo first, second;
  auto b = std::make_unique<MachineDriver<Echo>>(io, second, [&](auto&) { note("b"); });
  MachineDriver<Echo> a(io, first, [&](auto&) {
    note("a");
    tell(*b, 1);
    b.reset();
  });
  tell(a, 1);
  EXPECT_EQ(lines, std::vector<std::string>{"a"});
}

}  // namespace
}  // namespace slamgw
