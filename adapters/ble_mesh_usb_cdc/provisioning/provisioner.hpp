// SPDX-License-Identifier: Apache-2.0
// Takes robots into the mesh, configures them, and carries out operators' orders. Its parts do the
// work: NodeTable (the known nodes), Admission (joining), KeyRefresh (the steps of a key refresh),
// HearingSurvey (which robots hear which), NodeConversations (configuration and reset),
// OperatorOrders. This class gives them their turns and has the database written. Called by
// BleMesh.
#pragma once

#include <optional>
#include <string>

#include "adapters/ble_mesh_usb_cdc/provisioning/operator_orders.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/source_lives.hpp"

namespace slamgw::ble {

class Provisioner {
 public:
  /// `settings`, `radio`, `link` and `actions` must outlive this object. `gateway`: `gateway.id`,
  /// for gateways that join this mesh.
  Provisioner(const Settings& settings, Radio& radio, const LinkState& link, MeshActions& actions,
              std::string gateway, RobotNames names, std::optional<NodeDatabase> database,
              RandomSource random);
  Provisioner(const Provisioner&) = delete;
  Provisioner& operator=(const Provisioner&) = delete;

  /// Warns of each device that may have joined unnoticed before the start.
  void on_start() { admission_.on_start(); }
  /// Begins no new join. See Radio::break_off_join.
  void on_stop() { admission_.on_stop(); }
  /// Returns true if no device is joining.
  bool is_settled() const { return admission_.is_idle(); }
  void on_link_up(const LinkIsUp& up, TimePoint now);
  void on_link_down(const LinkIsDown& down, TimePoint now);
  void on_event(const ProvisionerEvent& event, TimePoint now);
  /// Returns true if the message was an answer in a conversation, not from a robot's own models.
  bool on_message(const MessageReceived& message, TimePoint now);
  void on_send_refused(std::uint16_t address, const std::string& why, TimePoint now) {
    conversations_.on_send_refused(address, why, now);
  }
  /// A message came from this unicast address.
  void on_heard(std::uint16_t address, TimePoint now) {
    nodes_.on_heard(address, now);
    admission_.on_heard(address);
  }
  void on_iv_index(std::uint32_t iv_index, TimePoint now);
  void on_stored(const std::string& problem, TimePoint now);
  void on_order(std::uint64_t id, const BleOrder& order, TimePoint now);
  /// Call when `robots` of the configuration was read again.
  void on_names(RobotNames names) { nodes_.on_names(std::move(names)); }

  const NodeTable& nodes() const { return nodes_; }
  const SourceLives& lives() const { return lives_; }
  const KeyRefresh& refresh() const { return refresh_; }
  /// Returns true once after nodes, or their names, have changed.
  bool take_change() { return nodes_.take_change(); }
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now) { advance(now); }

 private:
  void begin_mesh(TimePoint now);
  void advance(TimePoint now);
  void scan_or_restart(TimePoint now);

  const RandomSource random_;
  NodeTable nodes_;
  OpenOrder order_;
  ProvisionerPart shared_;
  SourceLives lives_;
  Admission admission_;
  KeyRefresh refresh_;
  HearingSurvey survey_;
  NodeConversations conversations_;
  OperatorOrders orders_;
  bool is_scanning_ = false;
  bool is_store_problem_known_ = false;  ///< to the operator
};

}  // namespace slamgw::ble
