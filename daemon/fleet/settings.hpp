// SPDX-License-Identifier: Apache-2.0
// The configuration's `fleet`, as values.
#pragma once

#include <cstdint>

#include "daemon/fleet/claim.hpp"

namespace slamgw::fleet {

enum class Enabled : std::uint8_t {
  automatic,  ///< as soon as another gateway is seen on this broker
  yes,
  no,
};

struct Settings {
  Enabled enabled = Enabled::automatic;  ///< `fleet.enabled`
  /// Random, another one for each start of the process; its lower 16 bits are not used.
  Life process = 0;
  /// When this gateway ran last, others were on its broker (RememberOthers).
  bool were_others_about = false;

  /// Without looking for others first.
  bool joins_at_once() const {
    return enabled == Enabled::yes || (enabled == Enabled::automatic && were_others_about);
  }
};

}  // namespace slamgw::fleet
