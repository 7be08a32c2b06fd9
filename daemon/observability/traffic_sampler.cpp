// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/traffic_sampler.hpp"

#include <fmt/format.h>

#include <chrono>
#include <functional>
#include <utility>

namespace slamgw {

std::optional<Notice> UnprovenLines::summary() {
  const std::uint64_t count = std::exchange(left_out_, 0);
  if (count == 0) return std::nullopt;
  return Notice{
      Severity::warning,
      fmt::format("left out {} lines about clients that have not shown that they receive, "
                  "the last one about '{}': too many at once; slam-gatewayctl status "
                  "names the address that has most of these clients",
                  count, last_),
      {},
      Occasion::robot_presence};
}

std::optional<TrafficLine> TrafficSampler::on_traffic(const TrafficEvent& event, TimePoint now) {
  const auto of_stream = sample(event, now);
  if (!of_stream) return std::nullopt;
  if (!event.is_proven && mode_ == TrafficLogMode::sampled) {
    if (!unproven_->may_write_traffic(event.robot, now)) return std::nullopt;
    return TrafficLine{*of_stream, 0};
  }
  Streams& of_class = streams_[event.is_proven];
  if (!of_class.budget.take(lines_at_once, lines_per_second, now)) {
    of_class.without_line += *of_stream;
    return std::nullopt;
  }
  return TrafficLine{*of_stream, std::exchange(of_class.without_line, 0)};
}

std::optional<std::uint64_t> TrafficSampler::sample(const TrafficEvent& event, TimePoint now) {
  switch (mode_) {
    case TrafficLogMode::off: return std::nullopt;
    case TrafficLogMode::all: return 1;
    case TrafficLogMode::sampled: break;
  }
  stream_.assign(event.robot).append(1, '/').append(event.type);
  if (event.direction == Direction::down) stream_ += '/';
  constexpr std::size_t all_others = 0;
  std::size_t hash = std::hash<std::string>{}(stream_);
  auto& [budget, without_line, streams, types] = streams_[event.is_proven];
  if (const auto known = streams.find(hash); known != streams.end())
    return known->second.on_event(now);
  const std::size_t robot = std::hash<std::string>{}(event.robot);
  if (streams.size() >= max_streams) {
    hash = all_others;
  } else if (std::size_t& count = types[robot]; count >= max_types) {
    hash = robot;
  } else {
    ++count;
  }
  return streams.try_emplace(hash, std::chrono::seconds{1}).first->second.on_event(now);
}

}  // namespace slamgw
