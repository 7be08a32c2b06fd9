// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/load.hpp"

#include <nlohmann/json.hpp>

#include "tests/support/child_process.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::bench {
namespace {

/// Messages of QoS 0, which are not acknowledged, on their way to the subscriber. Fewer than the
/// kernel's default receive buffer holds (about 277 small datagrams), so that none is lost.
constexpr std::uint64_t qos0_window = 200;
/// When nothing has arrived for this long, the rest is lost. Messages on the daemon's disk take a
/// while.
constexpr std::chrono::seconds silence{10};
/// The same for flat-out QoS 0, whose window would otherwise stay full of lost messages.
constexpr std::chrono::seconds qos0_silence{1};
constexpr std::chrono::milliseconds tick{100};

std::uint32_t next_run_number() {
  static std::uint32_t number = 0;
  return ++number;
}

}  // namespace

Run::Run(std::string name, std::string path, Load load, const Address& broker)
    : number_(next_run_number()),
      broker_(broker),
      subscriber_(broker, "bench-subscriber"),
      arrivals_(number_, load.clients),
      sequences_(load.clients) {
  result_.name = std::move(name);
  result_.path = std::move(path);
  result_.load = load;
  subscriber_.on_message = [this](ByteView payload) {
    arrivals_.on_payload(payload, Clock::now());
  };
  subscriber_.subscribe(every_topic, load.qos);
  poller_.add(subscriber_.descriptor(), 0);
}

RunResult Run::drive(Sender& sender, pid_t process, std::uint16_t udp_port) {
  const ProcessUsage before = usage_of(process);
  const std::uint64_t drops_before = dropped_datagrams(udp_port);
  const double generator_before = usage_of(getpid()).cpu_s;
  const auto begin = Clock::now();
  switch (result_.load.pace) {
    case Pace::flat_out: send_flat_out(sender); break;
    case Pace::fixed_rate:
    case Pace::aligned: send_at_rate(sender); break;
    case Pace::at_once: send_at_once(sender); break;
  }
  result_.generator_cpu = (usage_of(getpid()).cpu_s - generator_before) /
                          std::chrono::duration<double>(Clock::now() - begin).count();
  drain(&sender);
  finish(begin);
  const ProcessUsage after = usage_of(process);
  const auto received = static_cast<double>(std::max<std::uint64_t>(1, result_.received));
  result_.cpu_us = (after.cpu_s - before.cpu_s) * 1e6 / received;
  result_.context_switches =
      static_cast<double>(after.context_switches - before.context_switches) / received;
  result_.rss_kib = after.rss_kib;
  result_.drops = dropped_datagrams(udp_port) - drops_before;
  result_.repeats = sender.repeats();
  return result_;
}

RunResult Run::watch(const std::string& program, bool has_properties) {
  const test::TempDir directory;
  const Load& load = result_.load;
  const auto begin = Clock::now();
  test::ChildProcess floor(
      {program, std::to_string(broker_.port()), std::to_string(number_),
       std::to_string(load.clients), std::to_string(load.qos), std::to_string(load.per_second),
       std::to_string(load.duration.count()), has_properties ? "properties" : "plain"},
      directory / "out", directory / "err");
  const double generator_before = usage_of(getpid()).cpu_s;
  while (floor.is_running()) turn(nullptr, Clock::now() + std::chrono::milliseconds(20));
  result_.generator_cpu = (usage_of(getpid()).cpu_s - generator_before) /
                          std::chrono::duration<double>(Clock::now() - begin).count();
  const auto report = nlohmann::json::parse(test::read_file(directory / "out"), nullptr, false);
  if (report.is_discarded())
    throw std::runtime_error(program + " failed: " + test::read_file(directory / "err"));
  result_.sent = report.at("sent");
  drain(nullptr);
  finish(Clock::time_point(std::chrono::nanoseconds(report.at("begin_ns").get<std::int64_t>())));
  const auto received = static_cast<double>(std::max<std::uint64_t>(1, result_.received));
  result_.cpu_us = report.at("cpu_us").get<double>() / received;
  result_.context_switches = report.at("context_switches").get<double>() / received;
  result_.rss_kib = report.at("rss_kib");
  return result_;
}

bool Run::listen(const std::function<bool(const Arrivals&)>& is_enough,
                 std::chrono::seconds limit) {
  const auto end = Clock::now() + limit;
  while (!is_enough(arrivals_) && Clock::now() < end) turn(nullptr, Clock::now() + tick);
  return is_enough(arrivals_);
}

void Run::send_flat_out(Sender& sender) {
  const auto end = Clock::now() + result_.load.duration;
  std::uint64_t written_off = 0;
  for (auto now = Clock::now(); now < end; now = Clock::now()) {
    if (result_.load.qos == 0) {
      if (arrivals_.unique() > 0 && now - arrivals_.last() > qos0_silence)
        written_off = result_.sent - arrivals_.unique();
      while (result_.sent - arrivals_.unique() < qos0_window + written_off)
        submit(sender, result_.sent % result_.load.clients, now);
    } else {
      while (const auto client = sender.free_client()) submit(sender, *client, Clock::now());
    }
    sender.flush();
    turn(&sender, now + tick);
  }
}

void Run::send_at_rate(Sender& sender) {
  const Load& load = result_.load;
  const std::uint64_t together = load.pace == Pace::aligned ? load.clients : 1;
  const auto gap =
      std::chrono::nanoseconds(std::int64_t(1e9 * static_cast<double>(together) / load.per_second));
  const auto begin = Clock::now();
  for (auto due = begin; due < begin + load.duration;) {
    for (; due <= Clock::now(); due += gap) {
      for (std::uint64_t i = 0; i < together; ++i) submit(sender, result_.sent % load.clients, due);
    }
    sender.flush();
    turn(&sender, due);
  }
}

void Run::send_at_once(Sender& sender) {
  for (std::size_t client = 0; client < result_.load.clients; ++client)
    submit(sender, client, Clock::now());
  sender.flush();
}

void Run::submit(Sender& sender, std::size_t client, Clock::time_point due) {
  Message message;
  message.due_ns = to_ns(due);
  message.run = number_;
  message.client = static_cast<std::uint32_t>(client);
  message.sequence = sequences_[client]++;
  ++result_.sent;
  sender.submit(message, result_.load.qos);
}

void Run::turn(Sender* sender, Clock::time_point until) {
  poller_.wait(until, [&](std::uint64_t token) {
    if (token == 0) {
      subscriber_.on_readable();
    } else if (sender) {
      sender->on_readable(token);
    }
  });
  if (!sender) return;
  sender->flush();
  const auto now = Clock::now();
  if (now < next_tick_) return;
  next_tick_ = now + tick;
  sender->on_tick(now);
}

void Run::drain(Sender* sender) {
  const auto begin = Clock::now();
  while (arrivals_.unique() < result_.sent || (sender && sender->unfinished() > 0)) {
    const auto now = Clock::now();
    if (now - std::max(arrivals_.last(), begin) > silence) return;
    turn(sender, now + tick);
  }
}

void Run::finish(Clock::time_point begin) {
  result_.received = arrivals_.unique();
  result_.duplicates = arrivals_.duplicates();
  const std::chrono::duration<double> took = arrivals_.last() - begin;
  if (result_.received > 0)
    result_.per_second = static_cast<double>(result_.received) / took.count();
  result_.latency = arrivals_.latencies();
}

}  // namespace slamgw::bench
