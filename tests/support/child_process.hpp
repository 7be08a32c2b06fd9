// SPDX-License-Identifier: Apache-2.0
// A program started by a test; killed with its object.
#pragma once

#include <sys/types.h>

#include <chrono>
#include <optional>
#include <string>
#include <vector>

#include "tests/support/eventually.hpp"

namespace slamgw::test {

class ChildProcess {
 public:
  /// Starts `arguments[0]` (searched in PATH); standard output and error go to these files, or
  /// nowhere when empty.
  /// It inherits no other descriptor, because a socket in a child would keep its owner's connection
  /// open. `inherits_descriptors`: it inherits descriptors without FD_CLOEXEC.
  explicit ChildProcess(const std::vector<std::string>& arguments, const std::string& out = {},
                        const std::string& err = {}, bool inherits_descriptors = false);
  ~ChildProcess();
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  void send_signal(int signal);
  bool is_running();
  /// Returns the exit status once the program has ended (128 + signal when killed); nothing if it
  /// runs longer than `limit`.
  std::optional<int> wait(std::chrono::milliseconds limit = patience);
  pid_t pid() const { return pid_; }

 private:
  pid_t pid_ = -1;
  std::optional<int> status_;
};

}  // namespace slamgw::test
