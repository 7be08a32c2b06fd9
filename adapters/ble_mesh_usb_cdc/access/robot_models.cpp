// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/access/robot_models.hpp"

#include "adapters/ble_mesh_usb_cdc/octets.hpp"

namespace slamgw::ble {

namespace {

constexpr std::uint8_t reserved_opcode = 0x7f;
constexpr std::size_t max_unsegmented_bytes = 11;
constexpr std::size_t segment_bytes = 12;
constexpr std::size_t transmic_bytes = 4;

std::size_t opcode_size(std::uint8_t first) {
  if (first < 0x80) return 1;
  return first < 0xc0 ? 2 : 3;
}

}  // namespace

Result<AccessMessage, DecodeError> decode_access(ByteView payload) {
  if (payload.empty()) return DecodeError::too_short;
  if (payload.front() == reserved_opcode) return DecodeError::bad_value;
  const std::size_t size = opcode_size(payload.front());
  if (payload.size() < size) return DecodeError::too_short;
  AccessMessage message;
  for (const std::uint8_t octet : payload.first(size)) message.opcode = message.opcode << 8 | octet;
  message.params = payload.subspan(size);
  return message;
}

Bytes encode_access(Opcode opcode, ByteView params) {
  ByteWriter payload;
  if (opcode > 0xffff) payload.write_u8(static_cast<std::uint8_t>(opcode >> 16));
  if (opcode > 0xff) payload.write_u8(static_cast<std::uint8_t>(opcode >> 8));
  payload.write_u8(static_cast<std::uint8_t>(opcode)).write(params);
  return payload.take();
}

std::size_t segments_of(std::size_t access_bytes) {
  if (access_bytes <= max_unsegmented_bytes) return 1;
  return (access_bytes + transmic_bytes + segment_bytes - 1) / segment_bytes;
}

namespace {

// c5..c8 min_com, c9..cc sensor_update, cd..d0 pos_cmd; d1, d2, d3 their SET_NUMBERED; d4
// SENSOR_UPDATE_RELAYED; then company 0x0059, little-endian.
constexpr Opcode first_opcode = 0xc55900;
constexpr Opcode opcode_step = 0x010000;
constexpr Opcode kinds = 4;
constexpr Opcode first_numbered = vendor_model_count * kinds;
constexpr Opcode sensor_update_relayed = 0xd45900;
constexpr Opcode generic_on_off_set = 0x8202;
constexpr Opcode simple_on_off_set = 0xc15900;

}  // namespace

Opcode opcode_of(VendorMessage message) {
  const auto model = static_cast<Opcode>(message.model);
  const Opcode place = message.kind == MessageKind::set_numbered
                           ? first_numbered + model
                           : model * kinds + static_cast<Opcode>(message.kind);
  return first_opcode + opcode_step * place;
}

std::optional<VendorMessage> vendor_message_of(Opcode opcode) {
  if (opcode < first_opcode || (opcode - first_opcode) % opcode_step != 0) return std::nullopt;
  const Opcode place = (opcode - first_opcode) / opcode_step;
  if (place < first_numbered)
    return VendorMessage{static_cast<VendorModel>(place / kinds),
                         static_cast<MessageKind>(place % kinds)};
  if (place - first_numbered >= vendor_model_count) return std::nullopt;
  return VendorMessage{static_cast<VendorModel>(place - first_numbered), MessageKind::set_numbered};
}

Bytes encode_status(VendorModel model, std::optional<std::uint8_t> number) {
  Bytes parameters{0};
  if (number) parameters.push_back(*number);
  return encode_access(opcode_of({model, MessageKind::status}), parameters);
}

Bytes encode_relayed_update(std::uint16_t sender, ByteView update) {
  return encode_access(sensor_update_relayed, octets_of(sender, update));
}

Bytes encode_on_off_set(OnOffModel model, bool is_on, std::uint8_t tid) {
  return encode_access(model == OnOffModel::generic ? generic_on_off_set : simple_on_off_set,
                       octets_of(std::uint8_t{is_on}, tid));
}

Opcode on_off_status(OnOffModel model) {
  return model == OnOffModel::generic ? generic_on_off_status : simple_on_off_status;
}

Duration reliable_interval(std::uint8_t ttl, std::size_t access_bytes) {
  const std::size_t segments = segments_of(access_bytes);
  return std::chrono::milliseconds{200 + 20 * ttl} +
         std::chrono::milliseconds{20} * (segments > 1 ? static_cast<long>(segments) : 0L);
}

}  // namespace slamgw::ble
