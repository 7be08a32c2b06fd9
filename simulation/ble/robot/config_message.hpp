// SPDX-License-Identifier: Apache-2.0
// Code shared by the parts of the configuration server: status codes, fields of messages, and the
// table of messages that a part answers (Mesh Profile 1.0 section 4.3).
#pragma once

#include <optional>
#include <utility>
#include <vector>

#include "simulation/ble/robot/node_configuration.hpp"

namespace slamgw::sim::ble {

/// Section 4.3.5.
enum class ConfigStatus : std::uint8_t {
  success = 0x00,
  invalid_address = 0x01,
  invalid_model = 0x02,
  invalid_app_key_index = 0x03,
  invalid_net_key_index = 0x04,
  insufficient_resources = 0x05,
  key_index_already_stored = 0x06,
  not_a_subscribe_model = 0x08,
  feature_not_supported = 0x0a,
  cannot_update = 0x0b,
  cannot_remove = 0x0c,
  cannot_bind = 0x0d,
  cannot_set = 0x0f,
};

/// Opcodes have one octet, or two in big-endian order.
Bytes begin_message(std::uint16_t opcode);
Bytes begin_status(std::uint16_t opcode, ConfigStatus status);

/// Reads a model identifier at the end of a message: two octets, or company and model. Returns
/// nothing when another number of octets is left.
std::optional<ModelId> model_id_at(ByteView parameters, std::size_t offset);
void put_model_id(Bytes& out, ModelId id);

/// Returns true if the node has that element, which is its only one, and the model.
ConfigStatus model_status(const NodeConfiguration& configuration, Address element, ModelId id);

Key key_at(ByteView parameters, std::size_t offset);

/// Two 12-bit key indexes in three octets, the first in the lower bits.
std::pair<std::uint16_t, std::uint16_t> key_indexes(ByteView parameters);
/// Pairs in three octets, and a single one at the end in two.
void put_key_indexes(Bytes& out, const std::vector<std::uint16_t>& indexes);

/// Nothing for a message that is silently ignored: unknown, of a wrong length, or prohibited.
using Answer = std::optional<Bytes>;

/// A message that the part `Owner` of the configuration server answers.
template <typename Owner>
struct ConfigRequest {
  std::uint16_t opcode;
  Answer (Owner::*answer)(ByteView parameters);
};

/// Returns nothing when `opcode` is not in the table.
template <typename Owner, std::size_t size>
std::optional<Answer> answer_request(const ConfigRequest<Owner> (&table)[size], Owner& owner,
                                     std::uint16_t opcode, ByteView parameters) {
  for (const ConfigRequest<Owner>& request : table) {
    if (request.opcode == opcode) return (owner.*request.answer)(parameters);
  }
  return std::nullopt;
}

}  // namespace slamgw::sim::ble
