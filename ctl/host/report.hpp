// SPDX-License-Identifier: Apache-2.0
// `slam-gatewayctl report`: what support needs to see, in one archive without secrets.
#pragma once

#include <string>
#include <string_view>

#include "ctl/host/installation.hpp"

namespace slamgw::ctl {

/// The text of a configuration file with the value of each key that may be secret replaced; keys
/// whose names speak of secrets too, known or not. Nothing of a text that is no JSON.
std::string without_secrets(std::string_view text);

/// Writes `file` (tar, gzip, mode 0600). A failure stands in the place of what cannot be had; only
/// a file that cannot be written is a Failure. Gives what was done, for people.
std::string report(const Installation& installation, const std::string& socket,
                   const std::string& file);

}  // namespace slamgw::ctl
