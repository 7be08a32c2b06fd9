// SPDX-License-Identifier: Apache-2.0
// The frame of the older robots (Lien 2017): `dst src protocol data.. crc`, COBS-coded, ended by a
// zero. The server has address 0, robots 1 and up. Called by CobsMesh.
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

#include "adapters/ble_mesh_usb_cdc/errors.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/core/result.hpp"

namespace slamgw::ble {

inline constexpr std::uint8_t lien_server_address = 0;

enum class LienProtocol : std::uint8_t {
  simple = 0,  ///< sent once
  arq = 1,     ///< acknowledged, see lien_connection.hpp
};

struct LienFrame {
  std::uint8_t destination = 0;
  std::uint8_t source = 0;
  LienProtocol protocol = LienProtocol::simple;
  Bytes data;
  bool operator==(const LienFrame&) const = default;
};

/// CRC-8/MAXIM: polynomial x^8+x^5+x^4+1 reflected (0x8c), start value 0.
std::uint8_t crc8_maxim(ByteView bytes);

/// As it goes over the wire, coded and ended.
Bytes encode_lien_frame(const LienFrame& frame);
/// `raw` is COBS-decoded already.
Result<LienFrame, DecodeError> decode_lien_frame(ByteView raw);

/// The name of a message by its first octet, for the topic's type; nothing for those that only the
/// server sends and for unused numbers.
std::optional<std::string_view> lien_type_name(std::uint8_t message_type);
inline constexpr std::uint8_t lien_update_message = 1;

}  // namespace slamgw::ble
