// SPDX-License-Identifier: Apache-2.0
// What operators order, and the answers they get. One order at a time; no answer holds a key.
#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "adapters/ble_mesh_usb_cdc/provisioning/imported_mesh.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/provisioner.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::ble {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::string_view no_keys =
    "this gateway does not have the mesh's keys: bring the mesh in with `ble import`";
constexpr std::string_view not_here =
    "another gateway provisions this mesh (this one was brought in with `ble import`): do it there";
constexpr std::uint16_t first_gateway_address = 0x0001;
constexpr Duration short_order_time_limit = std::chrono::seconds{20};

}  // namespace

void Provisioner::on_order(std::uint64_t id, MeshOrder order, TimePoint now) {
  if (std::holds_alternative<NodesOrder>(order)) {
    actions_.push(OrderEnded{id, {nodes_json(), {}}});
    return;
  }
  if (const auto* permit = std::get_if<PermitJoinOrder>(&order))
    return permit_join(id, *permit, now);
  if (const auto* events = std::get_if<JoinEventsOrder>(&order)) {
    actions_.push(OrderEnded{id, {permit_.json(events->after, now), {}}});
    return;
  }
  if (order_) {
    actions_.push(OrderEnded{id, {{}, "another command for this mesh is still under way"}});
    return;
  }
  order_ = Order{};
  order_->id = id;
  std::visit(overloaded{
                 [&](const ScanOrder&) { take_scan(now); },
                 [&](const ProvisionOrder& what) { take(what, now); },
                 [](const PermitJoinOrder&) {},
                 [](const JoinEventsOrder&) {},
                 [](const NodesOrder&) {},
                 [&](const RemoveOrder& what) { take(what, now); },
                 [&](const ImportOrder& what) { take(what, now); },
                 [&](const ExportOrder&) { take_export(now); },
                 [&](const ResetBoardOrder&) { take_reset(now); },
             },
             order);
  advance(now);
}

void Provisioner::take_scan(TimePoint now) {
  order_->kind = OrderKind::scan;
  order_->due = now + scan_time;
  if (!is_up_) refuse("the BLE link is down: " + down_reason_);
}

void Provisioner::take(const ProvisionOrder& wanted, TimePoint now) {
  const auto uuid = parse_uuid(wanted.uuid);
  if (!uuid) return refuse("the UUID is not 32 hex digits; `ble scan` shows who is there");
  if (!database()) return refuse(std::string(no_keys));
  if (is_guest()) return refuse(std::string(not_here));
  if (!is_up_) return refuse("the BLE link is down: " + down_reason_);
  if (std::string problem = problem_with_name(wanted.robot, uuid); !problem.empty())
    return refuse(std::move(problem));
  const Node* known = database()->find(*uuid);
  if (known != nullptr && known->state != NodeState::reserved && !candidates_.find(*uuid, now))
    return refuse(fmt::format("it is in the mesh already, as {}", id_of(known->address)));
  order_->kind = OrderKind::provision;
  order_->due = now + search_time_limit;
  order_->uuid = *uuid;
  order_->robot = wanted.robot;
}

std::string Provisioner::problem_with_name(const std::string& robot,
                                           const std::optional<Uuid>& uuid) const {
  if (!is_valid_level(robot))
    return "a robot's id is 1 to 64 bytes without + # / and control characters";
  const auto& configured = names_.configured();
  const auto name = std::ranges::find(configured, robot, &RobotName::id);
  if (name != configured.end() && !name->ble_address)
    return robot + " is a robot on Thread: \"robots\" gives it no ble_address";
  for (const Node& node : database()->nodes)
    if (node.uuid != uuid && node.state != NodeState::reserved && id_of(node.address) == robot)
      return fmt::format("{} is another robot already: UUID {}, address 0x{:04x}", robot,
                         to_hex(node.uuid), node.address);
  return {};
}

void Provisioner::permit_join(std::uint64_t id, const PermitJoinOrder& wanted, TimePoint now) {
  std::string problem = database() ? "" : std::string(no_keys);
  if (is_guest()) problem = not_here;
  const bool is_closing = wanted.time.count() <= 0;
  if (problem.empty() && !wanted.robot.empty() && !is_closing)
    problem = problem_with_name(wanted.robot, std::nullopt);
  if (problem.empty() && !is_up_ && !is_closing) problem = "the BLE link is down: " + down_reason_;
  if (!problem.empty()) {
    actions_.push(OrderEnded{id, {{}, std::move(problem)}});
    return;
  }
  const bool was_open = permit_.is_open();
  is_closing ? permit_.close() : permit_.open(wanted.time, wanted.robot, now);
  if (permit_.is_open() || was_open)
    say(Severity::notice,
        is_closing ? "an operator lets no new robots join any more"
                   : fmt::format("an operator lets new robots join for {} min{}",
                                 std::min(wanted.time, JoinPermit::longest).count(),
                                 wanted.robot.empty() ? "" : ", one, as " + wanted.robot));
  actions_.push(OrderEnded{id, {permit_.json(~std::uint64_t{0}, now), {}}});
  advance(now);
}

