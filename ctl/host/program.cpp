// SPDX-License-Identifier: Apache-2.0
#include "ctl/host/program.hpp"

#include <fcntl.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>

#include "ctl/connection.hpp"

extern char** environ;

namespace slamgw::ctl {
namespace {

constexpr std::size_t max_output_bytes = std::size_t{4} << 20;
constexpr int exit_not_started = 127;  // as a shell says it
constexpr int exit_signal = 128;

/// What does not fit is read all the same: else the program would wait for ever.
std::string read_all(int pipe) {
  std::string output;
  std::array<char, 4096> chunk{};
  while (true) {
    const ssize_t count = read(pipe, chunk.data(), chunk.size());
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) return output;
    const std::size_t room = max_output_bytes - output.size();
    output.append(chunk.data(), std::min(room, static_cast<std::size_t>(count)));
  }
}

int wait_for(pid_t child) {
  int status = 0;
  while (waitpid(child, &status, 0) < 0)
    if (errno != EINTR) return exit_not_started;
  return WIFEXITED(status) ? WEXITSTATUS(status) : exit_signal + WTERMSIG(status);
}

}  // namespace

ProgramResult run_program(const std::vector<std::string>& words) {
  std::array<int, 2> pipe{};
  if (pipe2(pipe.data(), O_CLOEXEC) != 0) return {exit_not_started, std::strerror(errno)};
  setenv("LC_ALL", "C.UTF-8", 1);
  std::vector<char*> arguments;
  for (const std::string& word : words) arguments.push_back(const_cast<char*>(word.c_str()));
  arguments.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_adddup2(&actions, pipe[1], STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, pipe[1], STDERR_FILENO);
  pid_t child = 0;
  const int error =
      posix_spawnp(&child, arguments[0], &actions, nullptr, arguments.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  close(pipe[1]);
  ProgramResult result{exit_not_started, std::strerror(error)};
  if (error == 0) {
    result.output = read_all(pipe[0]);
    result.status = wait_for(child);
  }
  close(pipe[0]);
  return result;
}

std::string run_or_fail(const std::vector<std::string>& words) {
  ProgramResult result = run_program(words);
  if (result.status == 0) return std::move(result.output);
  throw Failure(words[0] + " failed (status " + std::to_string(result.status) +
                "): " + result.output);
}

}  // namespace slamgw::ctl
