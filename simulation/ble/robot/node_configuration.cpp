// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/robot/node_configuration.hpp"

#include <algorithm>
#include <utility>

namespace slamgw::sim::ble {

std::vector<Model> NodeConfiguration::factory_models() {
  std::vector<Model> models;
  for (const ModelId id :
       {configuration_server, health_server, generic_on_off_server, simple_on_off_server,
        min_com_client, min_com_server, sensor_update_client, pos_cmd_client, pos_cmd_server}) {
    models.push_back({id, {}});
  }
  return models;
}

const Model* NodeConfiguration::find_model(ModelId id) const {
  const auto found = std::find_if(models.begin(), models.end(),
                                  [&](const Model& model) { return model.id == id; });
  return found == models.end() ? nullptr : &*found;
}

Model* NodeConfiguration::find_model(ModelId id) {
  return const_cast<Model*>(std::as_const(*this).find_model(id));
}

void NodeConfiguration::join(const ProvisioningData& data, const Key& new_device_key) {
  network = data;
  device_key = new_device_key;
  net_keys = {{data.net_key_index, data.net_key}};
}

const NetKey* NodeConfiguration::find_net_key(std::uint16_t index) const {
  const auto found = std::find_if(net_keys.begin(), net_keys.end(),
                                  [&](const NetKey& key) { return key.index == index; });
  return found == net_keys.end() ? nullptr : &*found;
}

NetKey* NodeConfiguration::find_net_key(std::uint16_t index) {
  return const_cast<NetKey*>(std::as_const(*this).find_net_key(index));
}

const NetKey* NodeConfiguration::network_of(const Key& key) const {
  const auto found = std::find_if(net_keys.begin(), net_keys.end(), [&](const NetKey& own) {
    return own.key == key || own.new_key == key;
  });
  return found == net_keys.end() ? nullptr : &*found;
}

Key NodeConfiguration::sending_key(const NetKey& net_key) const {
  return net_key.phase == KeyRefreshPhase::switched ? net_key.new_key.value_or(net_key.key)
                                                    : net_key.key;
}

Key NodeConfiguration::sending_key(const AppKey& app_key) const {
  const NetKey* net_key = find_net_key(app_key.net_index);
  const bool is_switched = net_key != nullptr && net_key->phase == KeyRefreshPhase::switched;
  return is_switched ? app_key.new_key.value_or(app_key.key) : app_key.key;
}

const AppKey* NodeConfiguration::find_app_key(std::uint16_t index) const {
  const auto found = std::find_if(app_keys.begin(), app_keys.end(),
                                  [&](const AppKey& key) { return key.index == index; });
  return found == app_keys.end() ? nullptr : &*found;
}

Duration publish_period(std::uint8_t octet) {
  using std::chrono::milliseconds;
  static constexpr milliseconds resolutions[] = {milliseconds{100}, milliseconds{1000},
                                                 milliseconds{10000}, milliseconds{600000}};
  return resolutions[octet >> 6] * (octet & 0x3f);
}

}  // namespace slamgw::sim::ble
