// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

namespace slamgw::sim::ble {

/// What a robot does with an update while its last SET waits for its STATUS.
enum class OnBusy : std::uint8_t {
  cancel,  ///< forgets the old one, and skips this update, too (thesis 9.1: "cancelled")
  refuse,  ///< drops this update; the old one is repeated until its STATUS (Nordic's access layer)
};

}  // namespace slamgw::sim::ble
