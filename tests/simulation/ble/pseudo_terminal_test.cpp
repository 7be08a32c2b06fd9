// SPDX-License-Identifier: Apache-2.0
// The board's serial port on a real pty.
#include "simulation/ble/pseudo_terminal.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <system_error>

namespace slamgw::sim::ble {
namespace {

namespace fs = std::filesystem;

class PseudoTerminalTest : public ::testing::Test {
 protected:
  PseudoTerminalTest() {
    std::string name = "/tmp/slamgw-sim-XXXXXX";
    directory_ = mkdtemp(name.data());
    link_ = directory_ / "board";
  }
  ~PseudoTerminalTest() override { fs::remove_all(directory_); }

  fs::path directory_;
  fs::path link_;
};

TEST_F(PseudoTerminalTest, CarriesOctetsAsTheyAre) {
  PseudoTerminal terminal(link_);
  const int host = ::open(link_.c_str(), O_RDWR | O_NOCTTY);
  ASSERT_GE(host, 0);
  const char octets[] = {0x00, 0x03, 0x0a, 0x0d, 0x11, 0x13, 0x1a, 0x7f};
  ASSERT_EQ(::write(terminal.master(), octets, sizeof octets), 8);
  char read_back[16] = {};
  ASSERT_EQ(::read(host, read_back, sizeof read_back), 8);  // the octets are in the pty already
  EXPECT_EQ(std::string(read_back, 8), std::string(octets, 8));
  EXPECT_EQ(terminal.unread_octets(), 0);
  ::close(host);
}

TEST_F(PseudoTerminalTest, WorksWithoutHost) {
  PseudoTerminal terminal(link_);
  ::close(::open(link_.c_str(), O_RDWR | O_NOCTTY));
  char octet = 0;
  EXPECT_EQ(::read(terminal.master(), &octet, 1), -1);
  EXPECT_EQ(errno, EAGAIN);
  EXPECT_EQ(::write(terminal.master(), "x", 1), 1);
}

TEST_F(PseudoTerminalTest, ReplacesALinkAndRemovesItsOwn) {
  fs::create_symlink("/nowhere", link_);
  {
    PseudoTerminal terminal(link_);
    EXPECT_EQ(fs::read_symlink(link_), terminal.slave_name());
  }
  EXPECT_FALSE(fs::is_symlink(link_));
}

TEST_F(PseudoTerminalTest, DoesNotReplaceFile) {
  std::ofstream(link_) << "mine";
  EXPECT_THROW(PseudoTerminal{link_}, std::system_error);
  EXPECT_EQ(fs::file_size(link_), 4U);
}

TEST_F(PseudoTerminalTest, AcceptsNextHost) {
  PseudoTerminal terminal(link_);
  const int host = ::open(link_.c_str(), O_RDWR | O_NOCTTY);
  ASSERT_EQ(ioctl(host, TIOCEXCL), 0);
  ::close(host);
  terminal.allow_next_host();
  int is_exclusive = 1;
  const int next = ::open(link_.c_str(), O_RDWR | O_NOCTTY);
  ASSERT_GE(next, 0);
  ASSERT_EQ(ioctl(next, TIOCGEXCL, &is_exclusive), 0);
  EXPECT_EQ(is_exclusive, 0);
  ::close(next);
}

}  // namespace
}  // namespace slamgw::sim::ble
