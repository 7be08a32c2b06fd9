// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/traffic_sampler.hpp"

#include <chrono>
#include <functional>
#include <utility>

namespace slamgw {

std::optional<TrafficLine> TrafficSampler::on_traffic(const TrafficEvent& event, TimePoint now) {
  const auto of_stream = sample(event, now);
  if (!of_stream) return std::nullopt;
  if (!budget_.take(now)) {
    without_line_ += *of_stream;
    return std::nullopt;
  }
  return TrafficLine{*of_stream, std::exchange(without_line_, 0)};
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
  if (streams_.size() >= max_streams && !streams_.contains(hash)) hash = all_others;
  return streams_.try_emplace(hash, std::chrono::seconds{1}).first->second.on_event(now);
}

}  // namespace slamgw
