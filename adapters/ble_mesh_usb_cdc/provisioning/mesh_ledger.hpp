// SPDX-License-Identifier: Apache-2.0
// The mesh's database and whether the disk has it: nothing is used on the air before it is there
// (an address before a device gets it, a device key before it is spoken with). Part of
// NodeTable; BleMeshAdapter writes.
#pragma once

#include <optional>

#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ble {

class MeshLedger {
 public:
  static constexpr Duration retry_interval = std::chrono::seconds{5};

  explicit MeshLedger(std::optional<NodeDatabase> database) : database_(std::move(database)) {}

  const NodeDatabase* database() const { return database_ ? &*database_ : nullptr; }
  /// To change it; there must be one.
  NodeDatabase& change() {
    is_changed_ = true;
    return *database_;
  }
  /// A mesh begins. `is_stored`: the disk has it already.
  void begin(NodeDatabase database, bool is_stored) {
    database_ = std::move(database);
    is_changed_ = !is_stored;
  }
  /// Takes back what the disk did not take.
  void revert(std::optional<NodeDatabase> before) {
    database_ = std::move(before);
    is_changed_ = false;
    retry_at_.reset();
  }

  bool is_saved() const { return !is_changed_ && !is_writing_; }
  /// What to write now, if anything; answered by on_stored.
  const NodeDatabase* take_write(TimePoint now) {
    if (!is_changed_ || is_writing_ || (retry_at_ && now < *retry_at_)) return nullptr;
    is_changed_ = false;
    is_writing_ = true;
    retry_at_.reset();
    return &*database_;
  }
  void on_stored(bool is_done, TimePoint now) {
    is_writing_ = false;
    if (is_done) return;
    is_changed_ = true;
    retry_at_ = now + retry_interval;
  }
  std::optional<TimePoint> deadline() const { return is_writing_ ? std::nullopt : retry_at_; }

 private:
  std::optional<NodeDatabase> database_;
  bool is_changed_ = false;
  bool is_writing_ = false;
  std::optional<TimePoint> retry_at_;
};

}  // namespace slamgw::ble
