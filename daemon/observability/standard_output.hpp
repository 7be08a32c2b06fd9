// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <fcntl.h>

#include <cerrno>
#include <cstring>
#include <iostream>

namespace slamgw {

/// Call first in main(). Opens each of the descriptors 0 to 2 that is closed, in a direction in
/// which its use still fails. Otherwise a socket or file gets its number, and the output.
inline void open_standard_descriptors() {
  for (int descriptor = 0; descriptor <= 2; ++descriptor)
    if (fcntl(descriptor, F_GETFD) < 0)  // open() takes the lowest free number
      open("/dev/null", descriptor == 0 ? O_WRONLY : O_RDONLY);
}

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
