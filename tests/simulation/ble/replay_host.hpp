// SPDX-License-Identifier: Apache-2.0
// A host that says what a recorded host said, to a simulated board with one unprovisioned robot.
// The robot has its own UUID and key pair, so commands that hold the recorded device's UUID, shared
// secret or device key get this robot's.
#pragma once

#include <vector>

#include "tests/simulation/ble/mesh_host.hpp"
#include "tests/support/transcript.hpp"

namespace slamgw::sim::ble {

class ReplayHost {
 public:
  explicit ReplayHost(const BleOptions& options) : host_(options) {}

  /// What the board says to the recorded command within `time`, without the beacons after the
  /// first.
  std::vector<Bytes> answers_to(const Bytes& recorded_command, Duration time);

  /// Without the octets that are this robot's own: its UUID, public key and device key.
  static test::RecordedPacket without_device(test::RecordedPacket packet);

  const MeshHost& mesh() const { return host_; }

 private:
  Bytes own(Bytes command) const;
  void learn_from(const Bytes& packet);

  MeshHost host_;
  Bytes uuid_;          ///< once the robot was heard
  Bytes ecdh_request_;  ///< the last event that asked for a shared secret
  Bytes device_key_;    ///< once the robot is provisioned
};

/// Leaves undefined what comes from `first` on.
void undefine(test::RecordedPacket& packet, std::size_t first, std::size_t count);

}  // namespace slamgw::sim::ble
