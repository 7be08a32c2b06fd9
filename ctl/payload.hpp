// SPDX-License-Identifier: Apache-2.0
// The PAYLOAD of `slam-gatewayctl send`.
#pragma once

#include <string>
#include <string_view>

#include "daemon/core/bytes.hpp"
#include "daemon/core/result.hpp"

namespace slamgw::ctl {

/// With `is_hex` pairs of hex digits; for `cmd` else `X,Y` as two little-endian int16, centimetres
/// (docs/topics.md); else the text itself. The error says what is allowed.
Result<Bytes, std::string> parse_payload(std::string_view type, std::string_view text, bool is_hex);

}  // namespace slamgw::ctl
