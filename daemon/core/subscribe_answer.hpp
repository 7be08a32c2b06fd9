// SPDX-License-Identifier: Apache-2.0
// What became of a SUBSCRIBE at the broker.
#pragma once

#include <cstdint>

namespace slamgw {

enum class SubscribeAnswer : std::uint8_t {
  granted,
  refused,            ///< by a reason code
  closes_connection,  ///< the broker closes the connection in place of an answer
};

}  // namespace slamgw
