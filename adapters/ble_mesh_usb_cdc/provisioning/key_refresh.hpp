// SPDX-License-Identifier: Apache-2.0
// Refreshes the mesh's keys (Mesh Profile 1.0 section 3.10.4), step by step for all nodes. A robot
// that is left behind or removed is shut out. The keys and the progress of each node are on disk,
// and a restart goes on from there. NodeConversations speaks with the nodes. Part of Provisioner.
#pragma once

#include <string>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/provisioning/provisioner_part.hpp"

namespace slamgw::ble {

class KeyRefresh : private ProvisionerPart {
 public:
  /// The radio must have been made with the keys of the present database.
  explicit KeyRefresh(const ProvisionerPart& shared)
      : ProvisionerPart(shared), radio_step_(step()) {}

  /// The refresh begins when these new keys are on disk.
  void begin(const MeshKeys& keys);

  bool is_on() const { return step() != RefreshStep::none; }
  RefreshStep step() const;
  /// Returns true if the node is configured and has not taken the present step.
  bool is_due(const Node& node) const;
  void on_taken(const Uuid& uuid, RefreshStep step);
  /// Returns true if an attempt to take the node through the present step has failed.
  bool has_failed(const Node& node) const;

  void on_link_up() { has_switched_ = radio_step_ == RefreshStep::finishing; }
  /// Begins the next step when the present one is done. `may_join`: a device may be getting keys.
  void advance(bool may_join, TimePoint now);

  /// Returns how many robots miss the present step.
  std::size_t missing() const;
  /// Returns the step, the numbers of robots and of those that took it, and the others' problems.
  std::string json() const;

 private:
  bool is_missing(const Node& node) const;
  bool is_step_done(bool may_join) const;
  void begin_step(RefreshStep step);
  void end();

  RefreshStep radio_step_;     ///< the step that the radio knows
  bool has_switched_ = false;  ///< the radio has only the new keys
};

}  // namespace slamgw::ble
