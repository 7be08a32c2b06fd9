// SPDX-License-Identifier: Apache-2.0
#include "ctl/terminal.hpp"

#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#include <csignal>
#include <iostream>

#include "ctl/show.hpp"

namespace slamgw::ctl {

std::size_t terminal_columns(int descriptor) {
  constexpr std::size_t usual = 80;
  winsize size{};
  if (isatty(descriptor) != 1) return 0;
  const bool is_known = ioctl(descriptor, TIOCGWINSZ, &size) == 0 && size.ws_col > 0;
  return is_known ? size.ws_col : usual;
}

std::string fit_to_terminal(const std::string& text, int descriptor) {
  const std::size_t width = terminal_columns(descriptor);
  return width == 0 ? text : wrap(text, width);
}

LastLine::LastLine() : width_(terminal_columns(STDERR_FILENO)) {}

void LastLine::show(const std::string& text) {
  if (width_ == 0) return;
  std::cerr << "\r\033[K" << cut_end(text, width_ - 1) << std::flush;
  is_shown_ = true;
}

void LastLine::clear() {
  if (is_shown_) std::cerr << "\r\033[K" << std::flush;
  is_shown_ = false;
}

namespace {

termios echoing{};  ///< the terminal as it was, for the signal handler

/// Ends the program, but not with a silent terminal. In the background the terminal is the shell's,
/// and tcsetattr() would stop the program.
void restore_terminal(int signal) {
  if (tcgetpgrp(STDIN_FILENO) == getpgrp()) tcsetattr(STDIN_FILENO, TCSANOW, &echoing);
  std::signal(signal, SIG_DFL);
  std::raise(signal);
}

}  // namespace

std::string read_password(const std::string& user) {
  const bool is_terminal = tcgetattr(STDIN_FILENO, &echoing) == 0;
  if (is_terminal) {
    std::cerr << "password of " << user << ": " << std::flush;
    termios silent = echoing;
    silent.c_lflag &= ~static_cast<tcflag_t>(ECHO);
    for (const int end : {SIGINT, SIGTERM}) std::signal(end, restore_terminal);
    tcsetattr(STDIN_FILENO, TCSAFLUSH, &silent);
  }
  std::string password;
  std::getline(std::cin, password);
  if (is_terminal) {
    tcsetattr(STDIN_FILENO, TCSAFLUSH, &echoing);
    for (const int end : {SIGINT, SIGTERM}) std::signal(end, SIG_DFL);
    std::cerr << '\n';
  }
  return password;
}

}  // namespace slamgw::ctl
