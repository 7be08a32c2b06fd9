// SPDX-License-Identifier: Apache-2.0
// A serial port: found, opened and configured by libserialport, then read and written through its
// descriptor. Pseudo-terminals, which libserialport does not know, are opened plainly.
//
// Any call here may wait in the kernel. Opening and setting DTR wait until the device has answered.
// Closing waits up to 30 s while the device takes no data. Only SerialConnection's thread makes
// these calls.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/io/device_choice.hpp"
#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "daemon/core/result.hpp"

namespace slamgw::ble {

/// An open port; the destructor closes it. An interface at the border to the system: tests have
/// ports that are slow to open and close.
class SerialPort {
 public:
  virtual ~SerialPort() = default;

  /// Non-blocking; owned by this object.
  virtual int descriptor() const = 0;
  /// Returns the size of the longest write of which the device loses nothing.
  virtual std::size_t max_write_bytes() const = 0;
  /// Nordic's USB firmware only sends while DTR is on. Pseudo-terminals have no DTR.
  virtual void set_dtr(bool is_on) = 0;
  virtual void flush_input() = 0;
};

/// The reason why a port can't be used.
struct OpenRefusal {
  std::string why;  ///< a sentence for the operator
  /// No permission; udev may not have set the group of a new node yet: try again for a moment.
  bool is_denied = false;
};

using OpenPort = std::function<Result<std::unique_ptr<SerialPort>, OpenRefusal>()>;

/// Resolves links and `auto`, opens, sets speed, 8N1 and flow control; DTR is left on.
Result<std::unique_ptr<SerialPort>, OpenRefusal> open_serial_port(const Settings& settings);

}  // namespace slamgw::ble
