// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/normalizer.hpp"

#include <utility>

namespace slamgw {
namespace {

constexpr std::string_view update_type = "update";

Bytes encode(const Update& update, UpdateMode mode, Bytes as_it_came) {
  switch (mode) {
    case UpdateMode::positions: return drop_stray_byte(std::move(as_it_came));
    case UpdateMode::json: return to_bytes(encode_json(update));
    case UpdateMode::raw: return as_it_came;
  }
  return as_it_came;
}

}  // namespace

Normalized normalize(std::string_view type, Bytes payload, UpdateMode mode) {
  if (type != update_type) return {std::move(payload), std::nullopt, false};
  auto update = parse_update(payload);
  if (!update.has_value()) {
    const bool is_rejected = mode != UpdateMode::raw;  // raw reads nothing, so it refuses nothing
    return {std::move(payload), std::nullopt, is_rejected};
  }
  Bytes encoded = encode(*update, mode, std::move(payload));
  return {std::move(encoded), std::move(*update), false};
}

}  // namespace slamgw
