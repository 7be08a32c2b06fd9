// SPDX-License-Identifier: Apache-2.0
// The head of an access message (Mesh Profile 1.0 section 3.7.3.1): an opcode of one, two or three
// octets, then parameters. Called by Uplink, NodeConfiguration and the codecs here.
#pragma once

#include <cstdint>

#include "adapters/ble_mesh_usb_cdc/errors.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/core/result.hpp"

namespace slamgw::ble {

/// The opcode's octets as one number in wire order, the first most significant: 0x04, 0x8202,
/// 0xc95900 (vendor opcode c9 of company 0x0059, which goes little-endian over the air).
using Opcode = std::uint32_t;

struct AccessMessage {
  Opcode opcode = 0;
  ByteView params;  ///< into the decoded bytes
};

Result<AccessMessage, DecodeError> decode_access(ByteView payload);
Bytes encode_access(Opcode opcode, ByteView params);

/// How many segments the message takes (Mesh Profile 1.0 section 3.5.2): one while opcode and
/// parameters fit in 11 octets, else 12 octets each with a 4-octet TransMIC at the end.
std::size_t segments_of(std::size_t access_bytes);

}  // namespace slamgw::ble
