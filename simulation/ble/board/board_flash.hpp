// SPDX-License-Identifier: Apache-2.0
// The board's tables and the sequence numbers that it has reserved. A board that is built with
// storage keeps them in flash; the stock one, which is not, loses them at each reset.
#pragma once

#include "simulation/ble/board/address_table.hpp"
#include "simulation/ble/board/key_table.hpp"

namespace slamgw::sim::ble {

struct BoardFlash {
  KeyTable subnets{8, 0};
  KeyTable appkeys{8, 0};
  KeyTable devkeys{10, 8};  ///< handles follow those of the application keys
  AddressTable addresses;
  Address local_start = 0;
  std::uint16_t local_count = 0;
  std::uint32_t reserved_sequence = 0;  ///< numbers below may have been used

  /// One of the board's own unicast addresses.
  bool is_local(Address address) const {
    return address >= local_start && address < local_start + local_count;
  }
};

}  // namespace slamgw::sim::ble
