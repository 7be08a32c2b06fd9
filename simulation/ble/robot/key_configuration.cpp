// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/robot/key_configuration.hpp"

#include <algorithm>

namespace slamgw::sim::ble {
namespace {

constexpr std::uint16_t app_key_add_op = 0x00;
constexpr std::uint16_t app_key_update_op = 0x01;
constexpr std::uint16_t app_key_delete_op = 0x8000;
constexpr std::uint16_t app_key_get_op = 0x8001;
constexpr std::uint16_t app_key_list_op = 0x8002;
constexpr std::uint16_t app_key_status_op = 0x8003;
constexpr std::uint16_t phase_get_op = 0x8015;
constexpr std::uint16_t phase_set_op = 0x8016;
constexpr std::uint16_t phase_status_op = 0x8017;
constexpr std::uint16_t net_key_add_op = 0x8040;
constexpr std::uint16_t net_key_delete_op = 0x8041;
constexpr std::uint16_t net_key_get_op = 0x8042;
constexpr std::uint16_t net_key_list_op = 0x8043;
constexpr std::uint16_t net_key_status_op = 0x8044;
constexpr std::uint16_t net_key_update_op = 0x8045;
constexpr std::uint16_t identity_get_op = 0x8046;
constexpr std::uint16_t identity_set_op = 0x8047;
constexpr std::uint16_t identity_status_op = 0x8048;

constexpr std::uint8_t identity_not_supported = 0x02;
constexpr std::uint8_t transition_to_phase_2 = 2;
constexpr std::uint8_t transition_to_phase_3 = 3;

/// Returns status and the message's key index, or indexes.
Bytes key_status(std::uint16_t opcode, ConfigStatus status, ByteView indexes) {
  Bytes out = begin_status(opcode, status);
  put(out, indexes);
  return out;
}

Bytes phase_status(ConfigStatus status, std::uint16_t net_index, KeyRefreshPhase phase) {
  Bytes out = begin_status(phase_status_op, status);
  put_u16_le(out, net_index);
  put_u8(out, static_cast<std::uint8_t>(phase));
  return out;
}

}  // namespace

std::optional<Answer> KeyConfiguration::on_message(std::uint16_t opcode, ByteView parameters) {
  using Self = KeyConfiguration;
  static constexpr ConfigRequest<Self> requests[] = {
      {app_key_add_op, &Self::app_key_add},       {app_key_update_op, &Self::app_key_update},
      {app_key_delete_op, &Self::app_key_delete}, {app_key_get_op, &Self::app_key_get},
      {net_key_add_op, &Self::net_key_add},       {net_key_update_op, &Self::net_key_update},
      {net_key_delete_op, &Self::net_key_delete}, {net_key_get_op, &Self::net_key_get},
      {phase_get_op, &Self::phase_get},           {phase_set_op, &Self::phase_set},
      {identity_get_op, &Self::identity_get},     {identity_set_op, &Self::identity_set},
  };
  return answer_request(requests, *this, opcode, parameters);
}

Answer KeyConfiguration::net_key_add(ByteView parameters) {
  if (parameters.size() != 2 + sizeof(Key)) return std::nullopt;
  const std::uint16_t index = get_u16_le(parameters, 0);
  return key_status(net_key_status_op, store_net_key(index, key_at(parameters, 2)),
                    parameters.first(2));
}

ConfigStatus KeyConfiguration::store_net_key(std::uint16_t index, const Key& key) {
  if (const NetKey* known = configuration_.find_net_key(index)) {
    return known->key == key ? ConfigStatus::success : ConfigStatus::key_index_already_stored;
  }
  if (configuration_.net_keys.size() >= NodeConfiguration::max_net_keys) {
    return ConfigStatus::insufficient_resources;
  }
  configuration_.net_keys.push_back({index, key});
  return ConfigStatus::success;
}

Answer KeyConfiguration::net_key_update(ByteView parameters) {
  if (parameters.size() != 2 + sizeof(Key)) return std::nullopt;
  const std::uint16_t index = get_u16_le(parameters, 0);
  return key_status(net_key_status_op, renew_net_key(index, key_at(parameters, 2)),
                    parameters.first(2));
}

/// Begins a key refresh; later only the same key is accepted.
ConfigStatus KeyConfiguration::renew_net_key(std::uint16_t index, const Key& key) {
  NetKey* known = configuration_.find_net_key(index);
  if (known == nullptr) return ConfigStatus::invalid_net_key_index;
  if (known->new_key && *known->new_key != key) return ConfigStatus::cannot_update;
  if (!known->new_key) known->phase = KeyRefreshPhase::distribution;
  known->new_key = key;
  return ConfigStatus::success;
}

Answer KeyConfiguration::net_key_delete(ByteView parameters) {
  if (parameters.size() != 2) return std::nullopt;
  return key_status(net_key_status_op, remove_net_key(get_u16_le(parameters, 0)), parameters);
}

/// Deletes a key. An unknown key is a success; the key of the message itself stays.
ConfigStatus KeyConfiguration::remove_net_key(std::uint16_t index) {
  if (configuration_.find_net_key(index) == nullptr) return ConfigStatus::success;
  if (configuration_.net_keys.front().index == index) return ConfigStatus::cannot_remove;
  std::erase_if(configuration_.net_keys, [&](const NetKey& key) { return key.index == index; });
  const std::vector<AppKey> app_keys = configuration_.app_keys;
  for (const AppKey& key : app_keys) {
    if (key.net_index == index) remove_app_key(key.index);
  }
  return ConfigStatus::success;
}

Answer KeyConfiguration::net_key_get(ByteView parameters) {
  if (!parameters.empty()) return std::nullopt;
  std::vector<std::uint16_t> indexes;
  for (const NetKey& key : configuration_.net_keys) indexes.push_back(key.index);
  Bytes out = begin_message(net_key_list_op);
  put_key_indexes(out, indexes);
  return out;
}

Answer KeyConfiguration::app_key_add(ByteView parameters) {
  if (parameters.size() != 3 + sizeof(Key)) return std::nullopt;
  const auto [net_index, app_index] = key_indexes(parameters);
  const AppKey key{app_index, key_at(parameters, 3), {}, net_index};
  return key_status(app_key_status_op, store_app_key(key), parameters.first(3));
}

ConfigStatus KeyConfiguration::store_app_key(const AppKey& key) {
  if (configuration_.find_net_key(key.net_index) == nullptr) {
    return ConfigStatus::invalid_net_key_index;
  }
  if (const AppKey* known = configuration_.find_app_key(key.index)) {
    return known->key == key.key ? ConfigStatus::success : ConfigStatus::key_index_already_stored;
  }
  if (configuration_.app_keys.size() >= NodeConfiguration::max_app_keys) {
    return ConfigStatus::insufficient_resources;
  }
  configuration_.app_keys.push_back(key);
  return ConfigStatus::success;
}

Answer KeyConfiguration::app_key_update(ByteView parameters) {
  if (parameters.size() != 3 + sizeof(Key)) return std::nullopt;
  const auto [net_index, app_index] = key_indexes(parameters);
  return key_status(app_key_status_op, renew_app_key(net_index, app_index, key_at(parameters, 3)),
                    parameters.first(3));
}

/// Allowed only in the first phase of a key refresh.
ConfigStatus KeyConfiguration::renew_app_key(std::uint16_t net_index, std::uint16_t index,
                                             const Key& key) {
  const NetKey* net_key = configuration_.find_net_key(net_index);
  if (net_key == nullptr) return ConfigStatus::invalid_net_key_index;
  const auto known = std::find_if(configuration_.app_keys.begin(), configuration_.app_keys.end(),
                                  [&](const AppKey& own) { return own.index == index; });
  if (known == configuration_.app_keys.end()) return ConfigStatus::invalid_app_key_index;
  const bool is_other = known->new_key && *known->new_key != key;
  if (net_key->phase != KeyRefreshPhase::distribution || is_other) {
    return ConfigStatus::cannot_update;
  }
  known->new_key = key;
  return ConfigStatus::success;
}

/// Deletes a key; an unknown key is a success.
Answer KeyConfiguration::app_key_delete(ByteView parameters) {
  if (parameters.size() != 3) return std::nullopt;
  const auto [net_index, app_index] = key_indexes(parameters);
  const bool has_network = configuration_.find_net_key(net_index) != nullptr;
  if (has_network) remove_app_key(app_index);
  return key_status(app_key_status_op,
                    has_network ? ConfigStatus::success : ConfigStatus::invalid_net_key_index,
                    parameters);
}

/// Removes a key with its bindings and publications.
void KeyConfiguration::remove_app_key(std::uint16_t index) {
  std::erase_if(configuration_.app_keys, [&](const AppKey& key) { return key.index == index; });
  for (Model& model : configuration_.models) {
    std::erase(model.bindings, index);
    if (model.publication.app_key_index == index) model.publication = {};
  }
}

Answer KeyConfiguration::app_key_get(ByteView parameters) {
  if (parameters.size() != 2) return std::nullopt;
  const std::uint16_t net_index = get_u16_le(parameters, 0);
  const bool has_network = configuration_.find_net_key(net_index) != nullptr;
  std::vector<std::uint16_t> indexes;
  for (const AppKey& key : configuration_.app_keys) {
    if (key.net_index == net_index) indexes.push_back(key.index);
  }
  Bytes out = key_status(app_key_list_op,
                         has_network ? ConfigStatus::success : ConfigStatus::invalid_net_key_index,
                         parameters);
  put_key_indexes(out, indexes);
  return out;
}

Answer KeyConfiguration::phase_get(ByteView parameters) {
  if (parameters.size() != 2) return std::nullopt;
  const std::uint16_t index = get_u16_le(parameters, 0);
  const NetKey* known = configuration_.find_net_key(index);
  if (known == nullptr) {
    return phase_status(ConfigStatus::invalid_net_key_index, index, KeyRefreshPhase::none);
  }
  return phase_status(ConfigStatus::success, index, known->phase);
}

/// Phase 2 without a key refresh is ignored, phase 3 without one is done already.
Answer KeyConfiguration::phase_set(ByteView parameters) {
  if (parameters.size() != 3) return std::nullopt;
  const std::uint16_t index = get_u16_le(parameters, 0);
  const std::uint8_t transition = parameters[2];
  if (transition != transition_to_phase_2 && transition != transition_to_phase_3) {
    return std::nullopt;
  }
  NetKey* known = configuration_.find_net_key(index);
  if (known == nullptr) {
    return phase_status(ConfigStatus::invalid_net_key_index, index, KeyRefreshPhase::none);
  }
  if (transition == transition_to_phase_2) {
    if (!known->new_key) return std::nullopt;
    known->phase = KeyRefreshPhase::switched;
  } else {
    finish_refresh(*known);
  }
  return phase_status(ConfigStatus::success, index, known->phase);
}

void KeyConfiguration::finish_refresh(NetKey& net_key) {
  net_key.key = net_key.new_key.value_or(net_key.key);
  net_key.new_key.reset();
  net_key.phase = KeyRefreshPhase::none;
  for (AppKey& key : configuration_.app_keys) {
    if (key.net_index != net_key.index) continue;
    key.key = key.new_key.value_or(key.key);
    key.new_key.reset();
  }
}

/// Robots have no proxy, so they do not advertise their identity in any network.
Answer KeyConfiguration::identity_get(ByteView parameters) {
  if (parameters.size() != 2) return std::nullopt;
  Bytes out = key_status(identity_status_op, ConfigStatus::success, parameters);
  put_u8(out, identity_not_supported);
  return out;
}

Answer KeyConfiguration::identity_set(ByteView parameters) {
  if (parameters.size() != 3 || parameters[2] > 1) return std::nullopt;
  return identity_get(parameters.first(2));
}

}  // namespace slamgw::sim::ble
