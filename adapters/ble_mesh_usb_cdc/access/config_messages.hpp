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

/// A period of 10 s (health_interval): ten steps of one second.
inline constexpr std::uint8_t period_10_s = 0x4a;

/// A request to a node, and its answer (Mesh Profile 1.0 section 4.3.4).
struct Exchange {
  Opcode request = 0;
  Opcode answer = 0;
  bool has_status = true;  ///< the answer's first octet is a status
  std::size_t echoed = 0;  ///< the answer goes on with this many octets of the request's parameters
};

/// Key index 0, of the network key and of the application key; packed together, both have 12 bits.
inline constexpr std::uint16_t key_index_0 = 0;
inline constexpr std::array<std::uint8_t, 3> key_indexes_0{};

inline constexpr Exchange composition_data_get{0x8008, 0x02, false, 1};
inline constexpr Exchange appkey_add{0x00, 0x8003, true, 3};
// The new keys of a key refresh (section 3.10.4). The phase is set by a transition: 2, to send
// under the new keys, or 3, to forget the old ones.
inline constexpr Exchange netkey_update{0x8045, 0x8044, true, 2};
inline constexpr Exchange appkey_update{0x01, 0x8003, true, 3};
inline constexpr Exchange key_refresh_phase_set{0x8016, 0x8017, true, 2};
// About one model of one element: the address of the element comes first, the model last.
inline constexpr Exchange model_app_bind{0x803d, 0x803e, true, 2};
inline constexpr Exchange model_publication_set{0x03, 0x8019, true, 2};
inline constexpr Exchange model_publication_get{0x8018, 0x8019, true, 2};
inline constexpr Exchange model_subscription_add{0x801b, 0x801f, true, 4};
inline constexpr Exchange model_subscription_delete{0x801c, 0x801f, true, 4};
inline constexpr Exchange model_subscription_delete_all{0x801d, 0x801f, true, 2};
inline constexpr Exchange sig_model_subscription_get{0x8029, 0x802a, true, 4};
inline constexpr Exchange vendor_model_subscription_get{0x802b, 0x802c, true, 6};
inline constexpr Exchange default_ttl_get{0x800c, 0x800e, false};
inline constexpr Exchange default_ttl_set{0x800d, 0x800e, false};
inline constexpr Exchange relay_get{0x8026, 0x8028, false};
inline constexpr Exchange relay_set{0x8027, 0x8028, false};
inline constexpr Exchange network_transmit_get{0x8023, 0x8025, false};
inline constexpr Exchange network_transmit_set{0x8024, 0x8025, false};
inline constexpr Exchange node_reset{0x8049, 0x804a, false};
inline constexpr Exchange heartbeat_publication_set{0x8039, 0x06, true, 2};
inline constexpr Exchange heartbeat_subscription_set{0x803b, 0x803c, true, 4};
inline constexpr Exchange heartbeat_subscription_get{0x803a, 0x803c};

/// Number and interval of the transmissions with which a relay sends each packet of other nodes.
inline constexpr Transmissions relay_transmissions{3, 20};

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
