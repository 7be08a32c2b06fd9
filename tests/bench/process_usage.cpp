// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/process_usage.hpp"

#include <fmt/format.h>

#include <filesystem>
#include <fstream>
#include <string>

namespace slamgw::bench {
namespace {

/// The number after `key` in a status file.
std::uint64_t status_field(const std::string& path, const std::string& key) {
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with(key)) return std::stoull(line.substr(key.size()));
  }
  return 0;
}

/// proc(5): nanoseconds on a processor come first.
double on_processor_s(const std::string& directory) {
  std::ifstream file(directory + "/schedstat");
  double nanoseconds = 0;
  file >> nanoseconds;
  return nanoseconds / 1e9;
}

}  // namespace

ProcessUsage usage_of(pid_t process) {
  const std::string directory = fmt::format("/proc/{}", process);
  ProcessUsage usage;
  usage.rss_kib = status_field(directory + "/status", "VmRSS:");
  std::error_code gone;
  for (const auto& thread : std::filesystem::directory_iterator(directory + "/task", gone)) {
    const std::string status = thread.path() / "status";
    usage.cpu_s += on_processor_s(thread.path());
    usage.context_switches += status_field(status, "voluntary_ctxt_switches:");
    usage.context_switches += status_field(status, "nonvoluntary_ctxt_switches:");
  }
  return usage;
}

double first_thread_cpu_s(pid_t process) {
  return on_processor_s(fmt::format("/proc/{0}/task/{0}", process));
}

}  // namespace slamgw::bench
