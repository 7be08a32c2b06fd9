// SPDX-License-Identifier: Apache-2.0
// The password prompt at a pseudo-terminal.
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

TEST(CtlTerminal, RestoresEchoAfterCtrlCAtPassword) {
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
    if (login_tty(dup(terminal)) == 0) ctl::read_password("robin");
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

/// Waits until the process stops or ends.
int status_of(pid_t process) {
  int status = 0;
  waitpid(process, &status, WUNTRACED);
  return status;
}

/// Runs in a session of its own, as a shell does: stops the program at its prompt, takes the
/// terminal back, then ends the program. Returns true if the program has ended by SIGTERM.
bool ends_in_the_background(int terminal) {
  const pid_t child = fork();
  if (child == 0) {
    setpgid(0, 0);
    std::signal(SIGTTOU, SIG_IGN);
    tcsetpgrp(STDIN_FILENO, getpid());
    std::signal(SIGTTOU, SIG_DFL);
    ctl::read_password("robin");
    _exit(0);
  }
  const auto is_silent = [terminal] {
    termios now{};
    return tcgetattr(terminal, &now) == 0 && (now.c_lflag & ECHO) == 0;
  };
  if (!eventually(is_silent)) return false;
  kill(child, SIGTSTP);
  if (!WIFSTOPPED(status_of(child))) return false;
  std::signal(SIGTTOU, SIG_IGN);
  tcsetpgrp(STDIN_FILENO, getpid());
  kill(child, SIGTERM);
  kill(child, SIGCONT);
  const int status = status_of(child);
  kill(child, SIGKILL);
  return WIFSIGNALED(status) && WTERMSIG(status) == SIGTERM;
}

TEST(CtlTerminal, EndsBySignalWhileInBackground) {
  int keyboard = -1;
  int terminal = -1;
  ASSERT_EQ(openpty(&keyboard, &terminal, nullptr, nullptr, nullptr), 0);
  const pid_t shell = fork();
  ASSERT_GE(shell, 0);
  if (shell == 0) _exit(login_tty(dup(terminal)) == 0 && ends_in_the_background(terminal) ? 0 : 1);
  EXPECT_EQ(status_of(shell), 0);
  close(keyboard);
  close(terminal);
}

}  // namespace
}  // namespace slamgw::test
