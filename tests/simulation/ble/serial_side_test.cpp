// SPDX-License-Identifier: Apache-2.0
// The built program behind a real pty: signals that power-cycle and restart the board, and the
// state that survives.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>

#include "tests/simulation/ble/mesh_host.hpp"
#include "tests/simulation/hex.hpp"
#include "tests/support/child_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::sim {
namespace {

namespace fs = std::filesystem;
using test::eventually;

const std::vector<std::string> board_storage{"--board-storage"};

class SerialSideTest : public ::testing::Test {
 protected:
  ~SerialSideTest() override { hang_up(); }

  void begin(const std::vector<std::string>& more = {}, const std::string& robots = "3") {
    std::vector<std::string> arguments{SLAMGW_SIM, "ble",  "--tty",           link_,
                                       "--robots", robots, "--unprovisioned", "--state",
                                       state_};
    arguments.insert(arguments.end(), more.begin(), more.end());
    program_.emplace(arguments, directory_ / "out", directory_ / "err");
    ASSERT_TRUE(eventually([&] { return fs::is_symlink(link_); }));
  }
  void open_port() {
    hang_up();
    heard_.clear();
    ASSERT_TRUE(eventually([&] {
      port_ = ::open(link_.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK);
      return port_ >= 0;
    }));
  }
  void hang_up() {
    if (port_ >= 0) ::close(port_);
    port_ = -1;
  }
  void read_some() {
    std::uint8_t buffer[256];
    const ssize_t size = ::read(port_, buffer, sizeof buffer);
    if (size > 0) put(heard_, ByteView(buffer).first(static_cast<std::size_t>(size)));
  }
  /// Waits until the octets read since the last command, or since the port was opened, contain
  /// this.
  bool hears(const std::string& octets) {
    return eventually([&] {
      read_some();
      return to_hex(heard_).find(octets) != std::string::npos;
    });
  }
  bool hears_octets(std::size_t count) {
    return eventually([&] {
      read_some();
      return heard_.size() >= count;
    });
  }
  bool answers(std::string_view command, const std::string& answer) {
    const Bytes octets = hex(command);
    heard_.clear();
    const bool is_heard = ::write(port_, octets.data(), octets.size()) > 0 && hears(answer);
    EXPECT_TRUE(is_heard) << to_hex(heard_);
    return is_heard;
  }
  /// Repeats the request until the board answers; other packets stay in `heard_`.
  bool forgets_its_address() {
    const Bytes octets = hex("01 a0");
    if (::write(port_, octets.data(), octets.size()) < 0) return false;
    read_some();
    return to_hex(heard_).find("07 84 a0 00 00 00 00 00") != std::string::npos;
  }
  void power_cycle(const std::vector<std::string>& more = {}) {
    begin(more);
    open_port();
    ASSERT_TRUE(answers("05 9f 01 00 01 00", "03 84 9f 00"));
    program_->send_signal(SIGUSR1);
    ASSERT_TRUE(eventually([&] { return !fs::is_symlink(link_); }));
    EXPECT_TRUE(has_hung_up());
    program_->send_signal(SIGUSR1);  // the board is unplugged already
    open_port();
    ASSERT_TRUE(hears("04 81 02 00 fe"));
  }
  bool has_hung_up() const {
    pollfd state{port_, POLLIN, 0};
    return ::poll(&state, 1, 0) == 1 && (state.revents & POLLHUP) != 0;
  }
  std::string saved() const { return test::read_file(state_); }

