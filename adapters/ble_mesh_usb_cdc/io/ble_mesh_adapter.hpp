// SPDX-License-Identifier: Apache-2.0
// What the application asks of the BLE mesh beside what it asks of each mesh. Whatever the radio
// is, BleMeshShell does it.
#pragma once

#include <functional>

#include "adapters/ble_mesh_usb_cdc/ble_mesh.hpp"

namespace slamgw::ble {

class BleMeshAdapter {
 public:
  virtual ~BleMeshAdapter() = default;

  /// What operators order about the mesh and its robots; `done` is called once, now or later, and
  /// never after stop().
  virtual void manage(BleOrder order, OrderDone done) = 0;
  /// In a mesh that several gateways share: `may_serve` and `on_heard` are called for each message.
  /// Before start().
  using OnHeard = std::function<void(const HeardRobot& heard)>;
  virtual void share_with(ServiceGate::MayServe may_serve, OnHeard on_heard) = 0;
  virtual bool is_shared() const = 0;
  /// Of `ble_mesh.relay`.
  virtual void on_robot_message(const BrokerMessage& message) = 0;
  /// `robots` of the configuration, read again. Robots stay in the mesh.
  virtual void reconfigure(RobotNames names) = 0;
};

}  // namespace slamgw::ble
