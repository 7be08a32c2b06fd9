// SPDX-License-Identifier: Apache-2.0
// The resources that a process has used so far, from /proc.
#pragma once

#include <sys/types.h>

#include <cstdint>

namespace slamgw::bench {

struct ProcessUsage {
  double cpu_s = 0;                    ///< of all threads that live
  std::uint64_t context_switches = 0;  ///< voluntary and not, all threads that live
  std::uint64_t rss_kib = 0;
};

/// Returns zeros when there is no such process.
ProcessUsage usage_of(pid_t process);
/// Returns the CPU time of main()'s thread: the daemon's loop, without the MQTT client's threads.
double first_thread_cpu_s(pid_t process);

}  // namespace slamgw::bench
