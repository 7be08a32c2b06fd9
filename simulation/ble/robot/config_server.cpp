// SPDX-License-Identifier: Apache-2.0
// Formats and numbers: Mesh Profile 1.0 sections 4.2.1, 4.3.1.1, 4.3.2 and 4.3.4.
#include "simulation/ble/robot/config_server.hpp"

#include <algorithm>

namespace slamgw::sim::ble {
namespace {

// Opcodes: one octet, or two in big-endian order
constexpr std::uint16_t app_key_add_op = 0x00;
constexpr std::uint16_t composition_status_op = 0x02;
constexpr std::uint16_t publication_set_op = 0x03;
constexpr std::uint16_t app_key_delete_op = 0x8000;
constexpr std::uint16_t app_key_status_op = 0x8003;
constexpr std::uint16_t composition_get_op = 0x8008;
constexpr std::uint16_t publication_get_op = 0x8018;
constexpr std::uint16_t publication_status_op = 0x8019;
constexpr std::uint16_t subscription_add_op = 0x801b;
constexpr std::uint16_t subscription_delete_op = 0x801c;
constexpr std::uint16_t subscription_delete_all_op = 0x801d;
constexpr std::uint16_t subscription_overwrite_op = 0x801e;
constexpr std::uint16_t subscription_status_op = 0x801f;
constexpr std::uint16_t sig_subscription_get_op = 0x8029;
constexpr std::uint16_t sig_subscription_list_op = 0x802a;
constexpr std::uint16_t vendor_subscription_get_op = 0x802b;
constexpr std::uint16_t vendor_subscription_list_op = 0x802c;
constexpr std::uint16_t model_app_bind_op = 0x803d;
constexpr std::uint16_t model_app_status_op = 0x803e;
constexpr std::uint16_t model_app_unbind_op = 0x803f;
constexpr std::uint16_t node_reset_op = 0x8049;
constexpr std::uint16_t node_reset_status_op = 0x804a;

constexpr std::uint16_t product = 0x0001;
constexpr std::uint16_t version = 0x0001;
constexpr std::uint16_t replay_list_entries = 40;
constexpr std::uint16_t features = 0x0001;  // relay
constexpr std::size_t publication_octets = 9;

Bytes begin_message(std::uint16_t opcode) {
  Bytes out;
  if (opcode > 0xff) {
    put_u16_be(out, opcode);
  } else {
    put_u8(out, static_cast<std::uint8_t>(opcode));
  }
  return out;
}

Bytes begin_status(std::uint16_t opcode, ConfigStatus status) {
  Bytes out = begin_message(opcode);
  put_u8(out, static_cast<std::uint8_t>(status));
  return out;
}

/// A model identifier at the end of a message: two octets, or company and model.
std::optional<ModelId> model_id_at(ByteView parameters, std::size_t offset) {
  if (parameters.size() == offset + 2) return ModelId{ModelId::sig, get_u16_le(parameters, offset)};
  if (parameters.size() != offset + 4) return std::nullopt;
  return ModelId{get_u16_le(parameters, offset), get_u16_le(parameters, offset + 2)};
}

void put_model_id(Bytes& out, ModelId id) {
  if (id.company != ModelId::sig) put_u16_le(out, id.company);
  put_u16_le(out, id.id);
}

void put_publication(Bytes& out, Address element, const ModelPublication& publication) {
  put_u16_le(out, element);
  put_u16_le(out, publication.address);
  const int credential = publication.has_friendship_credential ? 1 << 12 : 0;
  put_u16_le(out, static_cast<std::uint16_t>(publication.app_key_index | credential));
  put(out, Bytes{publication.ttl, publication.period, publication.retransmit});
}

/// Two 12-bit indexes in three octets, the first in the lower bits.
std::pair<std::uint16_t, std::uint16_t> key_indexes(ByteView parameters) {
  const int first = parameters[0] | (parameters[1] & 0x0f) << 8;
  const int second = parameters[1] >> 4 | parameters[2] << 4;
  return {static_cast<std::uint16_t>(first), static_cast<std::uint16_t>(second)};
}

}  // namespace

ConfigServer::Result ConfigServer::on_message(ByteView message) {
  if (message.empty()) return {};
  const bool has_one_octet = (message[0] & 0x80) == 0;
  if (!has_one_octet && !two_octet_opcode(message)) return {};
  const std::uint16_t opcode = has_one_octet ? message[0] : *two_octet_opcode(message);
  const ByteView parameters = message.subspan(has_one_octet ? 1 : 2);
  switch (opcode) {
    case app_key_add_op: return {app_key_add(parameters)};
    case app_key_delete_op: return {app_key_delete(parameters)};
    case composition_get_op: return {composition_get(parameters)};
    case publication_set_op: return {publication_set(parameters)};
    case publication_get_op: return {publication_get(parameters)};
    case subscription_add_op: return {subscription(parameters, SubscriptionChange::add)};
    case subscription_delete_op: return {subscription(parameters, SubscriptionChange::remove)};
    case subscription_overwrite_op:
      return {subscription(parameters, SubscriptionChange::overwrite)};
    case subscription_delete_all_op: return {subscription_delete_all(parameters)};
    case sig_subscription_get_op: return {subscription_get(parameters, false)};
    case vendor_subscription_get_op: return {subscription_get(parameters, true)};
    case model_app_bind_op: return {model_app(parameters, true)};
    case model_app_unbind_op: return {model_app(parameters, false)};
    case node_reset_op:
      if (!parameters.empty()) return {};
      return {begin_message(node_reset_status_op), true};
    default: return {};
  }
}

/// Whatever page is asked for, there is page 0 only.
std::optional<Bytes> ConfigServer::composition_get(ByteView parameters) const {
  if (parameters.size() != 1) return std::nullopt;
  Bytes sig_models;
  Bytes vendor_models;
  std::uint8_t sig_count = 0;
  std::uint8_t vendor_count = 0;
  for (const Model& model : configuration_.models) {
    const bool is_sig = model.id.company == ModelId::sig;
    put_model_id(is_sig ? sig_models : vendor_models, model.id);
    ++(is_sig ? sig_count : vendor_count);
  }
  Bytes out = begin_message(composition_status_op);
  put_u8(out, 0x00);
  for (const std::uint16_t field : {nordic, product, version, replay_list_entries, features}) {
    put_u16_le(out, field);
  }
  put_u16_le(out, 0x0000);  // location of the one element: unknown
  put(out, Bytes{sig_count, vendor_count});
  put(out, sig_models);
  put(out, vendor_models);
  return out;
}

std::optional<Bytes> ConfigServer::app_key_add(ByteView parameters) {
  if (parameters.size() != 3 + sizeof(Key)) return std::nullopt;
  const auto [net_index, app_index] = key_indexes(parameters);
  AppKey key{app_index, {}};
  std::copy(parameters.begin() + 3, parameters.end(), key.key.begin());
  Bytes out = begin_status(app_key_status_op, store_app_key(net_index, key));
  put(out, parameters.first(3));
  return out;
}

ConfigStatus ConfigServer::store_app_key(std::uint16_t net_index, const AppKey& key) {
  if (net_index != configuration_.network->net_key_index) {
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

/// A key that is not there is deleted, too; with a key go its bindings and publications.
std::optional<Bytes> ConfigServer::app_key_delete(ByteView parameters) {
  if (parameters.size() != 3) return std::nullopt;
  const std::uint16_t net_index = key_indexes(parameters).first;
  const std::uint16_t app_index = key_indexes(parameters).second;
  ConfigStatus status = ConfigStatus::invalid_net_key_index;
  if (net_index == configuration_.network->net_key_index) {
    status = ConfigStatus::success;
    std::erase_if(configuration_.app_keys, [&](const AppKey& k) { return k.index == app_index; });
    for (Model& model : configuration_.models) {
      std::erase(model.bindings, app_index);
      if (model.publication.app_key_index == app_index) model.publication = {};
    }
  }
  Bytes out = begin_status(app_key_status_op, status);
  put(out, parameters);
  return out;
}

std::optional<Bytes> ConfigServer::model_app(ByteView parameters, bool binds) {
  const std::optional<ModelId> id = model_id_at(parameters, 4);
  if (!id) return std::nullopt;
  const Address element = get_u16_le(parameters, 0);
  Bytes out =
      begin_status(model_app_status_op, bind(element, get_u16_le(parameters, 2), *id, binds));
  put(out, parameters);
  return out;
}

ConfigStatus ConfigServer::bind(Address element, std::uint16_t app_index, ModelId id, bool binds) {
  if (!is_element(element)) return ConfigStatus::invalid_address;
  Model* model = configuration_.find_model(id);
  if (model == nullptr) return ConfigStatus::invalid_model;
  if (configuration_.find_app_key(app_index) == nullptr) {
    return ConfigStatus::invalid_app_key_index;
  }
  if (id == configuration_server) return ConfigStatus::cannot_bind;  // has the device key
  std::erase(model->bindings, app_index);
  if (binds) {
    model->bindings.push_back(app_index);
  } else if (model->publication.app_key_index == app_index) {
    model->publication = {};
  }
  return ConfigStatus::success;
}

std::optional<Bytes> ConfigServer::publication_set(ByteView parameters) {
  const std::optional<ModelId> id = model_id_at(parameters, publication_octets);
  if (!id) return std::nullopt;
  const Address element = get_u16_le(parameters, 0);
  const std::uint16_t key_and_credential = get_u16_le(parameters, 4);
  ModelPublication publication{get_u16_le(parameters, 2),
                               static_cast<std::uint16_t>(key_and_credential & 0x0fff),
                               (key_and_credential & 1 << 12) != 0,
                               parameters[6],
                               parameters[7],
                               parameters[8]};
  if (publication.address == 0) publication = {};  // stops publishing; all fields read 0 then
  const ConfigStatus status = publish(element, publication, *id);
  Bytes out = begin_status(publication_status_op, status);
  if (status != ConfigStatus::success) publication = {};
  put_publication(out, element, publication);
  put_model_id(out, *id);
  return out;
}

ConfigStatus ConfigServer::publish(Address element, const ModelPublication& publication,
                                   ModelId id) {
  if (!is_element(element)) return ConfigStatus::invalid_address;
  Model* model = configuration_.find_model(id);
  if (model == nullptr || id == configuration_server) return ConfigStatus::invalid_model;
  const bool has_key = configuration_.find_app_key(publication.app_key_index) != nullptr;
  if (publication.address != 0 && !has_key) return ConfigStatus::invalid_app_key_index;
  model->publication = publication;
  return ConfigStatus::success;
}

std::optional<Bytes> ConfigServer::publication_get(ByteView parameters) {
  const std::optional<ModelId> id = model_id_at(parameters, 2);
  if (!id) return std::nullopt;
  const Address element = get_u16_le(parameters, 0);
  const Model* model = configuration_.find_model(*id);
  ConfigStatus status = ConfigStatus::success;
  if (model == nullptr) status = ConfigStatus::invalid_model;
  if (!is_element(element)) status = ConfigStatus::invalid_address;
  Bytes out = begin_status(publication_status_op, status);
  put_publication(out, element,
                  status == ConfigStatus::success ? model->publication : ModelPublication{});
  put_model_id(out, *id);
  return out;
}

std::optional<Bytes> ConfigServer::subscription(ByteView parameters, SubscriptionChange change) {
  const std::optional<ModelId> id = model_id_at(parameters, 4);
  if (!id) return std::nullopt;
  const Address element = get_u16_le(parameters, 0);
  const Address group = get_u16_le(parameters, 2);
  Bytes out = begin_status(subscription_status_op, subscribe(element, group, *id, change));
  put(out, parameters);
  return out;
}

ConfigStatus ConfigServer::subscribe(Address element, Address group, ModelId id,
                                     SubscriptionChange change) {
  if (!is_group(group) || group == all_nodes) return ConfigStatus::invalid_address;
  const ConfigStatus status = can_subscribe(element, id);
  if (status != ConfigStatus::success) return status;
  std::vector<Address>& groups = configuration_.find_model(id)->subscriptions;
  if (change == SubscriptionChange::overwrite) groups.clear();
  if (change == SubscriptionChange::remove) {
    std::erase(groups, group);
  } else if (std::find(groups.begin(), groups.end(), group) == groups.end()) {
    if (groups.size() >= NodeConfiguration::max_subscriptions) {
      return ConfigStatus::insufficient_resources;
    }
    groups.push_back(group);
  }
  return ConfigStatus::success;
}

/// The status has the unassigned address where the others repeat theirs.
std::optional<Bytes> ConfigServer::subscription_delete_all(ByteView parameters) {
  const std::optional<ModelId> id = model_id_at(parameters, 2);
  if (!id) return std::nullopt;
  const Address element = get_u16_le(parameters, 0);
  const ConfigStatus status = can_subscribe(element, *id);
  if (status == ConfigStatus::success) configuration_.find_model(*id)->subscriptions.clear();
  Bytes out = begin_status(subscription_status_op, status);
  put_u16_le(out, element);
  put_u16_le(out, 0x0000);
  put_model_id(out, *id);
  return out;
}

std::optional<Bytes> ConfigServer::subscription_get(ByteView parameters, bool is_vendor) const {
  const std::optional<ModelId> id = model_id_at(parameters, 2);
  if (!id || (id->company != ModelId::sig) != is_vendor) return std::nullopt;
  const ConfigStatus status = can_subscribe(get_u16_le(parameters, 0), *id);
  Bytes out =
      begin_status(is_vendor ? vendor_subscription_list_op : sig_subscription_list_op, status);
  put(out, parameters);
  if (status != ConfigStatus::success) return out;
  for (const Address group : configuration_.find_model(*id)->subscriptions) put_u16_le(out, group);
  return out;
}

ConfigStatus ConfigServer::can_subscribe(Address element, ModelId id) const {
  if (!is_element(element)) return ConfigStatus::invalid_address;
  if (configuration_.find_model(id) == nullptr) return ConfigStatus::invalid_model;
  return id == configuration_server ? ConfigStatus::not_a_subscribe_model : ConfigStatus::success;
}

}  // namespace slamgw::sim::ble
