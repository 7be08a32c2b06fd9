// SPDX-License-Identifier: Apache-2.0
// Brings the payloads of type `update` into one form; every other type passes unchanged.
#pragma once

#include <optional>
#include <string_view>

#include "daemon/core/bytes.hpp"
#include "daemon/core/update_payload.hpp"

namespace slamgw {

struct Normalized {
  Bytes payload;
  std::optional<Update> update;  ///< when it is an `update` that could be read
  bool is_rejected = false;      ///< `payload` is as it came and belongs on the `rejected` topic
};

Normalized normalize(std::string_view type, Bytes payload, UpdateMode mode);

}  // namespace slamgw
