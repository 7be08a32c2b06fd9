// SPDX-License-Identifier: Apache-2.0
// The application's requests to the BLE mesh, besides those to every mesh (MeshAdapter).
// BleMeshShell implements them for each kind of radio.
#pragma once

#include <functional>

#include "adapters/ble_mesh_usb_cdc/ble_mesh.hpp"

namespace slamgw::ble {

class BleMeshAdapter {
 public:
  virtual ~BleMeshAdapter() = default;

  /// Carries out an operator's order about the mesh or its robots. `done` is called at most once,
  /// now or later, and never after stop().
  virtual void manage(BleOrder order, OrderDone done) = 0;
  /// Call before start(). In a mesh that several gateways share, `may_serve` and `on_heard` are
  /// called for each message.
  using OnHeard = std::function<void(const HeardRobot& heard)>;
  virtual void share_with(ServiceGate::MayServe may_serve, OnHeard on_heard) = 0;
  virtual bool is_shared() const = 0;
  /// Takes a robot's message for `ble_mesh.relay`.
  virtual void on_robot_message(const BrokerMessage& message) = 0;
  /// Takes `robots` of the configuration, read again. Robots stay in the mesh.
  virtual void reconfigure(RobotNames names) = 0;
};

}  // namespace slamgw::ble
