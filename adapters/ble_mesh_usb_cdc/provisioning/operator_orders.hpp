// SPDX-License-Identifier: Apache-2.0
// Takes operators' orders (`slam-gatewayctl ble ...`), and answers them at once, or when they are
// fulfilled. Only one such order may be under way. Only the answer to `ble export` holds keys. Part
// of Provisioner.
#pragma once

#include <deque>
#include <optional>
#include <string>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/provisioning/node_conversations.hpp"

namespace slamgw::ble {

class OperatorOrders : private ProvisionerPart {
 public:
  static constexpr Duration scan_time = std::chrono::seconds{10};
  /// Time limit for hearing a device that an operator named.
  static constexpr Duration search_time_limit = std::chrono::seconds{30};

  /// All references must outlive this object. `gateway`: `gateway.id`.
  OperatorOrders(const ProvisionerPart& shared, Admission& admission,
                 NodeConversations& conversations, KeyRefresh& refresh, HearingSurvey& survey,
                 std::string gateway)
      : ProvisionerPart(shared),
        admission_(admission),
        conversations_(conversations),
        refresh_(refresh),
        survey_(survey),
        gateway_(std::move(gateway)) {}

  void on_order(std::uint64_t id, const BleOrder& order, TimePoint now);
  void on_link_down();
  void on_radio_cleared(const std::string& problem);
  /// Call after NodeTable::on_stored(). `problem` is empty if the database is on disk.
  void on_stored(const std::string& problem, TimePoint now);
  void on_deadline(TimePoint now);
  /// Begins the next order that waits in line, when none is under way.
  void begin_waiting(TimePoint now);

 private:
  /// Maximum of pings and questions that wait in line, because each takes some seconds.
  static constexpr std::size_t max_waiting = 16;
  using Waiting = std::pair<std::uint64_t, BleOrder>;

  void take(const ScanOrder&, TimePoint now);
  void take(const ProvisionOrder& wanted, TimePoint now);
  void take(const RemoveOrder& wanted, TimePoint now);
  void take(const PingOrder& wanted, TimePoint now);
  void take(const NodeConfigOrder& wanted, TimePoint now);
  void take(const ImportOrder& wanted, TimePoint now);
  void take(const ExportOrder& wanted, TimePoint now);
  void take(const ResetBoardOrder&, TimePoint now);
  void take(const RefreshKeysOrder& wanted, TimePoint now);
  OrderAnswer measure(const MeasureHearingOrder& wanted, TimePoint now);
  /// Refuses the order that is under way if `problem` is not empty, and then returns true.
  bool is_refused(const std::string& problem) {
    if (!problem.empty()) order_.refuse(problem);
    return !problem.empty();
  }
  std::string problem_with_refresh(const RefreshKeysOrder& wanted) const;
  void leave_behind(const RefreshKeysOrder& wanted);
  void begin_refresh();
  void on_refresh_stored(const std::string& problem);
  void on_removal_stored(const std::string& problem);
  const Node* find_robot(const std::string& robot) const;
  OrderAnswer permit_join(const PermitJoinOrder& wanted, TimePoint now);
  std::string problem_with_mesh() const;
  const Node* node_called(const std::string& robot);
  const Node* node_to_ask(OpenOrder::Kind kind, const std::string& robot, Duration limit,
                          TimePoint now);
  void answer_export(std::uint16_t address);
  void undo_import(const std::string& problem, TimePoint now);
  void warn_of_unheard_robots();
  std::string problem_with_name(const std::string& robot, const std::optional<Uuid>& uuid) const;
  std::string link_is_down() const { return "the BLE link is down: " + link_.down_reason; }
  std::string scan_json(TimePoint now) const;
  bool has_new_settings() const;

  Admission& admission_;
  NodeConversations& conversations_;
  KeyRefresh& refresh_;
  HearingSurvey& survey_;
  const std::string gateway_;
  std::deque<Waiting> waiting_;
};

}  // namespace slamgw::ble
