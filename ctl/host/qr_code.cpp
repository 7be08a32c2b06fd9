// SPDX-License-Identifier: Apache-2.0
#include "ctl/host/qr_code.hpp"

#include <qrencode.h>

#include <memory>

namespace slamgw::ctl {

std::string qr_code(const std::string& text) {
  const std::unique_ptr<QRcode, decltype(&QRcode_free)> code(
      QRcode_encodeString8bit(text.c_str(), 0, QR_ECLEVEL_M), &QRcode_free);
  if (!code) return {};
  constexpr int quiet_zone = 4;  // ISO/IEC 18004: modules that readers need around it
  const int width = code->width;
  const auto is_dark = [&](int x, int y) {
    const bool is_inside = x >= 0 && y >= 0 && x < width && y < width;
    return is_inside && (code->data[y * width + x] & 1) != 0;
  };
  std::string lines;
  for (int y = -quiet_zone; y < width + quiet_zone; y += 2) {
    lines += "\x1b[30;107m";
    for (int x = -quiet_zone; x < width + quiet_zone; ++x) {
      const bool upper = is_dark(x, y);
      const bool lower = is_dark(x, y + 1);
      lines += upper && lower ? "█" : upper ? "▀" : lower ? "▄" : " ";
    }
    lines += "\x1b[0m\n";
  }
  return lines;
}

}  // namespace slamgw::ctl
