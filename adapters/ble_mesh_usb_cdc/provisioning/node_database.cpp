// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"

#include <charconv>
#include <nlohmann/json.hpp>
#include <optional>

namespace slamgw::ble {
namespace {

constexpr int format_version = 1;

std::optional<Key> read_key(const nlohmann::json& json, const char* name) {
  const auto member = json.find(name);
  if (member == json.end() || !member->is_string()) return std::nullopt;
  const auto& digits = member->get_ref<const std::string&>();
  Key key;
  if (digits.size() != key.size() * 2) return std::nullopt;
  for (std::size_t i = 0; i < key.size(); ++i) {
    const char* const first = digits.data() + 2 * i;
    const auto [end, error] = std::from_chars(first, first + 2, key[i], 16);
    if (error != std::errc{} || end != first + 2) return std::nullopt;
  }
  return key;
}

}  // namespace

std::string encode_node_database(const NodeDatabase& database) {
  const nlohmann::ordered_json json = {{"version", format_version},
                                       {"net_key", to_hex(database.keys.net_key)},
                                       {"app_key", to_hex(database.keys.app_key)}};
  return json.dump(2) + "\n";
}

Result<NodeDatabase, DecodeError> decode_node_database(std::string_view text) {
  const auto json = nlohmann::json::parse(text, nullptr, false);
  if (!json.is_object()) return DecodeError::bad_value;
  const auto version = json.find("version");
  if (version == json.end() || *version != format_version) return DecodeError::bad_value;
  const auto net_key = read_key(json, "net_key");
  const auto app_key = read_key(json, "app_key");
  if (!net_key || !app_key) return DecodeError::bad_value;
  return NodeDatabase{{*net_key, *app_key}};
}

}  // namespace slamgw::ble
