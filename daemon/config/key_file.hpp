// SPDX-License-Identifier: Apache-2.0
// The file of `mqttsn.dtls.keys_file`: {"robot-1": "<hex digits>", ...}, robots' keys by their
// MQTT-SN client ids. No key ever shows in a problem.
#pragma once

#include <string>

#include "daemon/config/files.hpp"
#include "daemon/config/parse_result.hpp"
#include "daemon/core/robot_keys.hpp"

namespace slamgw {

/// At least 128 bits; at most what RFC 4279 section 5.4 obliges every implementation to support.
inline constexpr std::size_t min_key_octets = 16;
inline constexpr std::size_t max_key_octets = 64;

/// Returns the valid keys in `text` and reports the other entries.
RobotKeys parse_key_file(const std::string& text, const std::string& file, Problems& problems);
/// Returns the file's text, as parse_key_file() reads it.
std::string write_key_file(const RobotKeys& keys);
/// Says why the file may not be used; empty when only a trusted owner can read it.
std::string fault_of_key_file(const std::string& path, const FileText& file);

/// Sets `result.config.robot_keys`.
void read_robot_keys(ParseResult& result, const Files& files);

}  // namespace slamgw
