// SPDX-License-Identifier: Apache-2.0
// Other programs of this host (tar, systemctl, journalctl ...), run one at a time and waited for.
#pragma once

#include <string>
#include <vector>

namespace slamgw::ctl {

struct ProgramResult {
  int status = 0;      ///< exit status; 127 when it could not be started; 128 + n for signal n
  std::string output;  ///< standard output and standard error, at most 4 MiB
};

/// `words[0]` is looked up in PATH. No shell; standard input is empty; messages are in English.
ProgramResult run_program(const std::vector<std::string>& words);

/// Its output. A Failure with it when the program does not end with status 0.
std::string run_or_fail(const std::vector<std::string>& words);

}  // namespace slamgw::ctl
