// SPDX-License-Identifier: Apache-2.0
// `/metrics`: the numbers that the gateways publish about themselves, in Prometheus's text format
// 0.0.4. Pure. Every name begins with `slamgw_`; units are seconds and bytes; counters end in
// `_total`. The last numbers of a gateway that is gone or silent are left out.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <utility>

#include "web/server/last_known.hpp"
#include "web/server/roster.hpp"
#include "web/server/topics.hpp"

namespace slamgw::web {

/// Numbers about this program itself.
struct OwnNumbers {
  std::string version;
  bool broker_is_connected = false;
  std::size_t pages = 0;
  std::uint64_t messages = 0;          ///< from the broker
  std::uint64_t messages_dropped = 0;  ///< messages that slow pages did not get
  std::uint64_t commands = 0;          ///< from pages
  std::uint64_t requests_refused = 0;  ///< wrong Host or Origin, no room
  std::uint64_t wrong_tokens = 0;
  double cpu_seconds = 0;
  std::uint64_t resident_bytes = 0;
};

/// Counts how commands ended, by gateway and outcome; bounded, because both words come from the
/// broker.
class OutcomeCounts {
 public:
  static constexpr std::size_t max_series = 200;
  void add(std::string_view gateway, std::string_view payload);
  const std::map<std::pair<std::string, std::string>, std::uint64_t>& counts() const {
    return counts_;
  }

 private:
  std::map<std::pair<std::string, std::string>, std::uint64_t> counts_;
};

std::string metrics_text(const OwnNumbers& own, const Topics& topics, const LastKnown& known,
                         const Roster& roster, const OutcomeCounts& outcomes);

}  // namespace slamgw::web
