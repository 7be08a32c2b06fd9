// SPDX-License-Identifier: Apache-2.0
// What slam-gatewayctl does on a terminal only: lines as wide as it is, a line that is written over
// while something is waited for, and a password that is typed unseen.
#pragma once

#include <cstddef>
#include <string>

namespace slamgw::ctl {

/// Of the terminal at this file descriptor; 0 where there is none.
std::size_t terminal_columns(int descriptor);
/// On a terminal its lines are no longer than it is wide (wrap); elsewhere as they are.
std::string fit_to_terminal(const std::string& text, int descriptor);

/// Standard error's last line, where that is a terminal. Leaves nothing behind.
class LastLine {
 public:
  LastLine();
  ~LastLine() { clear(); }
  LastLine(const LastLine&) = delete;
  LastLine& operator=(const LastLine&) = delete;

  void show(const std::string& text);
  void clear();

 private:
  std::size_t width_ = 0;  ///< 0: no terminal
  bool is_shown_ = false;
};

/// From the terminal, without an echo; from standard input where that is none.
std::string read_password(const std::string& user);

}  // namespace slamgw::ctl
