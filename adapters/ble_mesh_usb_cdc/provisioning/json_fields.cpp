// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/json_fields.hpp"

#include <charconv>
#include <nlohmann/json.hpp>

#include "adapters/ble_mesh_usb_cdc/provisioning/address_plan.hpp"

namespace slamgw::ble {
namespace {

constexpr int hexadecimal = 16;

template <class T>
bool parse_hex(std::string_view digits, T& out) {
  const char* const end = digits.data() + digits.size();
  const auto [stop, error] = std::from_chars(digits.data(), end, out, hexadecimal);
  return error == std::errc{} && stop == end;
}

}  // namespace

std::optional<std::array<std::uint8_t, 16>> read_octets(const nlohmann::json& json,
                                                        const char* name) {
  auto digits = read_text(json, name);
  if (!digits) return std::nullopt;
  std::erase(*digits, '-');
  std::array<std::uint8_t, 16> octets{};
  if (digits->size() != octets.size() * 2) return std::nullopt;
  for (std::size_t i = 0; i < octets.size(); ++i)
    if (!parse_hex(std::string_view(*digits).substr(2 * i, 2), octets[i])) return std::nullopt;
  return octets;
}

std::optional<std::uint16_t> read_unicast(const nlohmann::json& json, const char* name) {
  std::uint16_t address = 0;
  if (const auto text = read_text(json, name)) {
    std::string_view digits = *text;
    if (digits.starts_with("0x")) digits.remove_prefix(2);
    if (!parse_hex(digits, address)) return std::nullopt;
  } else if (const auto number = read_count(json, name, last_unicast_address)) {
    address = static_cast<std::uint16_t>(*number);
  }
  if (address == 0 || address > last_unicast_address) return std::nullopt;
  return address;
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
