// SPDX-License-Identifier: Apache-2.0
// A password typed at a terminal of its own.
#include "ctl/terminal.hpp"

#include <gtest/gtest.h>
#include <pty.h>
#include <sys/wait.h>
#include <termios.h>
#include <unistd.h>
#include <utmp.h>

#include <csignal>

#include "tests/support/eventually.hpp"

namespace slamgw::test {
namespace {

TEST(CtlTerminal, EchoesAgainAfterCtrlCAtAPassword) {
  int keyboard = -1;
  int terminal = -1;
  ASSERT_EQ(openpty(&keyboard, &terminal, nullptr, nullptr, nullptr), 0);
  const auto echoes = [terminal] {
    termios now{};
    return tcgetattr(terminal, &now) == 0 && (now.c_lflag & ECHO) != 0;
  };
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    if (login_tty(dup(terminal)) == 0) ctl::read_password("somebody");
    _exit(0);
  }
  EXPECT_TRUE(eventually([&] { return !echoes(); }));
  EXPECT_EQ(write(keyboard, "\x03", 1), 1);
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFSIGNALED(status));
  EXPECT_EQ(WTERMSIG(status), SIGINT);
  EXPECT_TRUE(echoes());
  close(keyboard);
  close(terminal);
}

}  // namespace
}  // namespace slamgw::test
