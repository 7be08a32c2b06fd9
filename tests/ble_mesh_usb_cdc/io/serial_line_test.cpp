// SPDX-License-Identifier: Apache-2.0
// A line over a pseudo-terminal: calls that wait in the kernel never block the loop.
#include "adapters/ble_mesh_usb_cdc/io/serial_line.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <stdlib.h>
#include <sys/resource.h>
#include <unistd.h>

#include <string>
#include <vector>

#include "tests/ble_mesh_usb_cdc/hex.hpp"
#include "tests/ble_mesh_usb_cdc/io/slow_port.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

class SerialLineTest : public ::testing::Test {
 protected:
  SerialLineTest() {
    ::grantpt(master);
    ::unlockpt(master);
    settings.device = ::ptsname(master);
    line.emplace(io, open_slowly(settings, gates), callbacks());
    tick();
  }
  ~SerialLineTest() override {
    gates->opening.open();
    gates->setting_dtr.open();
    gates->closing.open();
    line.reset();
    if (master >= 0) ::close(master);
  }

  SerialLine::Callbacks callbacks() {
    return {
        .on_open = [this] { ++opened; },
        .on_bytes =
            [this](ByteView bytes) { received.insert(received.end(), bytes.begin(), bytes.end()); },
        .on_failed = [this](const std::string& why) { failures.push_back(why); },
        .on_open_stuck = [this](const std::string& why) { stuck.push_back("open: " + why); },
        .on_close_stuck = [this](const std::string& why) { stuck.push_back("close: " + why); }};
  }
  void tick() {
    ticker.expires_after(1ms);
    ticker.async_wait([this](boost::system::error_code) {
      ++ticks;
      tick();
    });
  }
  bool eventually(const std::function<bool()>& condition) {
    const auto limit = std::chrono::steady_clock::now() + 20s;
    while (!condition() && std::chrono::steady_clock::now() < limit) io.run_one_for(20ms);
    return condition();
  }
  /// Returns true if the loop runs while a call waits at `gate`.
  bool runs_while_call_waits(const Gate& gate) {
    if (!eventually([&] { return gate.has_waiting_call(); })) return false;
    const int before = ticks;
    return eventually([&] { return ticks >= before + 50; }) && gate.has_waiting_call();
  }
  /// Returns all octets that have reached the other end.
  Bytes read_at_board() {
    std::array<std::uint8_t, 64> octets{};
    const ssize_t count = ::read(master, octets.data(), octets.size());
    if (count > 0) at_board.insert(at_board.end(), octets.begin(), octets.begin() + count);
    return at_board;
  }
  void open() {
    line->open();
    ASSERT_TRUE(eventually([&] { return opened == 1; }));
  }

  boost::asio::io_context io;
  int master = ::posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
  Settings settings;
  std::shared_ptr<Gates> gates = std::make_shared<Gates>();
  std::optional<SerialLine> line;
  boost::asio::steady_timer ticker{io};
  int ticks = 0;
  int opened = 0;
  Bytes received;
  Bytes at_board;
  std::vector<std::string> failures;
  std::vector<std::string> stuck;
};

TEST_F(SerialLineTest, CarriesOctetsBothWays) {
  open();
  ASSERT_EQ(::write(master, "\x00\x0a\xff", 3), 3);
  EXPECT_TRUE(eventually([&] { return received == hex("00 0a ff"); }));
  line->write(hex("00 0d 11 13 ff"));
  EXPECT_TRUE(eventually([&] { return to_hex(read_at_board()) == "000d1113ff"; }));
}

TEST_F(SerialLineTest, LoopRunsWhilePortOpens) {
  gates->opening.shut();
  line->open();
  EXPECT_TRUE(runs_while_call_waits(gates->opening));
  gates->opening.open();
  EXPECT_TRUE(eventually([&] { return opened == 1; }));
}

TEST_F(SerialLineTest, LoopRunsWhileDtrIsSet) {
  gates->setting_dtr.shut();
  line->open();
  EXPECT_TRUE(runs_while_call_waits(gates->setting_dtr));
  gates->setting_dtr.open();
  EXPECT_TRUE(eventually([&] { return opened == 1; }));
}

TEST_F(SerialLineTest, LoopRunsWhilePortClosesAndOpensAgain) {
  open();
  gates->closing.shut();
  line->close();
  line->open();
  EXPECT_TRUE(runs_while_call_waits(gates->closing));
  EXPECT_EQ(opened, 1) << "not before the first port is closed";
  gates->closing.open();
  EXPECT_TRUE(eventually([&] { return opened == 2; }));
}

