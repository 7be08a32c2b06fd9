// SPDX-License-Identifier: Apache-2.0
// The state that the parts of Provisioner share: the radio, the nodes, and the operator's order
// that is under way.
#pragma once

#include <optional>
#include <string>

#include "adapters/ble_mesh_usb_cdc/mesh_action.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/node_table.hpp"

namespace slamgw::ble {

/// The operator's order that is under way, if there is one, and its answer. OperatorOrders opens
/// the order; the part that fulfils it answers.
class OpenOrder {
 public:
  enum class Kind : std::uint8_t {  // up to `config` they need the radio, up to `remove` beacons
    scan,
    provision,
    remove,
    ping,
    config,
    import_mesh,
    export_mesh,
    reset_board,
    refresh_keys,
  };
  struct Order {
    std::uint64_t id = 0;
    Kind kind = Kind::scan;
    TimePoint due{};
    Uuid uuid{};                              ///< provision, remove, ping, config
    std::string robot = {};                   ///< provision
    bool is_forced = false;                   ///< remove
    std::string removed = {};                 ///< remove: the answer when the removal is on disk
    std::optional<NodeDatabase> before = {};  ///< import
    std::uint16_t address = 0;                ///< export: of the other gateway
  };

  explicit OpenOrder(MeshActions& actions) : actions_(actions) {}

  explicit operator bool() const { return order_.has_value(); }
  Order& operator*() { return *order_; }
  Order* operator->() { return &*order_; }
  bool is(Kind kind) const { return order_ && order_->kind == kind; }
  bool is(Kind kind, const Uuid& uuid) const { return is(kind) && order_->uuid == uuid; }
  std::optional<TimePoint> deadline() const {
    return order_ ? std::optional(order_->due) : std::nullopt;
  }

  void open(Order order) { order_ = std::move(order); }
  void set(Kind kind, TimePoint due, const Uuid& uuid = {}) {
    order_->kind = kind;
    order_->due = due;
    order_->uuid = uuid;
  }
  /// Ends the order with a JSON document.
  void answer(std::string json) { end({std::move(json), {}}); }
  /// Ends the order with a sentence for the operator.
  void refuse(std::string why) { end({{}, std::move(why)}); }

 private:
  void end(OrderAnswer answer) {
    actions_.push(OrderEnded{order_->id, std::move(answer)});
    order_.reset();
  }

  MeshActions& actions_;
  std::optional<Order> order_;
};

/// The references that the parts of Provisioner share. All of them must outlive the part.
struct ProvisionerPart {
  static constexpr const char* no_randomness = "no randomness for the mesh's keys";

  /// Returns fresh keys; nothing if the system has no randomness.
  std::optional<MeshKeys> make_keys() const {
    MeshKeys keys;
    return random_(keys.net_key) && random_(keys.app_key) ? std::optional(keys) : std::nullopt;
  }
  void notify(Severity severity, std::string text, std::string robot = {}) {
    actions_.push(MeshEvent(Notice{severity, std::move(text), std::move(robot)}));
  }

  const Settings& settings_;
  Radio& radio_;
  const LinkState& link_;
  NodeTable& nodes_;
  OpenOrder& order_;
  MeshActions& actions_;
  const RandomSource& random_;
};

}  // namespace slamgw::ble
