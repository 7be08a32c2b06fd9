// SPDX-License-Identifier: Apache-2.0
// `key add`, `list` and `remove`: robots' keys for DTLS, in the file of `mqttsn.dtls.keys_file`.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "ctl/command_line.hpp"
#include "ctl/host/installation.hpp"

namespace slamgw::ctl {

/// Performs the task and returns its answer; a new key shows there and never again. The file is
/// whole at any time, and a change by another process is not lost. Throws Failure when there is no
/// such file or key, or it can't be written.
nlohmann::ordered_json change_keys(const Installation& installation, const HostTask& task);
/// A QR code for a terminal, black on white whatever its colours are, two modules in each character
/// cell. Empty when `text` is too long for one.
std::string qr_code(const std::string& text);
/// `shows_codes`: a new key is a QR code too, for a terminal.
std::string text_of_keys(const nlohmann::ordered_json& answer, bool shows_codes = false);

}  // namespace slamgw::ctl
