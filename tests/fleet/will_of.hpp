// SPDX-License-Identifier: Apache-2.0
// The last will of a robot as its mesh gives it to the core.
#pragma once

#include <string>
#include <utility>

#include "daemon/core/messages.hpp"

namespace slamgw {

inline Report will_of(std::string robot) {
  return {.mesh = Mesh::thread,
          .robot = std::move(robot),
          .topic = {},
          .payload = {},
          .receipt = no_receipt,
          .is_will = true};
}

}  // namespace slamgw
