// SPDX-License-Identifier: Apache-2.0
// `ble_mesh.device: auto`: which of the attached serial ports is the mesh board. Pure; serial_port
// lists the ports.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/errors.hpp"
#include "daemon/core/result.hpp"

namespace slamgw::ble {

inline constexpr std::uint16_t jlink_vendor = 0x1366;  ///< SEGGER, the UART bridge on Nordic's kits

struct UsbPort {
  std::string path;
  std::uint16_t vendor = 0;
  std::uint16_t product = 0;
  std::string serial_number;
};

/// The one port that can be the mesh board, or a sentence for the operator: none, a board that
/// waits in its boot loader, or several, among which guessing is dangerous. Thread co-processors
/// (1915:cafe) are never candidates.
Result<UsbPort, Refusal> choose_device(const std::vector<UsbPort>& ports);

}  // namespace slamgw::ble
