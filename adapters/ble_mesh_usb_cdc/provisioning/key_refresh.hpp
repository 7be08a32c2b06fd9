// SPDX-License-Identifier: Apache-2.0
// The refresh of the mesh's keys (Mesh Profile 1.0 section 3.10.4), step by step for all nodes, so
// that a robot that is left behind or removed is outside. The keys and what each node has taken are
// on disk, and a restart goes on from there. NodeConversations speaks with the nodes. Part of
// Provisioner.
#pragma once

#include <string>

#include "adapters/ble_mesh_usb_cdc/provisioning/provisioner_part.hpp"

namespace slamgw::ble {

class KeyRefresh : private ProvisionerPart {
 public:
  /// The radio was made with the database that there is.
  explicit KeyRefresh(const ProvisionerPart& shared) : ProvisionerPart(shared), told_(step()) {}

  /// Asks for new keys; answered by on_keys.
  void begin();
  /// True when these keys are for the refresh. It begins when the disk has them.
  bool on_keys(const MeshKeys& keys);

  bool is_on() const { return step() != RefreshStep::none; }
  RefreshStep step() const;
  /// The node has not taken the step that is under way. One that is not configured yet comes to it.
  bool is_due(const Node& node) const;
  void on_taken(const Uuid& uuid, RefreshStep step);
  /// An attempt to have the node take this step has failed.
  bool has_failed(const Node& node) const;

  void on_link_up() { has_switched_ = told_ == RefreshStep::finishing; }
  /// Goes on to the next step when it is time. `may_join`: a device may be getting the mesh's keys.
  void advance(bool may_join, TimePoint now);

  /// How many robots miss the step that is under way.
  std::size_t missing() const;
  /// The step, how many robots there are, how many have taken it, and who has not and why.
  std::string json() const;

 private:
  bool is_missing(const Node& node) const;
  bool is_step_done(bool may_join) const;
  void begin_step(RefreshStep step);
  void end();

  bool awaits_keys_ = false;
  RefreshStep told_;           ///< to the radio
  bool has_switched_ = false;  ///< the radio has nothing but the new keys
};

}  // namespace slamgw::ble
