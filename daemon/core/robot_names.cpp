// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/robot_names.hpp"
#include "daemon/core/parse_number.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace slamgw {
namespace {

constexpr std::string_view default_ble_prefix = "ble-";

std::optional<std::uint16_t> parse_default_ble_id(std::string_view id) {
  if (id.size() != default_ble_prefix.size() + 4 || !id.starts_with(default_ble_prefix))
    return std::nullopt;
  return parse_number<std::uint16_t>(id.substr(default_ble_prefix.size()), 16);
}

}  // namespace

RobotNames::RobotNames(std::vector<RobotName> names, Bans bans)
    : names_(std::move(names)), bans_(std::move(bans)) {
  for (const RobotName& name : names_) {
    const auto network = name.address ? IpNetwork::parse(*name.address) : std::nullopt;
    if (!network) continue;
    networks_.emplace(name.id, *network);
    if (name.mqttsn_client_id) networks_.emplace(*name.mqttsn_client_id, *network);
  }
  // An entry with only an origin or an IP address gives no name.
  std::erase_if(names_,
                [](const RobotName& name) { return !name.ble_address && !name.mqttsn_client_id; });
  for (const RobotName& name : names_) {
    if (name.ble_address) by_ble_.emplace(*name.ble_address, name.id);
    if (name.mqttsn_client_id) by_client_.emplace(*name.mqttsn_client_id, name.id);
    if (name.ble_address && name.mqttsn_client_id) on_both_.emplace(name.id, name.prefer);
  }
}

std::string RobotNames::of_ble(std::uint16_t address) const {
  const auto known = by_ble_.find(address);
  return known != by_ble_.end() ? known->second
                                : fmt::format("{}{:04x}", default_ble_prefix, address);
}

std::optional<std::string> RobotNames::of_client(std::string_view client_id) const {
  if (is_client_banned(client_id)) return std::nullopt;
  if (const auto known = by_client_.find(client_id); known != by_client_.end())
    return known->second;
  // A name of the BLE mesh, or of another client: a device speaks only for itself.
  const bool is_taken = parse_default_ble_id(client_id) ||
                        std::any_of(names_.begin(), names_.end(),
                                    [&](const RobotName& name) { return name.id == client_id; });
  if (is_taken) return std::nullopt;
  return std::string(client_id);
}

bool RobotNames::is_client_banned(std::string_view client_id) const {
  const auto known = by_client_.find(client_id);
  return bans_.has(client_id) || (known != by_client_.end() && bans_.has(known->second));
}

bool RobotNames::may_come_from(std::string_view id, const IpNetwork::Address& from) const {
  const auto network = networks_.find(id);
  return network == networks_.end() || network->second.covers(from);
}

std::optional<std::uint16_t> RobotNames::ble_address_of(std::string_view id) const {
  for (const RobotName& name : names_) {
    if (name.id == id) return name.ble_address;
  }
  const auto address = parse_default_ble_id(id);
  return address && !by_ble_.contains(*address) ? address : std::nullopt;
}

bool RobotNames::is_banned(std::string_view id) const {
  return bans_.has(id) || std::ranges::any_of(names_, [&](const RobotName& name) {
           return name.id == id && !name.ble_address && name.mqttsn_client_id &&
                  bans_.has(*name.mqttsn_client_id);
         });
}

}  // namespace slamgw
