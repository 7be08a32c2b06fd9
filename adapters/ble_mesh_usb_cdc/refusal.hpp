// SPDX-License-Identifier: Apache-2.0
// Why something was not done, as a sentence for the operator.
#pragma once

#include <string>

namespace slamgw::ble {

struct Refusal {
  std::string why;
};

}  // namespace slamgw::ble
