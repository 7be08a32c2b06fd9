// SPDX-License-Identifier: Apache-2.0
// slam-gatewayctl on a terminal: lines that fit its width, a last line that is overwritten while
// the program waits, and a password that is typed without an echo.
#pragma once

#include <cstddef>
#include <string>

namespace slamgw::ctl {

/// Returns the width of the terminal at this file descriptor; 0 if it is not a terminal.
std::size_t terminal_columns(int descriptor);
/// Wraps lines that are longer than the terminal's width; without a terminal, changes nothing.
std::string fit_to_terminal(const std::string& text, int descriptor);

/// Standard error's last line, if standard error is a terminal. Clears the line at the end.
class LastLine {
 public:
  LastLine();
  ~LastLine() { clear(); }
  LastLine(const LastLine&) = delete;
  LastLine& operator=(const LastLine&) = delete;

  void show(const std::string& text);
  void clear();

 private:
  std::size_t width_ = 0;  ///< 0: not a terminal
  bool is_shown_ = false;
};

/// Reads a line from standard input; on a terminal, asks for it and does not echo it.
std::string read_password(const std::string& user);

}  // namespace slamgw::ctl