  test::TempDir directory_;
  std::string link_ = directory_ / "board";
  std::string state_ = directory_ / "state";
  std::optional<test::ChildProcess> program_;
  int port_ = -1;
  Bytes heard_;
};

/// After the first restart the board sends no start event. After the second one its last packet is
/// cut, and the start event looks like its rest.
TEST_F(SerialSideTest, RestartsTheBoardBehindAnOpenPort) {
  begin();
  open_port();
  ASSERT_TRUE(hears("04 81 02 00 fe"));
  ASSERT_TRUE(answers("05 9f 01 00 01 00", "03 84 9f 00"));
  program_->send_signal(SIGUSR2);
  ASSERT_TRUE(eventually([&] { return forgets_its_address(); }));
  EXPECT_EQ(to_hex(heard_).find("81 02 00 fe"), std::string::npos);
  ASSERT_TRUE(answers("01 09", "05 84 09 00 0a 00"));
  program_->send_signal(SIGUSR2);
  ASSERT_TRUE(hears("05 84 09 04 81 02 00 fe"));
  heard_.clear();
  program_->send_signal(SIGUSR2);
  ASSERT_TRUE(hears("04 81 02 00 fe"));
  EXPECT_EQ(to_hex(heard_), "04 81 02 00 fe");
}

TEST_F(SerialSideTest, PowerCyclesAStockBoardWhichForgets) {
  power_cycle();
  EXPECT_TRUE(answers("01 a0", "07 84 a0 00 00 00 00 00"));
}

TEST_F(SerialSideTest, PowerCyclesABoardWithStorageWhichDoesNotForget) {
  power_cycle(board_storage);
  EXPECT_TRUE(answers("01 a0", "07 84 a0 00 01 00 01 00"));
}

TEST_F(SerialSideTest, KeepsNoStateOfAStockBoard) {
  begin();
  open_port();
  ASSERT_TRUE(answers("05 9f 23 01 01 00", "03 84 9f 00"));
  program_->send_signal(SIGTERM);
  EXPECT_EQ(program_->wait(), 0);
  EXPECT_NE(saved().find("\"nodes\""), std::string::npos);
  EXPECT_EQ(saved().find("\"board\""), std::string::npos);
}

TEST_F(SerialSideTest, KeepsItsStateThroughACrash) {
  begin(board_storage);
  open_port();
  ASSERT_TRUE(answers("05 9f 23 01 01 00", "03 84 9f 00"));
  ASSERT_TRUE(eventually([&] { return saved().find("\"start\": 291") != std::string::npos; }));
  program_->send_signal(SIGKILL);
  program_->wait();
  fs::remove(link_);
  begin(board_storage);
  open_port();
  EXPECT_TRUE(answers("01 a0", "07 84 a0 00 23 01 01 00"));
  ASSERT_TRUE(answers("01 ac", "03 84 ac 00"));
  program_->send_signal(SIGTERM);
  EXPECT_EQ(program_->wait(), 0);
  EXPECT_NE(saved().find("\"start\": 0"), std::string::npos);
}

TEST_F(SerialSideTest, ReadsWhileTheHostWrites) {
  begin({"--baud", "0"});  // a slower line would make the board drop answers
  open_port();
  const Bytes zeros(255, 0);
  ASSERT_EQ(::write(port_, zeros.data(), zeros.size()), 255);
  ASSERT_TRUE(hears_octets(255 * 4));
  EXPECT_TRUE(answers("01 14", "07 84 14 00 00 00 00 00"));
}

/// A robot with ten subscriptions fails an assertion when all are deleted at once.
TEST_F(SerialSideTest, ExitsWith3AfterRobotFailedAssertion) {
  BleOptions options = ble::MeshHost::unprovisioned();
  options.has_board_storage = true;
  ble::MeshHost host(options);
  host.adopt(0x0100);
  for (int group = 0; group < 10; ++group) {
    host.ask("80 1b 00 01 0" + std::to_string(group) + "c1 59 00 09 00");
  }
  test::write_file(state_, ble::state_of(host.network()));
  begin(board_storage, "1");
  open_port();
  ASSERT_TRUE(answers("13 ab 08 00 01 00 00 00 04 00 00 00 80 1d 00 01 59 00 09 00", "84 ab 00"));
  EXPECT_TRUE(eventually([&] {
    return test::read_file(directory_ / "err").find("robot1 has failed an assertion and is gone") !=
           std::string::npos;
  }));
  program_->send_signal(SIGTERM);
  EXPECT_EQ(program_->wait(), 3);
  const std::string summary = test::read_file(directory_ / "out");
  EXPECT_NE(summary.find(R"("failed_assertions":1)"), std::string::npos) << summary;
}

TEST_F(SerialSideTest, RefusesInvalidStateFile) {
  test::write_file(state_, "{}");
  program_.emplace(std::vector<std::string>{SLAMGW_SIM, "ble", "--tty", link_, "--state", state_,
                                            "--board-storage"});
  EXPECT_EQ(program_->wait(), 1);
  EXPECT_EQ(saved(), "{}");
}

}  // namespace
}  // namespace slamgw::sim
