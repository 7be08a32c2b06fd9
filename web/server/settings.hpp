// SPDX-License-Identifier: Apache-2.0
// The settings of the live page (`web.*`); defaults as in config/gateway.json.
#pragma once

#include <optional>
#include <string>
#include <vector>

namespace slamgw::web {

struct Settings {
  std::string listen = "127.0.0.1:8321";  ///< an IP address and a port
  std::optional<std::string> token_file;  ///< nothing: no page may send commands
  std::optional<std::string> note_file;   ///< a text that operators read with the first steps
  std::vector<std::string> hosts;         ///< names that a `Host` header may hold besides addresses
  bool operator==(const Settings&) const = default;
};

}  // namespace slamgw::web
