// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/json_fields.hpp"

#include "adapters/ble_mesh_usb_cdc/nordic/address_book.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/commands.hpp"

#include <charconv>
#include <nlohmann/json.hpp>

namespace slamgw::ble {
namespace {

constexpr int hexadecimal = 16;
constexpr std::uint16_t first_group = 0xc000;
constexpr std::uint16_t last_group = 0xfeff;
constexpr std::size_t max_groups = last_group - first_group + 1;

bool parse_address(std::string_view digits, std::uint16_t& out) {
  if (digits.starts_with("0x")) digits.remove_prefix(2);
  const char* const end = digits.data() + digits.size();
  const auto [stop, error] = std::from_chars(digits.data(), end, out, hexadecimal);
  return error == std::errc{} && stop == end;
}

bool is_group_address(std::uint16_t address) {
  return address >= first_group && address <= last_group;
}

}  // namespace

std::optional<std::array<std::uint8_t, 16>> read_octets(const nlohmann::json& json,
                                                        const char* name) {
  const auto digits = read_text(json, name);
  return digits ? parse_uuid(*digits) : std::nullopt;
}

std::optional<std::uint16_t> read_unicast(const nlohmann::json& json, const char* name) {
  std::uint16_t address = 0;
  if (const auto text = read_text(json, name)) {
    if (!parse_address(*text, address)) return std::nullopt;
  } else if (const auto number = read_count(json, name, last_unicast_address)) {
    address = static_cast<std::uint16_t>(*number);
  }
  if (address == 0 || address > last_unicast_address) return std::nullopt;
  return address;
}

std::optional<std::uint16_t> read_destination(const nlohmann::json& json, const char* name) {
  if (const auto unicast = read_unicast(json, name)) return unicast;
  std::uint16_t group = 0;
  const auto text = read_text(json, name);
  if (!text || !parse_address(*text, group) || !is_group_address(group)) return std::nullopt;
  return group;
}

std::optional<std::vector<std::uint16_t>> read_groups(const nlohmann::json& json,
                                                      const char* name) {
  const auto* list = read_array(json, name);
  if (list == nullptr || list->size() > max_groups) return std::nullopt;
  std::vector<std::uint16_t> groups;
  for (const auto& text : *list) {
    std::uint16_t& group = groups.emplace_back();
    if (!text.is_string() || !parse_address(text.get<std::string>(), group)) return std::nullopt;
    if (!is_group_address(group)) return std::nullopt;
  }
  return groups;
}

std::optional<std::string> read_text(const nlohmann::json& json, const char* name) {
  if (!json.is_object()) return std::nullopt;
  const auto member = json.find(name);
  if (member == json.end() || !member->is_string()) return std::nullopt;
  return member->get<std::string>();
}

std::optional<std::uint32_t> read_count(const nlohmann::json& json, const char* name,
                                        std::uint32_t max) {
  if (!json.is_object()) return std::nullopt;
  const auto member = json.find(name);
  if (member == json.end() || !member->is_number_unsigned()) return std::nullopt;
  const auto value = member->get<std::uint64_t>();
  if (value > max) return std::nullopt;
  return static_cast<std::uint32_t>(value);
}

const nlohmann::json* read_array(const nlohmann::json& json, const char* name) {
  static const nlohmann::json empty = nlohmann::json::array();
  const auto member = json.find(name);
  if (member == json.end()) return &empty;
  return member->is_array() ? &*member : nullptr;
}

}  // namespace slamgw::ble
