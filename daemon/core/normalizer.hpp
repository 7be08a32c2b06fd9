// SPDX-License-Identifier: Apache-2.0
// Brings the payloads of type `update` into one form; every other type passes unchanged.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "daemon/core/bytes.hpp"
#include "daemon/core/recycling_allocator.hpp"

namespace slamgw {

/// The thesis's `update` payload (docs/topics.md; thesis 6.3): little-endian int16 pairs in
/// centimetres, `x y` of the robot, then up to four obstacles. Robots append one stray byte, which
/// is dropped: the end of a struct that was cut short, not a count.
struct Position {
  std::int16_t x_cm = 0;
  std::int16_t y_cm = 0;
  bool operator==(const Position&) const = default;
};

struct Update {
  Position robot;
  std::vector<Position, RecyclingAllocator<Position>> obstacles;  ///< 0..4
  bool operator==(const Update&) const = default;
};

/// Returns nothing unless `payload` has 4 + 4n or 4 + 4n + 1 octets with n = 0..4.
std::optional<Update> parse_update(ByteView payload);
/// Returns the canonical bytes, exactly 4 + 4n octets. parse_update() must be able to read
/// `payload`.
Bytes drop_stray_byte(Bytes payload);
/// `{"x":10,"y":-20,"obstacles":[{"x":100,"y":300}]}`
std::string encode_json(const Update& update);

/// The form in which `update` is published (`payload.update`).
enum class UpdateMode : std::uint8_t { positions, json, raw };

struct Normalized {
  Bytes payload;
  std::optional<Update> update;  ///< set for an `update` that could be read
  bool had_stray_octet = false;  ///< after an `update` that could be read
  bool is_rejected = false;      ///< `payload` is unchanged and belongs on the `rejected` topic
};

Normalized normalize(std::string_view type, Bytes payload, UpdateMode mode);

}  // namespace slamgw
