// SPDX-License-Identifier: Apache-2.0
// Everything that slam-gateway-web reads before it starts: the gateway's configuration, its own
// credentials, the tokens.
#pragma once

#include <string>

#include "daemon/config/parse.hpp"
#include "web/server/tokens.hpp"

namespace slamgw::web {

struct Startup {
  ParseResult parsed;  ///< `config.broker.credentials` are this program's own
  Tokens tokens;       ///< secret; empty: pages only watch
};

/// The credentials come from the systemd credential `broker`, else from `web-credentials.json`
/// beside the configuration, if there is one. Never throws for what is in the files.
Startup load_startup(const std::string& config_file);

}  // namespace slamgw::web
