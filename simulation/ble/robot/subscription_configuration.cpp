// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/robot/subscription_configuration.hpp"

#include <algorithm>
#include <set>

namespace slamgw::sim::ble {
namespace {

constexpr std::uint16_t add_op = 0x801b;
constexpr std::uint16_t remove_op = 0x801c;
constexpr std::uint16_t remove_all_op = 0x801d;
constexpr std::uint16_t overwrite_op = 0x801e;
constexpr std::uint16_t subscription_status_op = 0x801f;
constexpr std::uint16_t add_virtual_op = 0x8020;
constexpr std::uint16_t remove_virtual_op = 0x8021;
constexpr std::uint16_t overwrite_virtual_op = 0x8022;
constexpr std::uint16_t sig_get_op = 0x8029;
constexpr std::uint16_t sig_list_op = 0x802a;
constexpr std::uint16_t vendor_get_op = 0x802b;
constexpr std::uint16_t vendor_list_op = 0x802c;

constexpr std::size_t subscribed_address_at = 2;

}  // namespace

std::optional<Answer> SubscriptionConfiguration::on_message(std::uint16_t opcode,
                                                            ByteView parameters) {
  using Self = SubscriptionConfiguration;
  static constexpr ConfigRequest<Self> requests[] = {
      {add_op, &Self::add},
      {remove_op, &Self::remove},
      {remove_all_op, &Self::remove_all},
      {overwrite_op, &Self::overwrite},
      {add_virtual_op, &Self::add_virtual},
      {remove_virtual_op, &Self::remove_virtual},
      {overwrite_virtual_op, &Self::overwrite_virtual},
      {sig_get_op, &Self::sig_list},
      {vendor_get_op, &Self::vendor_list},
  };
  return answer_request(requests, *this, opcode, parameters);
}

Answer SubscriptionConfiguration::change(ByteView parameters, Change change) {
  const std::optional<ModelId> id = model_id_at(parameters, subscribed_address_at + 2);
  if (!id) return std::nullopt;
  const Address element = get_u16_le(parameters, 0);
  const Address group = get_u16_le(parameters, subscribed_address_at);
  const bool is_allowed = is_group(group) && group != all_nodes;
  return status(is_allowed ? apply(element, group, *id, change) : ConfigStatus::invalid_address,
                element, group, *id);
}

Answer SubscriptionConfiguration::change_virtual(ByteView parameters, Change change) {
  const std::optional<ModelId> id = model_id_at(parameters, subscribed_address_at + sizeof(Key));
  if (!id) return std::nullopt;
  const Address element = get_u16_le(parameters, 0);
  const Address group = virtual_address(key_at(parameters, subscribed_address_at));
  return status(apply(element, group, *id, change), element, group, *id);
}

ConfigStatus SubscriptionConfiguration::apply(Address element, Address group, ModelId id,
                                              Change change) {
  const ConfigStatus status = can_subscribe(element, id);
  if (status != ConfigStatus::success) return status;
  Model& model = *configuration_.find_model(id);
  std::vector<Address>& groups = model.subscriptions;
  if (change == Change::overwrite && !clear(model)) return ConfigStatus::success;
  if (change == Change::remove) {
    std::erase(groups, group);
  } else if (std::find(groups.begin(), groups.end(), group) == groups.end()) {
    if (!has_room_for(group)) return ConfigStatus::insufficient_resources;
    groups.push_back(group);
  }
  return ConfigStatus::success;
}

/// Clears a model's subscriptions. Nordic's firmware asserts that they are not more than its
/// models; returns false when that fails.
bool SubscriptionConfiguration::clear(Model& model) {
  const std::size_t lists = configuration_.models.size();
  if (model.subscriptions.size() > lists) {
    failed_assertion_ = "a model's " + std::to_string(model.subscriptions.size()) +
                        " subscriptions cleared at once, with " + std::to_string(lists) +
                        " subscription lists";
    return false;
  }
  model.subscriptions.clear();
  return true;
}

bool SubscriptionConfiguration::has_room_for(Address group) const {
  std::set<Address> groups{group};
  for (const Model& model : configuration_.models) {
    groups.insert(model.subscriptions.begin(), model.subscriptions.end());
  }
  return groups.size() <= NodeConfiguration::max_groups;
}

/// The status has the unassigned address where other messages repeat theirs.
Answer SubscriptionConfiguration::remove_all(ByteView parameters) {
  const std::optional<ModelId> id = model_id_at(parameters, 2);
  if (!id) return std::nullopt;
  const Address element = get_u16_le(parameters, 0);
  const ConfigStatus result = can_subscribe(element, *id);
  if (result == ConfigStatus::success) clear(*configuration_.find_model(*id));
  return status(result, element, 0x0000, *id);
}

Answer SubscriptionConfiguration::sig_list(ByteView parameters) {
  const std::optional<ModelId> id = model_id_at(parameters, 2);
  if (!id || id->company != ModelId::sig) return std::nullopt;
  return list(sig_list_op, parameters, *id);
}

Answer SubscriptionConfiguration::vendor_list(ByteView parameters) {
  const std::optional<ModelId> id = model_id_at(parameters, 2);
  if (!id || id->company == ModelId::sig) return std::nullopt;
  return list(vendor_list_op, parameters, *id);
}

Bytes SubscriptionConfiguration::list(std::uint16_t opcode, ByteView parameters, ModelId id) const {
  const ConfigStatus status = can_subscribe(get_u16_le(parameters, 0), id);
  Bytes out = begin_status(opcode, status);
  put(out, parameters);
  if (status != ConfigStatus::success) return out;
  for (const Address group : configuration_.find_model(id)->subscriptions) put_u16_le(out, group);
  return out;
}

ConfigStatus SubscriptionConfiguration::can_subscribe(Address element, ModelId id) const {
  const ConfigStatus status = model_status(configuration_, element, id);
  if (status != ConfigStatus::success) return status;
  const bool takes_none = id == configuration_server || id == health_server;
  return takes_none ? ConfigStatus::not_a_subscribe_model : ConfigStatus::success;
}

Answer SubscriptionConfiguration::status(ConfigStatus status, Address element, Address group,
                                         ModelId id) const {
  Bytes out = begin_status(subscription_status_op, status);
  put_u16_le(out, element);
  put_u16_le(out, group);
  put_model_id(out, id);
  return out;
}

}  // namespace slamgw::sim::ble
