// SPDX-License-Identifier: Apache-2.0
// Members of the JSON files that hold a mesh: nothing where one is missing or not what it should
// be. Called by mesh_json and imported_mesh.
#pragma once

#include <array>
#include <cstdint>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

namespace slamgw::ble {

/// 32 hex digits, any case; UUIDs also with hyphens.
std::optional<std::array<std::uint8_t, 16>> read_octets(const nlohmann::json& json,
                                                        const char* name);
/// A number, or text of up to 4 hex digits with or without 0x; 0x0001-0x7fff.
std::optional<std::uint16_t> read_unicast(const nlohmann::json& json, const char* name);
/// Such a text or number, or the text of a group address.
std::optional<std::uint16_t> read_destination(const nlohmann::json& json, const char* name);
/// A list of such texts; each 0xc000-0xfeff.
std::optional<std::vector<std::uint16_t>> read_groups(const nlohmann::json& json, const char* name);
std::optional<std::string> read_text(const nlohmann::json& json, const char* name);
/// A whole number from 0 to `max`.
std::optional<std::uint32_t> read_count(const nlohmann::json& json, const char* name,
                                        std::uint32_t max);
/// An empty array where it is missing; nothing where it is anything else than an array.
const nlohmann::json* read_array(const nlohmann::json& json, const char* name);

}  // namespace slamgw::ble
