// SPDX-License-Identifier: Apache-2.0
// Reads all files that slam-gateway-web needs to start: the gateway's configuration, the program's
// own credentials, the tokens and the note.
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
/// beside the configuration, if it exists. Never throws because of a file's content.
Startup load_startup(const std::string& config_file);

}  // namespace slamgw::web
