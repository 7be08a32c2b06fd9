// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/robot/binding_configuration.hpp"

namespace slamgw::sim::ble {
namespace {

constexpr std::uint16_t bind_op = 0x803d;
constexpr std::uint16_t binding_status_op = 0x803e;
constexpr std::uint16_t unbind_op = 0x803f;
constexpr std::uint16_t sig_app_get_op = 0x804b;
constexpr std::uint16_t sig_app_list_op = 0x804c;
constexpr std::uint16_t vendor_app_get_op = 0x804d;
constexpr std::uint16_t vendor_app_list_op = 0x804e;

}  // namespace

std::optional<Answer> BindingConfiguration::on_message(std::uint16_t opcode, ByteView parameters) {
  using Self = BindingConfiguration;
  static constexpr ConfigRequest<Self> requests[] = {
      {bind_op, &Self::bind},
      {unbind_op, &Self::unbind},
      {sig_app_get_op, &Self::sig_list},
      {vendor_app_get_op, &Self::vendor_list},
  };
  return answer_request(requests, *this, opcode, parameters);
}

Answer BindingConfiguration::change(ByteView parameters, bool binds) {
  const std::optional<ModelId> id = model_id_at(parameters, 4);
  if (!id) return std::nullopt;
  const Address element = get_u16_le(parameters, 0);
  Bytes out =
      begin_status(binding_status_op, change(element, get_u16_le(parameters, 2), *id, binds));
  put(out, parameters);
  return out;
}

ConfigStatus BindingConfiguration::change(Address element, std::uint16_t app_index, ModelId id,
                                          bool binds) {
  const ConfigStatus status = model_status(configuration_, element, id);
  if (status != ConfigStatus::success) return status;
  if (configuration_.find_app_key(app_index) == nullptr) {
    return ConfigStatus::invalid_app_key_index;
  }
  if (id == configuration_server) return ConfigStatus::cannot_bind;  // has the device key
  Model* model = configuration_.find_model(id);
  std::erase(model->bindings, app_index);
  if (binds) {
    model->bindings.push_back(app_index);
  } else if (model->publication.app_key_index == app_index) {
    model->publication = {};
  }
  return ConfigStatus::success;
}

Answer BindingConfiguration::sig_list(ByteView parameters) {
  const std::optional<ModelId> id = model_id_at(parameters, 2);
  if (!id || id->company != ModelId::sig) return std::nullopt;
  return list(sig_app_list_op, parameters, *id);
}

Answer BindingConfiguration::vendor_list(ByteView parameters) {
  const std::optional<ModelId> id = model_id_at(parameters, 2);
  if (!id || id->company == ModelId::sig) return std::nullopt;
  return list(vendor_app_list_op, parameters, *id);
}

Bytes BindingConfiguration::list(std::uint16_t opcode, ByteView parameters, ModelId id) const {
  const ConfigStatus status = model_status(configuration_, get_u16_le(parameters, 0), id);
  Bytes out = begin_status(opcode, status);
  put(out, parameters);
  if (status == ConfigStatus::success) {
    put_key_indexes(out, configuration_.find_model(id)->bindings);
  }
  return out;
}

}  // namespace slamgw::sim::ble
