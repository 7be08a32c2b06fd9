// SPDX-License-Identifier: Apache-2.0
// How long and how often is measured.
#pragma once

#include <chrono>

namespace slamgw::bench {

struct Plan {
  unsigned rounds = 3;
  std::chrono::milliseconds span{4000};  ///< of a run
  std::chrono::seconds idle{30};         ///< of a look at idle clients

  /// Shows that everything works, and orders of magnitude.
  static Plan quick() { return {1, std::chrono::milliseconds(1000), std::chrono::seconds(10)}; }
};

}  // namespace slamgw::bench
