// SPDX-License-Identifier: Apache-2.0
// A QR code for a terminal, by libqrencode.
#pragma once

#include <string>

namespace slamgw::ctl {

/// Black on white whatever the terminal's colours are, two modules in each character cell. Empty
/// when `text` is too long for one.
std::string qr_code(const std::string& text);

}  // namespace slamgw::ctl
