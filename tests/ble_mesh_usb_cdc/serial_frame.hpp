// SPDX-License-Identifier: Apache-2.0
// A board's frame: a length, an opcode and parameters.
#pragma once

#include "daemon/core/bytes.hpp"

namespace slamgw::ble {

inline Bytes frame(std::uint8_t opcode, ByteView params) {
  ByteWriter writer;
  writer.write_u8(static_cast<std::uint8_t>(1 + params.size())).write_u8(opcode).write(params);
  return writer.take();
}

inline Bytes response(std::uint8_t opcode, std::uint8_t status, ByteView body = {}) {
  return frame(0x84, ByteWriter{}.write_u8(opcode).write_u8(status).write(body).bytes());
}

inline Bytes number(std::uint16_t value) { return ByteWriter{}.write_u16_le(value).take(); }

}  // namespace slamgw::ble