TEST_F(SerialLineTest, ReportsOnceThatPortDoesNotClose) {
  open();
  gates->closing.shut();
  line->close();
  ASSERT_TRUE(eventually([&] { return !stuck.empty(); }));
  EXPECT_EQ(stuck[0].find("close: the serial board takes no data"), 0u) << stuck[0];
  gates->closing.open();
  line->open();
  EXPECT_TRUE(eventually([&] { return opened == 2; }));
  EXPECT_EQ(stuck.size(), 1u);
  EXPECT_TRUE(failures.empty());
}

TEST_F(SerialLineTest, StopDoesNotWaitForPortThatDoesNotClose) {
  open();
  gates->closing.shut();
  line->stop();
  EXPECT_TRUE(gates->closing.has_waiting_call()) << "stop() returned first";
  const int before = opened;
  gates->closing.open();
  const int start = ticks;
  ASSERT_TRUE(eventually([&] { return ticks >= start + 50; }));
  EXPECT_EQ(opened, before);
}

TEST_F(SerialLineTest, StopDoesNotWaitForPortThatDoesNotOpen) {
  gates->opening.shut();
  line->open();
  ASSERT_TRUE(eventually([&] { return gates->opening.has_waiting_call(); }));
  line->stop();
  EXPECT_TRUE(gates->opening.has_waiting_call());
  line.reset();
  gates->opening.open();
  const int start = ticks;
  ASSERT_TRUE(eventually([&] { return ticks >= start + 50; }));
  EXPECT_EQ(opened, 0);
}

TEST_F(SerialLineTest, FailsWhenTheBoardTakesNoData) {
  open();
  for (int i = 0; i < 40; ++i) line->write(Bytes(1024, 0x55));
  ASSERT_EQ(failures.size(), 1u);
  EXPECT_NE(failures[0].find("takes no data"), std::string::npos);
}

TEST_F(SerialLineTest, FailsWhenTheBoardIsGone) {
  open();
  ::close(std::exchange(master, -1));
  ASSERT_TRUE(eventually([&] { return !failures.empty(); }));
  EXPECT_NE(failures[0].find("is gone"), std::string::npos);
  line->open();
  ASSERT_TRUE(eventually([&] { return failures.size() == 2; })) << "its device node is gone, too";
}

TEST_F(SerialLineTest, FailsWhenTooManyFilesAreOpen) {
  rlimit usual{};
  ASSERT_EQ(::getrlimit(RLIMIT_NOFILE, &usual), 0);
  const int lowest_free = ::dup(master);
  ::close(lowest_free);
  const rlimit full{static_cast<rlim_t>(lowest_free), usual.rlim_max};
  ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &full), 0);
  line->open();
  EXPECT_TRUE(eventually([&] { return !failures.empty(); }));
  ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &usual), 0);
  EXPECT_EQ(failures, std::vector<std::string>{"the serial board can't be opened: too many open "
                                               "files or threads"});
  open();
}

TEST_F(SerialLineTest, WritesPendingOctetsBeforeClose) {
  open();
  line->write(hex("01 09"));
  line->close();
  EXPECT_TRUE(eventually([&] { return to_hex(read_at_board()) == "0109"; }));
}

TEST_F(SerialLineTest, ReadsAheadOnlyUpToItsBound) {
  open();
  const Bytes block(4096, 0x55);
  std::size_t written = 0;
  // The loop does not run here; the line reads ahead up to its bound, then the terminal fills up.
  for (int idle = 0; idle < 50;) {
    const ssize_t count = ::write(master, block.data(), block.size());
    written += count > 0 ? static_cast<std::size_t>(count) : 0;
    idle = count > 0 ? 0 : idle + 1;
    if (count <= 0) ::usleep(1000);
    ASSERT_LT(written, 4 * SerialLine::max_unread);
  }
  EXPECT_TRUE(eventually([&] { return received.size() == written; }));
}

TEST_F(SerialLineTest, WaitsForThePermissionsOfANewNode) {
  int attempts = 0;
  line.emplace(
      io,
      [&]() -> Result<std::unique_ptr<SerialPort>, OpenRefusal> {
        if (++attempts <= 3) return OpenRefusal{"only its owner may use it", true};
        return open_serial_port(settings);
      },
      callbacks());
  open();
  EXPECT_TRUE(failures.empty());
  EXPECT_EQ(attempts, 4);
}

TEST_F(SerialLineTest, ReportsPermissionsThatStayMissing) {
  line.emplace(
      io,
      []() -> Result<std::unique_ptr<SerialPort>, OpenRefusal> {
        return OpenRefusal{"only its owner may use it", true};
      },
      callbacks());
  line->open();
  ASSERT_TRUE(eventually([&] { return !failures.empty(); }));
  EXPECT_EQ(failures[0], "only its owner may use it");
}

}  // namespace
}  // namespace slamgw::ble