void Provisioner::take(const RemoveOrder& wanted, TimePoint now) {
  if (!database()) return refuse(std::string(no_keys));
  if (is_guest()) return refuse(std::string(not_here));
  const auto& nodes = database()->nodes;
  const auto node = std::ranges::find_if(
      nodes, [&](const Node& each) { return id_of(each.address) == wanted.robot; });
  if (node == nodes.end())
    return refuse(fmt::format("no robot of this mesh is called {}; see `ble nodes`", wanted.robot));
  order_->kind = OrderKind::remove;
  order_->due = now + order_time_limit;
  order_->uuid = node->uuid;
  order_->is_forced = wanted.is_forced;
  const bool is_busy =
      (session_ && session_->uuid() == node->uuid) || (chosen_ && chosen_->uuid == node->uuid);
  if (is_busy) return refuse("it is just being taken in");
  if (node->state == NodeState::reserved || (!is_up_ && wanted.is_forced))
    return on_reset(*node, true, {}, now);
  if (!is_up_)
    refuse("the BLE link is down: " + down_reason_ + "; --force forgets the robot all the same");
}

void Provisioner::take(const ImportOrder& wanted, TimePoint now) {
  auto imported = decode_imported_mesh(wanted.text);
  if (!imported.has_value()) return refuse("the file can't be imported: " + imported.error().why);
  std::optional<NodeDatabase> own;
  if (database()) own = *database();
  auto merged = merge_imported_mesh(own, std::move(*imported), settings_.address);
  if (!merged.has_value()) return refuse("the file can't be imported: " + merged.error().why);
  if (!ledger_.is_saved()) return refuse("the mesh is just being changed; try again");
  order_->kind = OrderKind::import_mesh;
  order_->due = now + order_time_limit;
  order_->before = std::move(own);
  strangers_.clear();
  ledger_.begin(std::move(*merged), false);
}

/// The address is on disk before the other gateway gets it: no robot and no third gateway will.
void Provisioner::take_export(TimePoint now) {
  if (!database()) return refuse(std::string(no_keys));
  if (is_guest()) return refuse(std::string(not_here));
  const auto address = address_for_gateway();
  if (!address) return refuse("no unicast address below 0x0100 is left for another gateway");
  order_->kind = OrderKind::export_mesh;
  order_->due = now + short_order_time_limit;
  order_->address = *address;
  ledger_.change().gateways.push_back(*address);
}

std::optional<std::uint16_t> Provisioner::address_for_gateway() const {
  const std::set<std::uint16_t> taken = taken_addresses();
  for (std::uint16_t address = first_gateway_address; address < first_robot_address; ++address)
    if (configured_name(address) == nullptr && !was_used_before(*database(), address, 1) &&
        is_address_free(*database(), address, 1, taken, {}))
      return address;
  return std::nullopt;
}

void Provisioner::take_reset(TimePoint now) {
  order_->kind = OrderKind::reset_board;
  order_->due = now + short_order_time_limit;
  say(Severity::warning,
      "an operator has the serial board cleared: its sequence numbers start anew, and robots "
      "ignore what the gateway says until they have passed the old ones or were restarted");
  actions_.push(ClearBoard{});
}

void Provisioner::on_board_cleared(bool is_done, const std::string& why, TimePoint now) {
  if (is_ordered(OrderKind::reset_board)) {
    if (is_done) {
      answer(R"({"cleared":true})");
    } else {
      refuse("the serial board was not cleared: " + why);
    }
  }
  advance(now);
}

void Provisioner::on_order_due(TimePoint now) {
  switch (order_->kind) {
    case OrderKind::scan: return answer(scan_json(now));
    case OrderKind::provision: {
      const Node* node = database() ? database()->find(order_->uuid) : nullptr;
      const bool is_under_way = (session_ && session_->uuid() == order_->uuid) ||
                                (chosen_ && chosen_->uuid == order_->uuid) ||
                                (node != nullptr && node->state == NodeState::provisioned);
      if (is_under_way) break;
      return refuse("it was not heard: is it switched on, in reach, and in no mesh?");
    }
    case OrderKind::remove:
    case OrderKind::import_mesh:
    case OrderKind::export_mesh:
    case OrderKind::reset_board: break;
  }
  refuse("it takes long and goes on by itself; see `ble nodes`");
}

void Provisioner::answer(std::string json) {
  actions_.push(OrderEnded{order_->id, {std::move(json), {}}});
  order_.reset();
}

void Provisioner::refuse(std::string why) {
  actions_.push(OrderEnded{order_->id, {{}, std::move(why)}});
  order_.reset();
}

std::string Provisioner::scan_json(TimePoint now) const {
  Json devices = Json::array();
  for (const Candidate& candidate : candidates_.all(now)) {
    const Node* node = database() ? database()->find(candidate.uuid) : nullptr;
    const bool was_removed = database() && database()->was_removed(candidate.uuid);
    const auto age = std::chrono::duration_cast<std::chrono::seconds>(now - candidate.last_heard);
    Json device{{"uuid", to_hex(candidate.uuid)},
                {"rssi_dbm", candidate.rssi_dbm},
                {"heard_s_ago", age.count()},
                {"state", was_removed ? "removed"
                          : node      ? "known"
                                      : "new"},
                {"robot", nullptr}};
    if (node != nullptr) device["robot"] = id_of(node->address);
    devices.push_back(std::move(device));
  }
  return devices.dump();
}

std::string Provisioner::nodes_json() const {
  std::string rows;
  if (database() == nullptr) return "[]";
  for (const Node& node : database()->nodes) rows += (rows.empty() ? "" : ",") + node_json(node);
  return "[" + rows + "]";
}

std::string Provisioner::node_json(const Node& node) const {
  const auto upkeep = upkeep_.find(node.uuid);
  return Json{{"robot", id_of(node.address)},
              {"uuid", to_hex(node.uuid)},
              {"address", fmt::format("0x{:04x}", node.address)},
              {"elements", node.elements},
              {"state", to_string(node.state)},
              {"problem", upkeep == upkeep_.end() ? "" : upkeep->second.problem}}
      .dump();
}

}  // namespace slamgw::ble
