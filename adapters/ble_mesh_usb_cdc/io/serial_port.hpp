// SPDX-License-Identifier: Apache-2.0
// A serial port: found, opened and configured by libserialport, then read and written through its
// descriptor. Pseudo-terminals, which libserialport does not know, are opened plainly. Opening may
// take a moment, nothing else blocks. Called by BleMeshAdapter.
#pragma once

#include <memory>
#include <string>

#include "adapters/ble_mesh_usb_cdc/io/device_choice.hpp"
#include "adapters/ble_mesh_usb_cdc/refusal.hpp"
#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "daemon/core/result.hpp"

struct sp_port;

namespace slamgw::ble {

/// The serial ports that are on USB.
std::vector<UsbPort> list_usb_ports();

class SerialPort {
 public:
  /// Resolves links and `auto`, opens, sets speed, 8N1 and flow control; DTR is left on. The error
  /// says why not.
  static Result<std::unique_ptr<SerialPort>, Refusal> open(const Settings& settings);
  ~SerialPort();
  SerialPort(const SerialPort&) = delete;
  SerialPort& operator=(const SerialPort&) = delete;

  /// Owned by this object.
  int descriptor() const { return descriptor_; }
  /// Nordic's USB firmware only sends while DTR is on. Pseudo-terminals have none.
  void set_dtr(bool is_on);
  void flush_input();
  /// Longest write that the device stands (MBTLE-3878 for J-Link bridges).
  std::size_t max_write_bytes() const { return is_jlink_ ? 63 : 4096; }
  const std::string& path() const { return path_; }

 private:
  SerialPort(std::string path, sp_port* port, int descriptor, bool is_jlink);

  std::string path_;
  sp_port* port_;  ///< null for a pseudo-terminal
  int descriptor_;
  bool is_jlink_;
};

}  // namespace slamgw::ble
