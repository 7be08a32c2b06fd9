// SPDX-License-Identifier: Apache-2.0
// `/metrics`: the numbers that the gateways publish about themselves, in Prometheus's text format
// 0.0.4. Pure. Every name begins with `slamgw_`; units are seconds and bytes; counters end in
// `_total`. The last numbers of a gateway that is gone or silent are left out.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <string_view>

#include "daemon/core/messages.hpp"
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

/// Counts how commands ended, by gateway and outcome. Bounded, because gateways' names come from
/// the broker.
class OutcomeCounts {
 public:
  static constexpr std::size_t max_gateways = 1000;
  using Counts = std::array<std::uint64_t, command_result_count>;  ///< by CommandResult

  /// Ignores unknown outcomes. Call for gateways whose `state` is known.
  void add(std::string_view gateway, std::string_view payload);
  Counts of(std::string_view gateway) const;

 private:
  std::map<std::string, Counts, std::less<>> counts_;
};

std::string metrics_text(const OwnNumbers& own, const Topics& topics, const LastKnown& known,
                         const Roster& roster, const OutcomeCounts& outcomes);

}  // namespace slamgw::web
