// SPDX-License-Identifier: Apache-2.0
// The payload of `<prefix>/gateway/<gw>/numbers`: how many messages each robot sends and gets.
// Pure.
#pragma once

#include <cstddef>
#include <map>
#include <string>

#include "daemon/core/bytes.hpp"
#include "daemon/core/robot_registry.hpp"

namespace slamgw {

/// Robots in one message of the `numbers` topic: the ones that were heard last. The others are
/// counted in `left_out`.
inline constexpr std::size_t max_robots_in_numbers = 1000;

/// Returns the JSON of docs/topics.md. `now`: for rates and latencies.
Bytes numbers_text(const std::map<std::string, Robot>& robots, TimePoint now);

}  // namespace slamgw
