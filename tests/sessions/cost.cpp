// SPDX-License-Identifier: Apache-2.0
// session_cost SESSIONS PORT [5|3]: what robots' sessions cost at a broker on this host with that
// version of MQTT: time to attach all, memory of this process for each, processor time while idle,
// time until a second gateway has taken all over, time of a command from PUBLISH to its fence.
// Prints one line of JSON; asserts nothing.
#include <fmt/format.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <fstream>

#include "daemon/sessions/io/session_host.hpp"
#include "tests/support/eventually.hpp"

namespace slamgw::sessions {
namespace {

using std::chrono::duration;
using std::chrono::steady_clock;

double resident_kib() {
  std::ifstream file("/proc/self/statm");
  long size = 0;
  long resident = 0;
  file >> size >> resident;
  return static_cast<double>(resident * sysconf(_SC_PAGESIZE)) / 1024;
}

double processor_seconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& time) {
    return static_cast<double>(time.tv_sec) + static_cast<double>(time.tv_usec) / 1e6;
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

void raise_descriptor_limit() {
  rlimit limit{};
  getrlimit(RLIMIT_NOFILE, &limit);
  limit.rlim_cur = limit.rlim_max;
  setrlimit(RLIMIT_NOFILE, &limit);
}

/// Returns the seconds until `host` holds all of them.
double attach_all(boost::asio::io_context& io, SessionHost& host, int sessions) {
  const auto begin = steady_clock::now();
  for (int i = 0; i < sessions; ++i) {
    const std::string robot = fmt::format("robot-{}", i);
    host->subscribe(robot, "p/server/" + robot + "/+", Qos::at_least_once, false, read_clocks());
    host->on_heard(robot, read_clocks());
  }
  const auto all = static_cast<std::size_t>(sessions);
  if (!test::eventually(
          io, [&] { return host.sessions().held() == all; }, std::chrono::minutes{2}))
    std::fprintf(stderr, "only %zu of %d\n", host.sessions().held(), sessions);
  return duration<double>(steady_clock::now() - begin).count();
}

/// Returns the milliseconds from the command of each robot to the moment that the second gateway
/// may obey it.
std::vector<double> send_commands(boost::asio::io_context& io, const BrokerSettings& settings,
                                  int sessions, const std::size_t& taken) {
  std::vector<double> times;
  for (int i = 0; i < std::min(sessions, 100); ++i) {
    const std::size_t before = taken;
    const auto begin = steady_clock::now();
    const std::string publish =
        fmt::format("mosquitto_pub -p {} -q 1 -t p/server/robot-{}/run -m 1", settings.port, i);
    if (std::system(publish.c_str()) != 0) return times;
    if (!test::eventually(
            io, [&] { return taken > before; }, std::chrono::seconds{10}))
      continue;
    times.push_back(duration<double, std::milli>(steady_clock::now() - begin).count());
  }
  std::ranges::sort(times);
  return times;
}

void measure(int sessions, std::uint16_t port, MqttVersion version) {
  raise_descriptor_limit();
  boost::asio::io_context io{1};
  BrokerSettings settings;
  settings.port = port;
  std::size_t taken = 0;
  const auto make = [&] {
    return std::make_unique<SessionHost>(
        io, SessionNames(TopicScheme("p", "g")), [](const std::string&) { return false; },
        std::nullopt,
        [&](SessionHost::Report report) {
          if (std::holds_alternative<TakeMessage>(report)) ++taken;
          if (const auto* notice = std::get_if<Notice>(&report))
            std::fprintf(stderr, "%s\n", notice->text.c_str());
        });
  };
  const auto first = make();
  const auto second = make();
  const RobotBroker broker{settings, find_broker(settings), version};
  first->on_broker_up(broker, /*is_other=*/false);
  second->on_broker_up(broker, /*is_other=*/false);
  const double before = resident_kib();
  const double attach_s = attach_all(io, *first, sessions);
  const double each_kib = (resident_kib() - before) / sessions;
  const double idle_from = processor_seconds();
  test::eventually(
      io, [] { return false; }, std::chrono::seconds{6});
  const double idle_percent = (processor_seconds() - idle_from) / 6 * 100;
  const double takeover_s = attach_all(io, *second, sessions);
  const std::vector<double> commands = send_commands(io, settings, sessions, taken);
  std::puts(
      fmt::format(
          R"({{"sessions": {}, "attach_s": {:.2f}, "kib_each": {:.2f}, )"
          R"("idle_percent": {:.2f}, "takeover_s": {:.2f}, "left": {}, "commands": {}, "command_p50_ms": {:.1f}}})",
          sessions, attach_s, each_kib, idle_percent, takeover_s, first->sessions().held(),
          commands.size(), commands.empty() ? 0.0 : commands[commands.size() / 2])
          .c_str());
}

}  // namespace
}  // namespace slamgw::sessions

int main(int count, char** arguments) {
  if (count < 3) {
    std::fputs("usage: session_cost SESSIONS PORT [5|3]\n", stderr);
    return 2;
  }
  slamgw::sessions::measure(
      std::atoi(arguments[1]), static_cast<std::uint16_t>(std::atoi(arguments[2])),
      count > 3 && *arguments[3] == '3' ? slamgw::MqttVersion::v3_1_1 : slamgw::MqttVersion::v5);
}
