// SPDX-License-Identifier: Apache-2.0
// BleMesh's members: carries between Provisioner and the board, and keeps the robots in step with
// the database of nodes.
#include <algorithm>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/ble_mesh.hpp"

namespace slamgw::ble {

void BleMesh::on_stored(const std::string& problem, TimePoint now) {
  provisioner_.on_stored(problem, now);
  settle(now);
}

void BleMesh::on_order(std::uint64_t id, MeshOrder order, TimePoint now) {
  provisioner_.on_order(id, std::move(order), now);
  settle(now);
}

void BleMesh::on_provisioner_action(ProvisionerAction action, TimePoint now) {
  std::visit(overloaded{
                 // Not taken means that the link has gone down; Provisioner hears of it next.
                 [&](BoardCommand& command) { link_.command(std::move(command.frame), now); },
                 [&](SendUnderDeviceKey& message) {
                   if (!link_.send({message.address, message.devkey_handle,
                                    std::move(message.access), false},
                                   now))
                     ++counters_.sends_dropped;  // repeated by Provisioner
                 },
                 [&](NodesChanged&) { follow_nodes(now); },
                 [&](UseKeys& use) { link_.change_keys(use.keys, now); },
                 [&](ClearBoard&) {
                   if (!link_.clear_board(now))
                     provisioner_.on_board_cleared(false, "the BLE link is down", now);
                 },
                 [&](StoreMesh& store) { actions_.push(std::move(store)); },
                 [&](OrderEnded& ended) { actions_.push(std::move(ended)); },
                 [&](Notice& notice) { emit(std::move(notice)); },
             },
             action);
}

void BleMesh::follow_nodes(TimePoint now) {
  const NodeDatabase* database = provisioner_.nodes().database();
  std::vector<std::uint16_t> gone;
  for (auto& [address, robot] : robots_) {
    const Node* node = database ? database->find_address(address) : nullptr;
    const bool is_node = node != nullptr && node->state != NodeState::reserved;
    const bool is_the_same = is_node && provisioner_.nodes().id_of(address) == robot.id;
    if ((robot.is_node || is_node) && !is_the_same) gone.push_back(address);
  }
  for (const std::uint16_t address : gone) {
    take_out(robots_.at(address), now);
    robots_.erase(address);
  }
  if (database == nullptr) return;
  for (const Node& node : database->nodes) {
    const bool has_room = robots_.contains(node.address) || robots_.size() < max_robots;
    if (node.state != NodeState::reserved && has_room) add_node(node);
  }
}

void BleMesh::add_node(const Node& node) {
  const std::string id = provisioner_.nodes().id_of(node.address);
  const auto [entry, is_new] = robots_.try_emplace(node.address, node.address, id, settings_.ttl);
  Robot& robot = entry->second;
  robot.is_node = true;
  robot.sent_ttl = node.sent_ttl();
  if (is_new) subscribe(robot);
}

void BleMesh::take_out(Robot& robot, TimePoint now) {
  leave_name(robot, "the robot was put out of the mesh", now);
  std::erase_if(open_receipts_,
                [&](const auto& open) { return open.second.first == robot.address; });
}

void BleMesh::add_configured() {
  for (const RobotName& name : names_.configured()) {
    if (!name.ble_address) continue;
    const auto [entry, is_new] =
        robots_.try_emplace(*name.ble_address, *name.ble_address, name.id, settings_.ttl);
    if (is_new) subscribe(entry->second);
  }
}

void BleMesh::on_names(RobotNames names, TimePoint now) {
  names_ = std::move(names);
  provisioner_.on_names(names_);
  std::vector<Robot*> renamed;
  for (auto& [address, robot] : robots_)
    if (provisioner_.nodes().id_of(address) != robot.id) renamed.push_back(&robot);
  // All go before any comes: two may have changed their names with each other.
  for (Robot* robot : renamed) leave_name(*robot, "the robot is called otherwise by now", now);
  for (Robot* robot : renamed) {
    const bool was_only_configured = !robot->is_node && !robot->is_announced;
    if (was_only_configured) {
      robots_.erase(std::uint16_t{robot->address});
    } else {
      take_name(*robot, provisioner_.nodes().id_of(robot->address));
    }
  }
  add_configured();
  settle(now);
}

void BleMesh::leave_name(Robot& robot, const std::string& why, TimePoint now) {
  if (robot.is_online) announce(robot, Presence::offline);
  conclude(robot, robot.commands.refuse_all(why, now));
  emit(UnsubscribeRequest{Mesh::ble, topics_.command_filter(robot.id)});
}

void BleMesh::take_name(Robot& robot, std::string id) {
  robot.id = std::move(id);
  robot.retained_given.clear();
  robot.is_subscribed = true;
  subscribe(robot);
  if (robot.is_online) announce(robot, Presence::online);
}

std::uint16_t BleMesh::primary_of(std::uint16_t address) const {
  const NodeDatabase* database = provisioner_.nodes().database();
  const Node* node = database ? database->find_address(address) : nullptr;
  return node && node->state != NodeState::reserved ? node->address : address;
}

}  // namespace slamgw::ble
