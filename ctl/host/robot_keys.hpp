// SPDX-License-Identifier: Apache-2.0
// `key add`, `list` and `remove`: robots' keys for DTLS, in the file of `mqttsn.dtls.keys_file`.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "ctl/host/installation.hpp"

namespace slamgw::ctl {

/// Returns who has a key. Throws Failure when the file can't be used.
nlohmann::ordered_json list_keys(const Installation& installation);
/// Adds or removes the robot's key. Returns the only text that ever shows a new key. The file is
/// complete at any time, and a change by another process is not lost. Throws Failure when the file
/// or the key does not exist, or when the file can't be written.
nlohmann::ordered_json change_keys(const Installation& installation, const std::string& robot,
                                   bool is_added);
/// Returns a QR code for a terminal, black on white whatever the terminal's colours are, with two
/// modules in each character cell. Empty when `text` is too long.
std::string qr_code(const std::string& text);
/// `shows_codes`: also shows a new key as a QR code, for a terminal.
std::string text_of_keys(const nlohmann::ordered_json& answer, bool shows_codes = false);

}  // namespace slamgw::ctl
