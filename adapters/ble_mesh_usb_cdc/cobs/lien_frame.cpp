// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/cobs/lien_frame.hpp"

#include <array>

#include "adapters/ble_mesh_usb_cdc/cobs/cobs.hpp"

namespace slamgw::ble {
namespace {

constexpr std::uint8_t reflected_polynomial = 0x8c;
constexpr std::size_t shortest_frame = 4;  // no data

}  // namespace

std::uint8_t crc8_maxim(ByteView bytes) {
  unsigned crc = 0;
  for (const std::uint8_t byte : bytes) {
    crc ^= byte;
    for (int bit = 0; bit < 8; ++bit)
      crc = (crc & 1U) != 0 ? (crc >> 1) ^ reflected_polynomial : crc >> 1;
  }
  return static_cast<std::uint8_t>(crc);
}

Bytes encode_lien_frame(const LienFrame& frame) {
  ByteWriter raw;
  raw.write_u8(frame.destination)
      .write_u8(frame.source)
      .write_u8(static_cast<std::uint8_t>(frame.protocol))
      .write(frame.data);
  raw.write_u8(crc8_maxim(raw.bytes()));
  Bytes wire = encode_cobs(raw.bytes());
  wire.push_back(0);
  return wire;
}

Result<LienFrame, DecodeError> decode_lien_frame(ByteView raw) {
  if (raw.size() < shortest_frame) return DecodeError::too_short;
  const ByteView covered = raw.first(raw.size() - 1);
  if (crc8_maxim(covered) != raw.back() || covered[2] > 1) return DecodeError::bad_value;
  return LienFrame{covered[0], covered[1], LienProtocol{covered[2]},
                   Bytes(covered.begin() + 3, covered.end())};
}

std::optional<std::string_view> lien_type_name(std::uint8_t message_type) {
  constexpr std::array<std::string_view, 16> names{"handshake",
                                                   "lien_update",
                                                   "",
                                                   "idle",
                                                   "",
                                                   "",
                                                   "",
                                                   "",
                                                   "",
                                                   "ping_response",
                                                   "line",
                                                   "debug",
                                                   "drone_update",
                                                   "battery",
                                                   "line_update",
                                                   "repo_update"};
  if (message_type >= names.size() || names[message_type].empty()) return std::nullopt;
  return names[message_type];
}

}  // namespace slamgw::ble
