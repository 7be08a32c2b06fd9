// SPDX-License-Identifier: Apache-2.0
// `ble_mesh.device: auto`: which of the attached serial ports is the mesh board; and why a tty
// can't be opened, in words. Pure; serial_port lists the ports and asks the system.
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

/// The owner and mode of a device node, and the user who opens it.
struct NodeAccess {
  std::string group;    ///< name, or number when it has none
  unsigned mode = 0;    ///< permission bits, 0777
  std::string process;  ///< name of this process's user
};

/// A sentence without a full stop. `error`: errno of the attempt.
std::string explain_open_failure(const std::string& path, int error, const NodeAccess& access);

}  // namespace slamgw::ble
