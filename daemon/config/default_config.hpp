// SPDX-License-Identifier: Apache-2.0
// The complete commented default configuration: config/gateway.json, embedded when the daemon is
// built.
#pragma once

#include <string_view>

namespace slamgw {

/// The shipped file, byte for byte. `slam-gatewayd --print-config` prints it.
extern const std::string_view default_config_text;

}  // namespace slamgw
