// SPDX-License-Identifier: Apache-2.0
#include "tests/support/child_process.hpp"

#include <fcntl.h>
#include <linux/close_range.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <stdexcept>

#include "tests/support/eventually.hpp"

namespace slamgw::test {
namespace {

void redirect(int descriptor, const std::string& path) {
  const char* target = path.empty() ? "/dev/null" : path.c_str();
  const int file = open(target, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  if (file >= 0) dup2(file, descriptor);
}

}  // namespace

ChildProcess::ChildProcess(const std::vector<std::string>& arguments, const std::string& out,
                           const std::string& err, bool inherits_descriptors) {
  std::vector<char*> argv;
  for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  pid_ = fork();
  if (pid_ < 0) throw std::runtime_error("fork failed");
  if (pid_ > 0) return;
  prctl(PR_SET_PDEATHSIG, SIGKILL);  // a crashed test leaves nothing behind
  redirect(STDOUT_FILENO, out);
  redirect(STDERR_FILENO, err);
  if (!inherits_descriptors) close_range(STDERR_FILENO + 1, ~0u, CLOSE_RANGE_CLOEXEC);
  execvp(argv[0], argv.data());
  _exit(127);
}

ChildProcess::~ChildProcess() {
  if (!is_running()) return;
  send_signal(SIGKILL);
  wait();
}

void ChildProcess::send_signal(int signal) {
  if (!status_) kill(pid_, signal);
}

bool ChildProcess::is_running() {
  if (status_) return false;
  int status = 0;
  if (waitpid(pid_, &status, WNOHANG) != pid_) return true;
  status_ = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return false;
}

std::optional<int> ChildProcess::wait(std::chrono::milliseconds limit) {
  eventually([this] { return !is_running(); }, limit);
  return status_;
}

}  // namespace slamgw::test
