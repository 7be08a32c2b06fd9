// SPDX-License-Identifier: Apache-2.0
// A serial port: found, opened and configured by libserialport, then read and written through its
// descriptor. Pseudo-terminals, which libserialport does not know, are opened plainly.
//
// Any call here may wait in the kernel: to open and to set DTR until the device has answered, to
// close for up to 30 s while it takes no data. Only SerialConnection's thread makes them.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/io/device_choice.hpp"
#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "daemon/core/result.hpp"

namespace slamgw::ble {

/// An open port; the destructor closes it. At the border to the system: tests have ports that are
/// slow to open and close.
class SerialPort {
 public:
  virtual ~SerialPort() = default;

  /// Non-blocking; owned by this object.
  virtual int descriptor() const = 0;
  /// Longest write that the device stands.
  virtual std::size_t max_write_bytes() const = 0;
  /// Nordic's USB firmware only sends while DTR is on. Pseudo-terminals have none.
  virtual void set_dtr(bool is_on) = 0;
  virtual void flush_input() = 0;
};

/// Why a port can't be used.
struct OpenRefusal {
  std::string why;  ///< a sentence for the operator
  /// The node may only be so new that udev has not set its group yet: try again for a moment.
  bool is_denied = false;
};

using OpenPort = std::function<Result<std::unique_ptr<SerialPort>, OpenRefusal>()>;

/// Resolves links and `auto`, opens, sets speed, 8N1 and flow control; DTR is left on.
Result<std::unique_ptr<SerialPort>, OpenRefusal> open_serial_port(const Settings& settings);

}  // namespace slamgw::ble
