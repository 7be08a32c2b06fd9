// SPDX-License-Identifier: Apache-2.0
// The one order of an operator that is under way, and its answer. Part of Provisioner;
// OperatorOrders opens it, the part that fulfils it answers it.
#pragma once

#include <optional>
#include <string>

#include "adapters/ble_mesh_usb_cdc/provisioning/provisioner_action.hpp"

namespace slamgw::ble {

class OpenOrder {
 public:
  enum class Kind : std::uint8_t { scan, provision, remove, import_mesh, export_mesh, reset_board };
  struct Order {
    std::uint64_t id = 0;
    Kind kind = Kind::scan;
    TimePoint due{};
    Uuid uuid{};                              ///< provision, remove
    std::string robot = {};                   ///< provision
    bool is_forced = false;                   ///< remove
    std::optional<NodeDatabase> before = {};  ///< import
    std::uint16_t address = 0;                ///< export: of the other gateway
  };

  explicit OpenOrder(ProvisionerActions& actions) : actions_(actions) {}

  explicit operator bool() const { return order_.has_value(); }
  Order& operator*() { return *order_; }
  Order* operator->() { return &*order_; }
  bool is(Kind kind) const { return order_ && order_->kind == kind; }
  bool is(Kind kind, const Uuid& uuid) const { return is(kind) && order_->uuid == uuid; }
  std::optional<TimePoint> deadline() const {
    return order_ ? std::optional(order_->due) : std::nullopt;
  }

  void open(Order order) { order_ = std::move(order); }
  /// Ends it with a JSON document.
  void answer(std::string json) { end({std::move(json), {}}); }
  /// Ends it with a sentence for the operator.
  void refuse(std::string why) { end({{}, std::move(why)}); }

 private:
  void end(OrderAnswer answer) {
    actions_.push(OrderEnded{order_->id, std::move(answer)});
    order_.reset();
  }

  ProvisionerActions& actions_;
  std::optional<Order> order_;
};

}  // namespace slamgw::ble
