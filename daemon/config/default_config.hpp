// SPDX-License-Identifier: Apache-2.0
// The complete commented default configuration: config/gateway.json, embedded when the daemon is
// built.
#pragma once

#include <string_view>

namespace slamgw {

/// Byte for byte the shipped file; what `slam-gatewayd --print-config` prints.
extern const std::string_view default_config_text;

}  // namespace slamgw
