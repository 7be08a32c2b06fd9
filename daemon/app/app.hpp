// SPDX-License-Identifier: Apache-2.0
// The composition root of the daemon. Hides the headers of its parts, which are slow to compile.
#pragma once

#include <string>

#include "daemon/config/config.hpp"

namespace slamgw {

/// Runs the gateway until SIGTERM or SIGINT. `config_file` is read again on SIGHUP. Throws
/// std::runtime_error for what an operator must fix (a port in use).
void run_gateway(Config config, const std::string& config_file);

}  // namespace slamgw
