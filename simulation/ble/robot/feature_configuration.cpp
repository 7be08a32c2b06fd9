// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/robot/feature_configuration.hpp"

namespace slamgw::sim::ble {
namespace {

constexpr std::uint16_t beacon_status_op = 0x800b;
constexpr std::uint16_t default_ttl_status_op = 0x800e;
constexpr std::uint16_t friend_status_op = 0x8011;
constexpr std::uint16_t proxy_status_op = 0x8014;
constexpr std::uint16_t network_transmit_status_op = 0x8025;
constexpr std::uint16_t relay_status_op = 0x8028;

constexpr std::uint8_t not_supported = 0x02;

Bytes status(std::uint16_t opcode, std::uint8_t value) {
  Bytes out = begin_message(opcode);
  put_u8(out, value);
  return out;
}

/// Returns true for one octet, 0 or 1.
bool is_switch(ByteView parameters) { return parameters.size() == 1 && parameters[0] <= 1; }

}  // namespace

std::optional<Answer> FeatureConfiguration::on_message(std::uint16_t opcode, ByteView parameters) {
  using Self = FeatureConfiguration;
  static constexpr ConfigRequest<Self> requests[] = {
      {0x8009, &Self::beacon_get},
      {0x800a, &Self::beacon_set},
      {0x800c, &Self::default_ttl_get},
      {0x800d, &Self::default_ttl_set},
      {0x800f, &Self::friend_get},
      {0x8010, &Self::friend_set},
      {0x8012, &Self::proxy_get},
      {0x8013, &Self::proxy_set},
      {0x8023, &Self::network_transmit_get},
      {0x8024, &Self::network_transmit_set},
      {0x8026, &Self::relay_get},
      {0x8027, &Self::relay_set},
  };
  return answer_request(requests, *this, opcode, parameters);
}

Answer FeatureConfiguration::beacon_get(ByteView parameters) {
  if (!parameters.empty()) return std::nullopt;
  return status(beacon_status_op, configuration_.secure_network_beacon);
}

Answer FeatureConfiguration::beacon_set(ByteView parameters) {
  if (!is_switch(parameters)) return std::nullopt;
  configuration_.secure_network_beacon = parameters[0];
  return status(beacon_status_op, parameters[0]);
}

Answer FeatureConfiguration::default_ttl_get(ByteView parameters) {
  if (!parameters.empty()) return std::nullopt;
  return status(default_ttl_status_op, configuration_.ttl);
}

/// Accepts 0 and 2 to 127 (section 4.2.7).
Answer FeatureConfiguration::default_ttl_set(ByteView parameters) {
  if (parameters.size() != 1 || parameters[0] == 1 || parameters[0] > 127) return std::nullopt;
  configuration_.ttl = parameters[0];
  return status(default_ttl_status_op, parameters[0]);
}

Answer FeatureConfiguration::friend_get(ByteView parameters) {
  if (!parameters.empty()) return std::nullopt;
  return status(friend_status_op, not_supported);
}

Answer FeatureConfiguration::friend_set(ByteView parameters) {
  if (!is_switch(parameters)) return std::nullopt;
  return status(friend_status_op, not_supported);
}

Answer FeatureConfiguration::proxy_get(ByteView parameters) {
  if (!parameters.empty()) return std::nullopt;
  return status(proxy_status_op, not_supported);
}

Answer FeatureConfiguration::proxy_set(ByteView parameters) {
  if (!is_switch(parameters)) return std::nullopt;
  return status(proxy_status_op, not_supported);
}

Answer FeatureConfiguration::relay_get(ByteView parameters) {
  if (!parameters.empty()) return std::nullopt;
  Bytes out = status(relay_status_op, configuration_.relay);
  put_u8(out, configuration_.relay_retransmit);
  return out;
}

Answer FeatureConfiguration::relay_set(ByteView parameters) {
  if (parameters.size() != 2 || parameters[0] > 1) return std::nullopt;
  configuration_.relay = parameters[0];
  configuration_.relay_retransmit = parameters[1];
  return relay_get({});
}

Answer FeatureConfiguration::network_transmit_get(ByteView parameters) {
  if (!parameters.empty()) return std::nullopt;
  return status(network_transmit_status_op, configuration_.network_transmit);
}

Answer FeatureConfiguration::network_transmit_set(ByteView parameters) {
  if (parameters.size() != 1) return std::nullopt;
  configuration_.network_transmit = parameters[0];
  return network_transmit_get({});
}

}  // namespace slamgw::sim::ble
