// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/utf8.hpp"

#include <cstdint>

namespace slamgw {
namespace {

struct Lead {
  int continuation_octets;
  std::uint32_t bits;
  std::uint32_t smallest;  // what needs this length, to refuse overlong forms
};

bool read_lead(std::uint8_t octet, Lead& lead) {
  if (octet < 0x80) return lead = {0, octet, 0}, true;
  if ((octet & 0xe0) == 0xc0) return lead = {1, octet & 0x1fu, 0x80}, true;
  if ((octet & 0xf0) == 0xe0) return lead = {2, octet & 0x0fu, 0x800}, true;
  if ((octet & 0xf8) == 0xf0) return lead = {3, octet & 0x07u, 0x10000}, true;
  return false;
}

}  // namespace

bool is_utf8(std::string_view text) {
  for (std::size_t at = 0; at < text.size();) {
    Lead lead{};
    if (!read_lead(static_cast<std::uint8_t>(text[at++]), lead)) return false;
    std::uint32_t code_point = lead.bits;
    for (int i = 0; i < lead.continuation_octets; ++i) {
      if (at == text.size()) return false;
      const auto octet = static_cast<std::uint8_t>(text[at++]);
      if ((octet & 0xc0) != 0x80) return false;
      code_point = code_point << 6 | (octet & 0x3fu);
    }
    const bool is_surrogate = code_point >= 0xd800 && code_point <= 0xdfff;
    if (code_point < lead.smallest || is_surrogate || code_point > 0x10ffff) return false;
  }
  return true;
}

}  // namespace slamgw
