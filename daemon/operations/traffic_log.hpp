// SPDX-License-Identifier: Apache-2.0
// Robot messages as log lines: `thread NRF_5 update x=120 y=-33 obstacles=2`. Decides which of them
// are worth a line
// (`log.traffic`): a journal entry costs a Pi's card more than the message itself.
#pragma once

#include <optional>
#include <string>
#include <unordered_map>

#include "daemon/core/burst.hpp"
#include "daemon/core/traffic_event.hpp"
#include "daemon/operations/log.hpp"
#include "daemon/operations/log_settings.hpp"

namespace slamgw {

/// `sampled`: the first of each robot, direction and type, then at most one a second, which says
/// how many it stands for.
class TrafficSampler {
 public:
  /// Streams followed one by one; what is beyond shares one budget.
  static constexpr std::size_t max_streams = 65536;

  explicit TrafficSampler(TrafficLog mode) : mode_(mode) {}

  /// How many messages a line for this one stands for; nothing when there is to be none.
  std::optional<std::uint64_t> on_traffic(const TrafficEvent& event, TimePoint now);

 private:
  TrafficLog mode_;
  std::unordered_map<std::string, Burst> streams_;
};

std::string traffic_text(const TrafficEvent& event, std::uint64_t stands_for);
LogFields traffic_fields(const TrafficEvent& event);

}  // namespace slamgw
