// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/access/config_messages.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>

namespace slamgw::ble {
namespace {

constexpr std::size_t composition_head_bytes = 8;  // product, version, CRPL, features

}  // namespace

std::string to_string(const ModelId& model) {
  if (model.company) return fmt::format("0x{:04x}:0x{:04x}", *model.company, model.number);
  return fmt::format("0x{:04x}", model.number);
}

Bytes encode_model_id(const ModelId& model) {
  return model.company ? octets_of(*model.company, model.number) : octets_of(model.number);
}

Result<Composition, DecodeError> decode_composition(ByteView params) {
  ByteReader reader(params);
  if (reader.read_u8() != 0) return DecodeError::bad_value;
  Composition composition;
  composition.company = reader.read_u16_le();
  reader.read(composition_head_bytes);
  while (reader.ok() && reader.remaining() > 0) {
    reader.read_u16_le();  // location
    const std::uint8_t sig_models = reader.read_u8();
    const std::uint8_t vendor_models = reader.read_u8();
    std::vector<ModelId> models;
    for (int i = 0; i < sig_models && reader.ok(); ++i)
      models.push_back({{}, reader.read_u16_le()});
    for (int i = 0; i < vendor_models && reader.ok(); ++i) {
      const std::uint16_t company = reader.read_u16_le();
      models.push_back({company, reader.read_u16_le()});
    }
    composition.elements.push_back(std::move(models));
  }
  if (!reader.ok() || composition.elements.empty()) return DecodeError::too_short;
  return composition;
}

std::vector<std::uint16_t> decode_subscription_list(ByteView params, const ModelId& model) {
  ByteReader reader(params);
  reader.read(1 + sizeof(std::uint16_t) + encode_model_id(model).size());  // status and element
  std::vector<std::uint16_t> addresses;
  while (reader.ok() && reader.remaining() >= sizeof(std::uint16_t))
    addresses.push_back(reader.read_u16_le());
  return addresses;
}

std::optional<PublicationState> decode_publication(ByteView params) {
  ByteReader reader(params);
  reader.read(1 + sizeof(std::uint16_t));  // status and element
  PublicationState state;
  state.address = reader.read_u16_le();
  reader.read_u16_le();  // application key index and credential flag
  state.ttl = reader.read_u8();
  return reader.ok() ? std::optional(state) : std::nullopt;
}

constexpr unsigned step_ms = 10;
constexpr unsigned count_bits = 3;

std::uint8_t encode_transmissions(const Transmissions& transmissions) {
  const unsigned steps = transmissions.interval_ms / step_ms - 1;
  return static_cast<std::uint8_t>((transmissions.sends - 1U) | steps << count_bits);
}

Transmissions decode_transmissions(std::uint8_t octet) {
  constexpr unsigned count_mask = (1U << count_bits) - 1;
  return {static_cast<std::uint8_t>((octet & count_mask) + 1),
          static_cast<std::uint16_t>(((octet >> count_bits) + 1) * step_ms)};
}

/// Heartbeat counts are powers of two, encoded as the exponent plus one (Mesh Profile 1.0 table
/// 4.1); 0 means none.
std::optional<HeartbeatCount> decode_heartbeat_count(ByteView params) {
  ByteReader reader(params);
  reader.read_u8();  // status
  HeartbeatCount count;
  count.source = reader.read_u16_le();
  reader.read_u16_le();  // destination
  reader.read_u8();      // remaining time
  constexpr std::uint8_t max_count_log = 16;
  const std::uint8_t count_log = std::min(reader.read_u8(), max_count_log);
  count.least = count_log == 0 ? 0 : 1U << (count_log - 1U);
  count.most = (1U << count_log) - 1U;
  count.min_hops = reader.read_u8();
  count.max_hops = reader.read_u8();
  return reader.ok() ? std::optional(count) : std::nullopt;
}

std::string_view config_status_text(std::uint8_t status) {
  constexpr std::array<std::string_view, 0x12> texts{"success",
                                                     "invalid address",
                                                     "invalid model",
                                                     "invalid application key index",
                                                     "invalid network key index",
                                                     "insufficient resources",
                                                     "key index already stored, with another key",
                                                     "invalid publish parameters",
                                                     "not a subscribe model",
                                                     "storage failure",
                                                     "feature not supported",
                                                     "cannot update",
                                                     "cannot remove",
                                                     "cannot bind",
                                                     "temporarily unable to change state",
                                                     "cannot set",
                                                     "unspecified error",
                                                     "invalid binding"};
  return status < texts.size() ? texts[status] : "unlisted status";
}

}  // namespace slamgw::ble
