// SPDX-License-Identifier: Apache-2.0
// How long and how often is measured.
#pragma once

#include <chrono>

namespace slamgw::bench {

struct Plan {
  unsigned rounds = 3;
  std::chrono::milliseconds span{4000};  ///< of a run
  /// Of a look at idle clients; whole intervals of the gateway's statistics.
  std::chrono::seconds idle{30};

  /// Shows that everything works, and orders of magnitude.
  static Plan quick() { return {1, std::chrono::milliseconds(1000), std::chrono::seconds(20)}; }
};

}  // namespace slamgw::bench
