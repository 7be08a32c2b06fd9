// SPDX-License-Identifier: Apache-2.0
// Configuration messages to a node and its answers (Mesh Profile 1.0 section 4.3.2), as access
// messages with their opcode. Both keys have index 0. Numbers are little-endian; a vendor model's
// company comes before its model number. Called by NodeConfiguration.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/access/robot_models.hpp"
#include "adapters/ble_mesh_usb_cdc/octets.hpp"
#include "adapters/ble_mesh_usb_cdc/radio.hpp"
#include "daemon/core/operator_order.hpp"

namespace slamgw::ble {

inline constexpr Opcode composition_data_status = 0x02;
inline constexpr Opcode heartbeat_publication_status = 0x06;
inline constexpr Opcode appkey_status = 0x8003;
inline constexpr Opcode default_ttl_status = 0x800e;
inline constexpr Opcode network_transmit_status = 0x8025;
inline constexpr Opcode relay_status = 0x8028;
inline constexpr Opcode model_publication_status = 0x8019;
inline constexpr Opcode model_subscription_status = 0x801f;
inline constexpr Opcode sig_model_subscription_list = 0x802a;
inline constexpr Opcode vendor_model_subscription_list = 0x802c;
inline constexpr Opcode key_refresh_phase_status = 0x8017;
inline constexpr Opcode heartbeat_subscription_status = 0x803c;
inline constexpr Opcode model_app_status = 0x803e;
inline constexpr Opcode netkey_status = 0x8044;
inline constexpr Opcode node_reset_status = 0x804a;

struct ModelId {
  std::optional<std::uint16_t> company;  ///< empty: a model of the Bluetooth SIG
  std::uint16_t number = 0;
  bool operator==(const ModelId&) const = default;
};
/// Returns text such as `0x1000` or `0x0059:0x0006`.
std::string to_string(const ModelId& model);
Bytes encode_model_id(const ModelId& model);

struct Composition {
  std::uint16_t company = 0;                   ///< the node's maker
  std::vector<std::vector<ModelId>> elements;  ///< the models of each; primary element first
};
/// Decodes the parameters of Composition Data Status; page 0 only.
Result<Composition, DecodeError> decode_composition(ByteView params);

/// Returns the addresses in a SIG or Vendor Model Subscription List, in its order: groups, and the
/// hashes of virtual addresses. `params` must be of an answer that repeats the element and `model`.
/// An address that is cut short is left out.
std::vector<std::uint16_t> decode_subscription_list(ByteView params, const ModelId& model);

/// A model's publication, as in Model Publication Status.
struct PublicationState {
  std::uint16_t address = 0;  ///< 0: the model does not publish
  std::uint8_t ttl = 0;       ///< 0xff: the node's default TTL
};
/// `params` as for decode_subscription_list().
std::optional<PublicationState> decode_publication(ByteView params);

// One octet: three bits of a count and five bits of steps of 10 ms, both minus one (Mesh Profile
// 1.0 sections 4.2.19 and 4.2.20).
std::uint8_t encode_transmissions(const Transmissions& transmissions);
Transmissions decode_transmissions(std::uint8_t octet);

/// The largest TTL of Mesh Profile 1.0 section 4.2.2.5. Robots that run Nordic's code up to release
/// 4.2.0 stop on a failed assertion when they are configured to publish with 128 to 254.
inline constexpr std::uint8_t max_publish_ttl = 127;

struct Publication {
  std::uint16_t element = 0;
  std::uint16_t address = 0;  ///< destination
  std::uint8_t ttl = 0;       ///< sent as at most max_publish_ttl
  std::uint8_t period = 0;    ///< steps, and their resolution in the upper two bits; 0: none
  ModelId model;
  std::uint8_t retransmit_count = 0;  ///< 50 ms apart
};
/// A period of 10 s (health_interval): ten steps of one second.
inline constexpr std::uint8_t period_10_s = 0x4a;

// The messages to a node, with their opcodes (Mesh Profile 1.0 section 4.3.4).

/// Key index 0, of the network key and of the application key; packed together, both have 12 bits.
inline constexpr std::uint16_t key_index_0 = 0;
inline constexpr std::array<std::uint8_t, 3> key_indexes_0{};

/// Asks for page 0.
inline Bytes encode_composition_data_get() {
  return encode_access(0x8008, octets_of(std::uint8_t{0}));
}
inline Bytes encode_appkey_add_message(const Key& app_key) {
  return encode_access(0x00, octets_of(key_indexes_0, app_key));
}
/// The new keys of a key refresh (Mesh Profile 1.0 section 3.10.4).
inline Bytes encode_netkey_update(const Key& net_key) {
  return encode_access(0x8045, octets_of(key_index_0, net_key));
}
inline Bytes encode_appkey_update(const Key& app_key) {
  return encode_access(0x01, octets_of(key_indexes_0, app_key));
}
/// `transition`: 2, to send under the new keys, or 3, to forget the old ones.
inline Bytes encode_key_refresh_phase_set(std::uint8_t transition) {
  return encode_access(0x8016, octets_of(key_index_0, transition));
}
inline Bytes encode_model_app_bind(std::uint16_t element, const ModelId& model) {
  return encode_access(0x803d, octets_of(element, key_index_0, encode_model_id(model)));
}
Bytes encode_model_publication_set(const Publication& publication);
inline Bytes encode_model_publication_get(std::uint16_t element, const ModelId& model) {
  return encode_access(0x8018, octets_of(element, encode_model_id(model)));
}
inline Bytes encode_model_subscription_add(std::uint16_t element, std::uint16_t group,
                                           const ModelId& model) {
  return encode_access(0x801b, octets_of(element, group, encode_model_id(model)));
}
inline Bytes encode_model_subscription_delete(std::uint16_t element, std::uint16_t group,
                                              const ModelId& model) {
  return encode_access(0x801c, octets_of(element, group, encode_model_id(model)));
}
inline Bytes encode_model_subscription_delete_all(std::uint16_t element, const ModelId& model) {
  return encode_access(0x801d, octets_of(element, encode_model_id(model)));
}
/// SIG or Vendor Model Subscription Get.
inline Bytes encode_model_subscription_get(std::uint16_t element, const ModelId& model) {
  return encode_access(model.company ? 0x802b : 0x8029, octets_of(element, encode_model_id(model)));
}
inline Bytes encode_default_ttl_get() { return encode_access(0x800c, {}); }
inline Bytes encode_default_ttl_set(std::uint8_t ttl) {
  return encode_access(0x800d, octets_of(ttl));
}
inline Bytes encode_relay_get() { return encode_access(0x8026, {}); }
/// Number and interval of the transmissions with which a relay sends each packet of other nodes.
inline constexpr Transmissions relay_transmissions{3, 20};
inline Bytes encode_relay_set(bool is_on) {
  return encode_access(0x8027,
                       octets_of(std::uint8_t{is_on}, encode_transmissions(relay_transmissions)));
}
inline Bytes encode_network_transmit_get() { return encode_access(0x8023, {}); }
inline Bytes encode_network_transmit_set(const Transmissions& transmissions) {
  return encode_access(0x8024, octets_of(encode_transmissions(transmissions)));
}
inline Bytes encode_node_reset() { return encode_access(0x8049, {}); }

/// Number of heartbeats that a node publishes on request: the first at once, then one each second.
inline constexpr std::uint32_t heartbeats = 8;
/// Publishes to this group, without features that trigger further heartbeats. Destination 0 stops
/// the publication.
Bytes encode_heartbeat_publication_set(std::uint16_t destination, std::uint8_t ttl);
/// The node counts heartbeats of this source to this group for 256 s. Zeros end the counting.
Bytes encode_heartbeat_subscription_set(std::uint16_t source, std::uint16_t destination);
inline Bytes encode_heartbeat_subscription_get() { return encode_access(0x803a, {}); }

/// The count in Heartbeat Subscription Status, as a range: nodes report only its highest bit.
struct HeartbeatCount {
  std::uint16_t source = 0;
  std::uint32_t least = 0;
  std::uint32_t most = 0;
  std::uint8_t min_hops = 0;  ///< 1: without relays
  std::uint8_t max_hops = 0;
};
std::optional<HeartbeatCount> decode_heartbeat_count(ByteView params);

/// The status of a model that does not support subscriptions.
inline constexpr std::uint8_t not_a_subscribe_model = 0x08;
/// Returns the meaning of a configuration message's status octet (Mesh Profile 1.0 table 4.108).
std::string_view config_status_text(std::uint8_t status);

}  // namespace slamgw::ble
