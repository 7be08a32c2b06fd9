// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/process_usage.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <sstream>
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

/// proc(5): utime and stime are the 14th and 15th field; the 2nd, in brackets, may have spaces.
double cpu_seconds(const std::string& directory) {
  std::ifstream file(directory + "/stat");
  std::string line;
  std::getline(file, line);
  const std::size_t bracket = line.rfind(')');
  if (bracket == std::string::npos) return 0;
  std::istringstream fields(line.substr(bracket + 1));
  std::string skipped;
  for (int field = 3; field < 14; ++field) fields >> skipped;
  double user = 0;
  double system = 0;
  fields >> user >> system;
  return (user + system) / static_cast<double>(sysconf(_SC_CLK_TCK));
}

}  // namespace

ProcessUsage usage_of(pid_t process) {
  const std::string directory = fmt::format("/proc/{}", process);
  ProcessUsage usage;
  usage.cpu_s = cpu_seconds(directory);
  usage.rss_kib = status_field(directory + "/status", "VmRSS:");
  std::error_code gone;
  for (const auto& thread : std::filesystem::directory_iterator(directory + "/task", gone)) {
    const std::string status = thread.path() / "status";
    usage.context_switches += status_field(status, "voluntary_ctxt_switches:");
    usage.context_switches += status_field(status, "nonvoluntary_ctxt_switches:");
  }
  return usage;
}

double first_thread_cpu_s(pid_t process) {
  std::ifstream file(fmt::format("/proc/{0}/task/{0}/schedstat", process));
  double nanoseconds = 0;
  file >> nanoseconds;
  return nanoseconds / 1e9;
}

}  // namespace slamgw::bench
