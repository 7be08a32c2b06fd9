// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/access/on_off.hpp"

#include <array>

namespace slamgw::ble {
namespace {

constexpr Opcode generic_on_off_set = 0x8202;
constexpr Opcode simple_on_off_set = 0xc15900;

}  // namespace

Bytes encode_on_off_set(OnOffModel model, bool is_on, std::uint8_t tid) {
  const std::array<std::uint8_t, 2> params{is_on ? std::uint8_t{1} : std::uint8_t{0}, tid};
  return encode_access(model == OnOffModel::generic ? generic_on_off_set : simple_on_off_set,
                       params);
}

Opcode on_off_status(OnOffModel model) {
  return model == OnOffModel::generic ? generic_on_off_status : simple_on_off_status;
}

}  // namespace slamgw::ble
