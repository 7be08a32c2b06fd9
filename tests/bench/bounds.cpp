// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/bounds.hpp"

#include <fmt/format.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <fstream>
#include <thread>

#include "tests/bench/swarm.hpp"
#include "tests/bench/world.hpp"
#include "tests/support/eventually.hpp"

namespace slamgw::bench {
namespace {

using namespace std::chrono_literals;

void expect(bool is_so, const std::string& what) {
  if (!is_so) throw std::runtime_error(what);
}

/// Receives READY from a daemon: sd_notify(3).
class NotifySocket {
 public:
  NotifySocket() : descriptor_(socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0)) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    const std::string path = directory_ / "notify";
    path.copy(address.sun_path, sizeof address.sun_path - 1);
    expect(bind(descriptor_, reinterpret_cast<sockaddr*>(&address), sizeof address) == 0,
           "no socket for NOTIFY_SOCKET");
    const timeval limit{10, 0};
    setsockopt(descriptor_, SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit);
    setenv("NOTIFY_SOCKET", path.c_str(), 1);
  }
  ~NotifySocket() {
    unsetenv("NOTIFY_SOCKET");
    close(descriptor_);
  }
  void wait_ready() {
    char text[4096];
    for (ssize_t size = 1; size > 0;) {
      size = recv(descriptor_, text, sizeof text, 0);
      if (size > 0 &&
          std::string(text, static_cast<std::size_t>(size)).find("READY=1") != std::string::npos)
        return;
    }
    throw std::runtime_error("the daemon does not become ready");
  }

 private:
  test::TempDir directory_;
  int descriptor_;
};

/// Returns the octets that a process has written, to all files and sockets.
double octets_written(pid_t process) {
  std::ifstream file(fmt::format("/proc/{}/io", process));
  for (std::string key, value; file >> key >> value;) {
    if (key == "wchar:") return std::stod(value);
  }
  return 0;
}

/// Sends messages until all are acknowledged to the clients, which means that they are stored.
void store(World& world, std::size_t clients, std::uint32_t each) {
  Poller poller;
  Swarm swarm(world.sn_address(), clients, poller, 0);
  swarm.connect_all(connects_at_once);
  for (std::uint32_t sequence = 0; sequence < each; ++sequence) {
    for (std::size_t client = 0; client < clients; ++client)
      swarm.submit({to_ns(Clock::now()), no_run, static_cast<std::uint32_t>(client), sequence}, 1);
  }
  for (const auto end = Clock::now() + 120s; swarm.unfinished() > 0;) {
    expect(Clock::now() < end, "the daemon does not store all messages");
    poller.wait(Clock::now() + 50ms, [&](std::uint64_t token) { swarm.on_readable(token); });
    swarm.on_tick(Clock::now());
  }
}

}  // namespace

void traffic_lines(Report& report, const Plan& plan) {
  World quiet;
  World talkative(nlohmann::json{{"log", {{"traffic", "all"}}}});
  Load load;
  load.clients = 100;
  load.duration = plan.span;
  std::vector<double> shares;
  for (unsigned i = 0; i < plan.rounds; ++i) {
    const RunResult without =
        through_gateway(quiet.target(), "100 clients flat out, log.traffic sampled", load);
    const RunResult with =
        through_gateway(talkative.target(), "100 clients flat out, log.traffic all", load);
    report.add(without);
    report.add(with);
    shares.push_back(100 * with.per_second / without.per_second);
  }
  report.budget_at_least("log.traffic `all`, throughput of that with `sampled`", median(shares), 60,
                         "%");
}

void start_to_ready(Report& report) {
  std::vector<double> took_ms;
  for (int i = 0; i < 5; ++i) {
    const test::Mosquitto broker;
    NotifySocket notify;
    const auto begin = Clock::now();
    const test::GatewayProcess gateway(nlohmann::json{{"broker", {{"uri", broker.uri()}}}});
    notify.wait_ready();
    took_ms.push_back(std::chrono::duration<double, std::milli>(Clock::now() - begin).count());
  }
  report.budget_at_most("start to READY", median(took_ms), 100, "ms");
}

