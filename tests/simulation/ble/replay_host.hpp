// SPDX-License-Identifier: Apache-2.0
// A host that replays a recorded host to a simulated board with one unprovisioned robot. The robot
// has its own UUID and key pair, which replace those of the recorded device in commands.
#pragma once

#include <vector>

#include "tests/simulation/ble/mesh_host.hpp"
#include "tests/support/transcript.hpp"

namespace slamgw::sim::ble {

class ReplayHost {
 public:
  explicit ReplayHost(const BleOptions& options) : host_(options) {}

  /// Returns the board's answers to the recorded command within `time`, without the beacons after
  /// the first.
  std::vector<Bytes> answers_to(const Bytes& recorded_command, Duration time);

  /// Masks this robot's own UUID, public key and device key.
  static test::RecordedPacket without_device(test::RecordedPacket packet);

  const MeshHost& mesh() const { return host_; }

 private:
  Bytes own(Bytes command) const;
  void learn_from(const Bytes& packet);

  MeshHost host_;
  Bytes uuid_;          ///< set once the robot was heard
  Bytes ecdh_request_;  ///< the last event that asked for a shared secret
  Bytes device_key_;    ///< set once the robot is provisioned
};

/// Masks `count` octets from `first` on.
void undefine(test::RecordedPacket& packet, std::size_t first, std::size_t count);

}  // namespace slamgw::sim::ble
