// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cerrno>
#include <cstring>
#include <iostream>

namespace slamgw {

/// Call when everything is printed. Returns `status`; but if standard output could not be written,
/// says why on standard error and returns 1.
inline int end_output(const char* program, int status) {
  std::cout.exceptions(std::ios::goodbit);  // it must not throw here
  if (std::cout.flush()) return status;
  std::cerr << program
            << ": standard output: " << (errno == 0 ? "cannot be written" : std::strerror(errno))
            << '\n';
  return 1;
}

}  // namespace slamgw