void backlog(Report& report) {
  constexpr std::size_t clients = 100;
  constexpr std::uint32_t each = 200;
  World world;
  world.broker.kill();
  expect(test::eventually([&] { return !world.is_broker_up(); }), "the broker does not stop");
  store(world, clients, each);

  world.broker.start();
  Load load;
  load.pace = Pace::fixed_rate;
  load.clients = 50;
  load.per_second = 500;
  load.duration = 2s;
  Run run("50 clients x 10/s while 20 000 stored messages go", "gateway", load,
          world.broker_address());
  Swarm fresh(world.sn_address(), load.clients, run.poller(), Run::first_sender_token, clients);
  fresh.connect_all(connects_at_once);
  expect(run.listen([](const Arrivals& all) { return all.others().count > 0; }, 60s),
         "no backlog arrives");
  RunResult result = run.drive(fresh, world.pid(), world.sn_port());
  run.listen([](const Arrivals& all) { return all.others().count >= clients * each; }, 30s);
  const Arrivals::Others& stored = run.arrivals().others();
  report.add(result);
  const std::chrono::duration<double> took = stored.last - stored.first;
  report.budget_at_least("backlog of 20 000 stored messages, drained",
                         static_cast<double>(stored.count) / took.count(), 2000, "messages/s",
                         fmt::format("{} arrived", stored.count));
  report.budget_at_most("fresh messages during the backlog, the slowest", result.latency.max_ms, 50,
                        "ms", fmt::format("p99 {:.1f} ms", result.latency.p99_ms));
}

void ble_link(Report& report) {
  constexpr double robots = 16;
  constexpr double rate = 16;
  constexpr auto span = 10s;
  constexpr double saturated = 115200.0 / 10;  // octets a second: 8N1
  World world(nlohmann::json{{"ble_mesh", {{"enabled", true}}}});
  test::SimulatorProcess board({"ble", "--tty", world.gateway.tty(), "--robots",
                                fmt::format("{}", robots), "--rate", fmt::format("{}", rate),
                                "--seed", "1", "--baud", "0"});
  expect(test::eventually([&] {
           auto status = world.gateway.ctl({"status"});
           return status.is_object() && status["robots"]["online"] == robots;
         }),
         "the robots do not come: " + world.gateway.log());
  const double cpu_before = usage_of(world.pid()).cpu_s;
  const double link_before = first_thread_cpu_s(world.pid());
  const double octets_before = octets_written(board.process().pid());
  const auto begin = Clock::now();
  std::this_thread::sleep_for(span);
  const std::chrono::duration<double> took = Clock::now() - begin;
  const double octets = octets_written(board.process().pid()) - octets_before;
  const double to_share = 100 * saturated / octets;  // the line is nearly saturated
  const double link = (first_thread_cpu_s(world.pid()) - link_before) * to_share;
  const double all = (usage_of(world.pid()).cpu_s - cpu_before) * to_share;
  Load load;
  load.pace = Pace::fixed_rate;
  load.clients = robots;
  load.per_second = robots * rate;
  const RunResult paho = Run("16 clients x 16/s, QoS 1", "paho", load, world.broker_address())
                             .watch(SLAMGW_BENCH_PAHO, false);
  report.add(paho);
  report.budget_at_most(
      "a saturated serial line at 115 200 baud, CPU of the loop", link, 3, "% of a core",
      fmt::format("{:.0f} messages in {:.0f} octets/s; with the MQTT client's threads {:.1f} %; "
                  "bare Paho C++ for as many messages {:.1f} %",
                  robots * rate, octets / took.count(), all,
                  paho.cpu_us / 1e6 * robots * rate * took.count() * to_share));
}

}  // namespace slamgw::bench
