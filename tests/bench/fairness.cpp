// SPDX-License-Identifier: Apache-2.0
// 100 clients that send ten messages a second, alone and while one client sends 10 000.
#include <fmt/format.h>

#include <atomic>
#include <memory>
#include <thread>

#include "tests/bench/bounds.hpp"
#include "tests/bench/raw_sender.hpp"
#include "tests/bench/swarm.hpp"
#include "tests/bench/world.hpp"

namespace slamgw::bench {
namespace {

constexpr std::size_t others = 100;

/// One client at QoS 0, ten messages each millisecond, from a thread of its own.
class Flood {
 public:
  /// `client`: its number at the sender.
  Flood(std::unique_ptr<Sender> sender, std::uint32_t client) : sender_(std::move(sender)) {
    thread_ = std::thread([this, client] {
      for (auto due = Clock::now(); !is_over_; due += std::chrono::milliseconds(1)) {
        std::this_thread::sleep_until(due);
        for (int i = 0; i < 10; ++i) sender_->submit({to_ns(due), no_run, client, 0}, 0);
        sender_->flush();
        ++milliseconds_;
      }
    });
  }
  ~Flood() {
    is_over_ = true;
    thread_.join();
  }
  double per_second() const {
    const std::chrono::duration<double> took = Clock::now() - begin_;
    return 10 * static_cast<double>(milliseconds_) / took.count();
  }

 private:
  std::unique_ptr<Sender> sender_;
  std::atomic<bool> is_over_ = false;
  std::atomic<std::uint64_t> milliseconds_ = 0;
  const Clock::time_point begin_ = Clock::now();
  std::thread thread_;
};

/// The others' p99 alone and beside the flood, in ms.
struct Latencies {
  double alone = 0, beside = 0;
  double flood_per_second = 0;
  double ratio() const { return beside / alone; }
};

using Path = RunResult (&)(const Target&, const std::string&, const Load&,
                           const std::function<void()>&);
using MakeFlood = std::function<std::unique_ptr<Flood>()>;

Latencies measure(const Target& target, Report& report, const Plan& plan, Path path,
                  const MakeFlood& make_flood) {
  Load load;
  load.pace = Pace::fixed_rate;
  load.clients = others;
  load.per_second = 1000;
  load.duration = 2 * plan.span;
  const RunResult alone = path(target, "100 clients x 10/s, alone", load, {});
  std::unique_ptr<Flood> flood;
  const RunResult beside =
      path(target, "100 clients x 10/s, beside a flood", load, [&] { flood = make_flood(); });
  report.add(alone);
  report.add(beside);
  return {alone.latency.p99_ms, beside.latency.p99_ms, flood->per_second()};
}

std::string describe(const std::vector<Latencies>& pairs) {
  return fmt::format("{:.2f} ms to {:.2f} ms",
                     median_of(pairs, [](const Latencies& pair) { return pair.beside; }),
                     median_of(pairs, [](const Latencies& pair) { return pair.alone; }));
}

}  // namespace

void fairness(Report& report, const Plan& plan, World&& world) {
  Poller unread;  // the flood is QoS 0, so no answers arrive
  std::vector<Latencies> ours, floors;
  for (unsigned i = 0; i < plan.rounds; ++i) {
    ours.push_back(measure(world.target(), report, plan, through_gateway, [&] {
      auto swarm = std::make_unique<Swarm>(world.sn_address(), 1, unread, 0, others);
      swarm->connect_all(1);
      return std::make_unique<Flood>(std::move(swarm), 0);
    }));
    floors.push_back(measure(world.target(), report, plan, straight, [&] {
      return std::make_unique<Flood>(
          std::make_unique<RawSender>(world.broker_address(), others + 1, unread, 0, "bench-flood"),
          others);
    }));
  }
  const auto ratio = [](const Latencies& pair) { return pair.ratio(); };
  report.budget_at_most(
      "the others' p99 while one client sends 10 000/s (" + world.path + ")",
      median_of(ours, ratio), 2, "times",
      fmt::format("{}; raw, straight to the broker: {:.1f} times, {}; the one sent {:.0f}/s",
                  describe(ours), median_of(floors, ratio), describe(floors),
                  median_of(ours, [](const Latencies& pair) { return pair.flood_per_second; })));
}

}  // namespace slamgw::bench
