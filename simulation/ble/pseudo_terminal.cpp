// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/pseudo_terminal.hpp"

#include <fcntl.h>
#include <stdlib.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <filesystem>
#include <system_error>
#include <utility>

namespace slamgw::sim::ble {
namespace {

[[noreturn]] void fail(const std::string& what) {
  throw std::system_error(errno, std::generic_category(), what);
}

}  // namespace

PseudoTerminal::PseudoTerminal(std::string path) : path_(std::move(path)) {
  try {
    open();
    make_link();
  } catch (...) {
    close();
    throw;
  }
}

PseudoTerminal::~PseudoTerminal() {
  std::error_code error;
  if (std::filesystem::read_symlink(path_, error) == slave_name_) {
    std::filesystem::remove(path_, error);
  }
  close();
}

void PseudoTerminal::open() {
  master_ = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
  if (master_ < 0 || grantpt(master_) != 0 || unlockpt(master_) != 0) fail("cannot make a pty");
  std::array<char, 128> name{};
  if (ptsname_r(master_, name.data(), name.size()) != 0) fail("cannot make a pty");
  slave_name_ = name.data();
  slave_ = ::open(slave_name_.c_str(), O_RDWR | O_NOCTTY | O_CLOEXEC);
  if (slave_ < 0) fail("cannot open " + slave_name_);
  termios mode{};
  if (tcgetattr(slave_, &mode) != 0) fail("cannot set up " + slave_name_);
  cfmakeraw(&mode);
  cfsetspeed(&mode, B115200);
  if (tcsetattr(slave_, TCSANOW, &mode) != 0) fail("cannot set up " + slave_name_);
}

void PseudoTerminal::close() {
  if (slave_ >= 0) ::close(std::exchange(slave_, -1));
  if (master_ >= 0) ::close(std::exchange(master_, -1));
}

void PseudoTerminal::make_link() {
  std::error_code error;
  if (std::filesystem::is_symlink(path_, error)) std::filesystem::remove(path_, error);
  if (symlink(slave_name_.c_str(), path_.c_str()) != 0) fail("cannot make the link " + path_);
}

int PseudoTerminal::unread_octets() const {
  int octets = 0;
  return ioctl(slave_, FIONREAD, &octets) == 0 ? octets : 0;
}

void PseudoTerminal::allow_next_host() { ioctl(slave_, TIOCNXCL); }

}  // namespace slamgw::sim::ble
