// SPDX-License-Identifier: Apache-2.0
// Chooses the mesh board among the attached serial ports (`ble_mesh.device: auto`), and explains
// why a tty can't be opened. Pure; serial_port lists the ports and asks the system.
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

/// Returns the only port that can be the mesh board, else a sentence for the operator. There may be
/// none, a board in its boot loader, or several, among which guessing is dangerous. Thread
/// co-processors (1915:cafe) are never candidates.
Result<UsbPort, Refusal> choose_device(const std::vector<UsbPort>& ports);

/// The owner and mode of a device node, and the user who opens it.
struct NodeAccess {
  std::string group;    ///< name, or number when it has none
  unsigned mode = 0;    ///< permission bits, 0777
  std::string process;  ///< name of this process's user
};

/// Returns a sentence without a full stop. `error`: errno of the attempt.
std::string explain_open_failure(const std::string& path, int error, const NodeAccess& access);

}  // namespace slamgw::ble
