// SPDX-License-Identifier: Apache-2.0
// The simulator's own byte helpers. It shares no code with the daemon on purpose: it is written
// from the specifications alone, so that mistakes on either side show.
#pragma once

#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

namespace slamgw::sim {

using Bytes = std::vector<std::uint8_t>;
using ByteView = std::span<const std::uint8_t>;

inline void put_u8(Bytes& out, std::uint8_t value) { out.push_back(value); }

inline void put_u16_be(Bytes& out, std::uint16_t value) {
  out.push_back(static_cast<std::uint8_t>(value >> 8));
  out.push_back(static_cast<std::uint8_t>(value & 0xff));
}

inline void put_u16_le(Bytes& out, std::uint16_t value) {
  out.push_back(static_cast<std::uint8_t>(value & 0xff));
  out.push_back(static_cast<std::uint8_t>(value >> 8));
}

inline void put_i16_le(Bytes& out, std::int16_t value) {
  put_u16_le(out, static_cast<std::uint16_t>(value));
}

inline void put_u32_le(Bytes& out, std::uint32_t value) {
  put_u16_le(out, static_cast<std::uint16_t>(value & 0xffff));
  put_u16_le(out, static_cast<std::uint16_t>(value >> 16));
}

inline void put(Bytes& out, ByteView bytes) { out.insert(out.end(), bytes.begin(), bytes.end()); }
inline void put(Bytes& out, std::string_view text) {
  out.insert(out.end(), text.begin(), text.end());
}

/// Returns the two octets at `offset`; the caller has checked the size.
inline std::uint16_t get_u16_be(ByteView bytes, std::size_t offset) {
  return static_cast<std::uint16_t>(bytes[offset] << 8 | bytes[offset + 1]);
}
inline std::uint16_t get_u16_le(ByteView bytes, std::size_t offset) {
  return static_cast<std::uint16_t>(bytes[offset + 1] << 8 | bytes[offset]);
}
inline std::int16_t get_i16_le(ByteView bytes, std::size_t offset) {
  return static_cast<std::int16_t>(get_u16_le(bytes, offset));
}

}  // namespace slamgw::sim
