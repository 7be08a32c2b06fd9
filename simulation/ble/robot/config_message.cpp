// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/robot/config_message.hpp"

#include <algorithm>

namespace slamgw::sim::ble {

Bytes begin_message(std::uint16_t opcode) {
  Bytes out;
  if (opcode > 0xff) {
    put_u16_be(out, opcode);
  } else {
    put_u8(out, static_cast<std::uint8_t>(opcode));
  }
  return out;
}

Bytes begin_status(std::uint16_t opcode, ConfigStatus status) {
  Bytes out = begin_message(opcode);
  put_u8(out, static_cast<std::uint8_t>(status));
  return out;
}

std::optional<ModelId> model_id_at(ByteView parameters, std::size_t offset) {
  if (parameters.size() == offset + 2) return ModelId{ModelId::sig, get_u16_le(parameters, offset)};
  if (parameters.size() != offset + 4) return std::nullopt;
  return ModelId{get_u16_le(parameters, offset), get_u16_le(parameters, offset + 2)};
}

void put_model_id(Bytes& out, ModelId id) {
  if (id.company != ModelId::sig) put_u16_le(out, id.company);
  put_u16_le(out, id.id);
}

ConfigStatus model_status(const NodeConfiguration& configuration, Address element, ModelId id) {
  if (element != configuration.network->address) return ConfigStatus::invalid_address;
  const bool is_there = configuration.find_model(id) != nullptr;
  return is_there ? ConfigStatus::success : ConfigStatus::invalid_model;
}

Key key_at(ByteView parameters, std::size_t offset) {
  Key key{};
  std::copy_n(parameters.begin() + static_cast<std::ptrdiff_t>(offset), key.size(), key.begin());
  return key;
}

std::pair<std::uint16_t, std::uint16_t> key_indexes(ByteView parameters) {
  const int first = parameters[0] | (parameters[1] & 0x0f) << 8;
  const int second = parameters[1] >> 4 | parameters[2] << 4;
  return {static_cast<std::uint16_t>(first), static_cast<std::uint16_t>(second)};
}

void put_key_indexes(Bytes& out, const std::vector<std::uint16_t>& indexes) {
  for (std::size_t i = 0; i < indexes.size(); i += 2) {
    const bool is_single = i + 1 == indexes.size();
    const int pair = indexes[i] | (is_single ? 0 : indexes[i + 1] << 12);
    put_u16_le(out, static_cast<std::uint16_t>(pair & 0xffff));
    if (!is_single) put_u8(out, static_cast<std::uint8_t>(pair >> 16));
  }
}

}  // namespace slamgw::sim::ble
