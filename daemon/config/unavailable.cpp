// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/unavailable.hpp"

#include <array>

namespace slamgw {
namespace {

/// `is_asked_for` looks only at keys that the file sets; the shipped file sets all defaults.
struct Row {
  std::string_view key;
  bool (*is_asked_for)(const Config& config);
  std::string_view text;
};

constexpr std::string_view provisioning_text =
    "robots are not taken in by this version; provision them with another tool";

constexpr std::array rows = {
    Row{"ble_mesh.provisioning.enabled",
        [](const Config& c) { return c.ble_mesh.enabled && c.ble_mesh.provisioning.enabled; },
        provisioning_text},
    Row{"ble_mesh.provisioning.uuid_prefixes",
        [](const Config& c) {
          return c.ble_mesh.enabled && !c.ble_mesh.provisioning.uuid_prefixes.empty();
        },
        provisioning_text},
    Row{"ble_mesh.provisioning.static_oob",
        [](const Config& c) {
          return c.ble_mesh.enabled && c.ble_mesh.provisioning.static_oob.has_value();
        },
        provisioning_text},
};

}  // namespace

Problems unavailable_features(const Located& located) {
  Problems warnings;
  for (const Row& row : rows) {
    const std::string key(row.key);
    if (located.is_set(key) && row.is_asked_for(located.config))
      warnings.push_back({located.context.file, located.line_of(key), key, std::string(row.text)});
  }
  return warnings;
}

}  // namespace slamgw
