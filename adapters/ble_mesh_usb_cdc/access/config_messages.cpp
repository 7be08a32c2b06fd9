// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/access/config_messages.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>

namespace slamgw::ble {
namespace {

constexpr Opcode appkey_add = 0x00;
constexpr Opcode appkey_update = 0x01;
constexpr Opcode model_publication_set = 0x03;
constexpr Opcode composition_data_get = 0x8008;
constexpr Opcode default_ttl_get = 0x800c;
constexpr Opcode default_ttl_set = 0x800d;
constexpr Opcode key_refresh_phase_set = 0x8016;
constexpr Opcode model_publication_get = 0x8018;
constexpr Opcode network_transmit_get = 0x8023;
constexpr Opcode network_transmit_set = 0x8024;
constexpr Opcode relay_get = 0x8026;
constexpr Opcode relay_set = 0x8027;
constexpr Opcode model_subscription_add = 0x801b;
constexpr Opcode model_subscription_delete = 0x801c;
constexpr Opcode model_subscription_delete_all = 0x801d;
constexpr Opcode sig_model_subscription_get = 0x8029;
constexpr Opcode vendor_model_subscription_get = 0x802b;
constexpr Opcode heartbeat_publication_set = 0x8039;
constexpr Opcode heartbeat_subscription_get = 0x803a;
constexpr Opcode heartbeat_subscription_set = 0x803b;
constexpr Opcode model_app_bind = 0x803d;
constexpr Opcode netkey_update = 0x8045;
constexpr Opcode node_reset = 0x8049;
constexpr std::uint16_t net_key_index = 0;
constexpr std::uint16_t app_key_index = 0;
/// Two of 12 bits each.
constexpr std::array<std::uint8_t, 3> key_indexes{};
constexpr std::size_t composition_head_bytes = 8;  // product, version, CRPL, features

Bytes encode_subscription(Opcode opcode, std::uint16_t element, std::uint16_t group,
                          const ModelId& model) {
  return encode_access(
      opcode,
      ByteWriter{}.write_u16_le(element).write_u16_le(group).write(encode_model_id(model)).bytes());
}

}  // namespace

std::string to_string(const ModelId& model) {
  if (model.company) return fmt::format("0x{:04x}:0x{:04x}", *model.company, model.number);
  return fmt::format("0x{:04x}", model.number);
}

Bytes encode_model_id(const ModelId& model) {
  ByteWriter out;
  if (model.company) out.write_u16_le(*model.company);
  return out.write_u16_le(model.number).take();
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

Bytes encode_composition_data_get() {
  return encode_access(composition_data_get, std::array<std::uint8_t, 1>{0});
}

Bytes encode_appkey_add_message(const Key& app_key) {
  return encode_access(appkey_add, ByteWriter{}.write(key_indexes).write(app_key).bytes());
}

Bytes encode_netkey_update(const Key& net_key) {
  return encode_access(netkey_update,
                       ByteWriter{}.write_u16_le(net_key_index).write(net_key).bytes());
}

Bytes encode_appkey_update(const Key& app_key) {
  return encode_access(appkey_update, ByteWriter{}.write(key_indexes).write(app_key).bytes());
}

Bytes encode_key_refresh_phase_set(std::uint8_t transition) {
  return encode_access(key_refresh_phase_set,
                       ByteWriter{}.write_u16_le(net_key_index).write_u8(transition).bytes());
}

Bytes encode_model_app_bind(std::uint16_t element, const ModelId& model) {
  return encode_access(model_app_bind, ByteWriter{}
                                           .write_u16_le(element)
                                           .write_u16_le(app_key_index)
                                           .write(encode_model_id(model))
                                           .bytes());
}

Bytes encode_model_publication_set(const Publication& publication) {
  return encode_access(model_publication_set,
                       ByteWriter{}
                           .write_u16_le(publication.element)
                           .write_u16_le(publication.address)
                           .write_u16_le(app_key_index)  // and no friendship credentials
                           .write_u8(std::min(publication.ttl, max_publish_ttl))
                           .write_u8(publication.period)
                           .write_u8(publication.retransmit_count)  // and no interval steps
                           .write(encode_model_id(publication.model))
                           .bytes());
}

Bytes encode_model_subscription_add(std::uint16_t element, std::uint16_t group,
                                    const ModelId& model) {
  return encode_subscription(model_subscription_add, element, group, model);
}

Bytes encode_model_subscription_delete(std::uint16_t element, std::uint16_t group,
                                       const ModelId& model) {
  return encode_subscription(model_subscription_delete, element, group, model);
}

Bytes encode_model_subscription_delete_all(std::uint16_t element, const ModelId& model) {
  return encode_access(model_subscription_delete_all,
                       ByteWriter{}.write_u16_le(element).write(encode_model_id(model)).bytes());
}

Bytes encode_model_subscription_get(std::uint16_t element, const ModelId& model) {
  return encode_access(model.company ? vendor_model_subscription_get : sig_model_subscription_get,
                       ByteWriter{}.write_u16_le(element).write(encode_model_id(model)).bytes());
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
  reader.read_u16_le();  // application key, and whether with friendship credentials
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

Bytes encode_model_publication_get(std::uint16_t element, const ModelId& model) {
  return encode_access(model_publication_get,
                       ByteWriter{}.write_u16_le(element).write(encode_model_id(model)).bytes());
}

Bytes encode_default_ttl_get() { return encode_access(default_ttl_get, {}); }

Bytes encode_default_ttl_set(std::uint8_t ttl) {
  return encode_access(default_ttl_set, std::array{ttl});
}

Bytes encode_relay_get() { return encode_access(relay_get, {}); }

Bytes encode_relay_set(bool is_on) {
  const std::uint8_t state = is_on ? 1 : 0;
  return encode_access(relay_set, std::array{state, encode_transmissions(relay_transmissions)});
}

Bytes encode_network_transmit_get() { return encode_access(network_transmit_get, {}); }

Bytes encode_network_transmit_set(const Transmissions& transmissions) {
  return encode_access(network_transmit_set, std::array{encode_transmissions(transmissions)});
}

Bytes encode_node_reset() { return encode_access(node_reset, {}); }

// Counts and periods of heartbeats are the power of two that is told by its exponent plus one (Mesh
// Profile 1.0 table 4.1); 0: none.

Bytes encode_heartbeat_publication_set(std::uint16_t destination, std::uint8_t ttl) {
  const bool is_on = destination != 0;
  constexpr std::uint8_t count_log = 4;  // eight
  static_assert(heartbeats == 1U << (count_log - 1));
  return encode_access(heartbeat_publication_set, ByteWriter{}
                                                      .write_u16_le(destination)
                                                      .write_u8(is_on ? count_log : std::uint8_t{0})
                                                      .write_u8(is_on ? 1 : 0)  // 1 s
                                                      .write_u8(std::min(ttl, max_publish_ttl))
                                                      .write_u16_le(0)
                                                      .write_u16_le(net_key_index)
                                                      .bytes());
}

Bytes encode_heartbeat_subscription_set(std::uint16_t source, std::uint16_t destination) {
  constexpr std::uint8_t period_log = 9;  // 256 s
  return encode_access(heartbeat_subscription_set,
                       ByteWriter{}
                           .write_u16_le(source)
                           .write_u16_le(destination)
                           .write_u8(destination != 0 ? period_log : std::uint8_t{0})
                           .bytes());
}

Bytes encode_heartbeat_subscription_get() { return encode_access(heartbeat_subscription_get, {}); }

std::optional<HeartbeatCount> decode_heartbeat_count(ByteView params) {
  ByteReader reader(params);
  reader.read_u8();  // status
  HeartbeatCount count;
  count.source = reader.read_u16_le();
  reader.read_u16_le();  // destination
  reader.read_u8();      // time that is left
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
