// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/operator_orders.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "adapters/ble_mesh_usb_cdc/provisioning/mesh_json.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/node_report.hpp"
#include "daemon/core/topic_scheme.hpp"
#include "daemon/core/utf8.hpp"

namespace slamgw::ble {
namespace {

using OrderedJson = nlohmann::ordered_json;
using Kind = OpenOrder::Kind;

constexpr Duration short_order_time_limit = std::chrono::seconds{20};
/// An order that ends when the disk has answered, however late.
constexpr TimePoint when_stored = TimePoint::max();
constexpr std::uint64_t no_events = ~std::uint64_t{0};
constexpr const char* is_refreshing =
    "the mesh's keys are being refreshed; see `ble refresh-keys --status`";

std::string unknown_robot(const std::string& robot) {
  return fmt::format("no robot of this mesh is called {}; see `ble nodes`", robot);
}

}  // namespace

void OperatorOrders::on_order(std::uint64_t id, const BleOrder& order, TimePoint now) {
  const auto answer = [&](OrderAnswer what) { actions_.push(OrderEnded{id, std::move(what)}); };
  const auto begin = [&](const auto& wanted) {
    using Wanted = std::decay_t<decltype(wanted)>;
    constexpr bool may_wait =
        std::is_same_v<Wanted, PingOrder> || std::is_same_v<Wanted, NodeConfigOrder>;
    if (order_ && may_wait && waiting_.size() < max_waiting)
      return void(waiting_.emplace_back(id, order));
    if (order_) return answer({{}, "another command for this mesh is still under way"});
    order_.open({.id = id});
    take(wanted, now);
  };
  std::visit(overloaded{
                 [&](const NodesOrder&) {
                   answer({nodes_.json(), {}});
                 },
                 [&](const PermitJoinOrder& wanted) { answer(permit_join(wanted, now)); },
                 [&](const JoinEventsOrder& wanted) {
                   answer({admission_.permit().json(wanted.after, now), {}});
                 },
                 [&](const RefreshKeysOrder& wanted) {
                   if (!wanted.is_question) return begin(wanted);
                   std::string problem = problem_with_mesh();
                   if (!problem.empty()) return answer({{}, std::move(problem)});
                   answer({refresh_.json(), {}});
                 },
                 [&](const MeasureHearingOrder& wanted) { answer(measure(wanted, now)); },
                 begin,
             },
             order);
}

OrderAnswer OperatorOrders::measure(const MeasureHearingOrder& wanted, TimePoint now) {
  std::string problem = problem_with_mesh();
  if (problem.empty() && !wanted.is_question)
    problem = refresh_.is_on() ? is_refreshing : survey_.begin(now);
  if (!problem.empty()) return {{}, std::move(problem)};
  return {survey_.json(), {}};
}

void OperatorOrders::begin_waiting(TimePoint now) {
  while (!order_ && !waiting_.empty()) {
    const Waiting next = std::move(waiting_.front());
    waiting_.pop_front();
    on_order(next.first, next.second, now);
  }
}

std::string OperatorOrders::problem_with_mesh() const {
  if (!nodes_.database() && !link_.is_up) return link_is_down();
  if (!nodes_.database())
    return "this gateway does not have the mesh's keys: bring the mesh in with `ble import`";
  if (nodes_.is_guest())
    return fmt::format(
        "{} provisions this mesh, which was brought in here with `ble import`: do it there",
        nodes_.database()->host.empty() ? "another gateway"
                                        : fmt::format("gateway '{}'", nodes_.database()->host));
  return {};
}

std::string OperatorOrders::problem_with_name(const std::string& robot,
                                              const std::optional<Uuid>& uuid) const {
  if (!is_valid_level(robot) || !is_printable(robot))
    return "a robot's id is 1 to 64 bytes without + # /, control and invisible characters";
  const auto& configured = nodes_.names().configured();
  const auto name = std::ranges::find(configured, robot, &RobotName::id);
  if (name != configured.end() && !name->ble_address)
    return robot + " is a robot on Thread: \"robots\" gives it no ble_address";
  for (const Node& node : nodes_.database()->nodes)
    if (node.uuid != uuid && node.state != NodeState::reserved &&
        nodes_.id_of(node.address) == robot)
      return fmt::format("{} is another robot already: UUID {}, address 0x{:04x}", robot,
                         to_hex(node.uuid), node.address);
  return {};
}

// --- New robots ----------------------------------------------------------------------------------

void OperatorOrders::take(const ScanOrder&, TimePoint now) {
  order_.set(Kind::scan, now + scan_time);
  if (!link_.is_up) order_.refuse(link_is_down());
}

void OperatorOrders::take(const ProvisionOrder& wanted, TimePoint now) {
  const auto uuid = parse_uuid(wanted.uuid);
  if (!uuid) return order_.refuse("the UUID is not 32 hex digits; `ble scan` shows the devices");
  if (is_refused(problem_with_mesh())) return;
  if (!link_.is_up) return order_.refuse(link_is_down());
  if (is_refused(problem_with_name(wanted.robot, uuid))) return;
  const Node* known = nodes_.find(*uuid);
  if (known != nullptr && known->state != NodeState::reserved &&
      !admission_.candidates().find(*uuid, now))
    return order_.refuse(
        fmt::format("it is in the mesh already, as {}", nodes_.id_of(known->address)));
  order_.set(Kind::provision, now + search_time_limit, *uuid);
  order_->robot = wanted.robot;
}

OrderAnswer OperatorOrders::permit_join(const PermitJoinOrder& wanted, TimePoint now) {
  const bool is_closing = wanted.time.count() <= 0;
  std::string problem = problem_with_mesh();
  if (problem.empty() && !is_closing && !wanted.robot.empty())
    problem = problem_with_name(wanted.robot, std::nullopt);
  if (problem.empty() && !is_closing && !link_.is_up) problem = link_is_down();
  if (!problem.empty()) return {{}, std::move(problem)};
  JoinPermit& permit = admission_.permit();
  const bool was_open = permit.is_open();
  is_closing ? permit.close() : permit.open(wanted.time, wanted.robot, now);
  if (permit.is_open() || was_open)
    notify(Severity::notice,
           is_closing
               ? "an operator no longer lets new robots join"
               : fmt::format("an operator lets new robots join for {}{}", wanted.time_words(),
                             wanted.robot.empty() ? "" : ", one, as " + wanted.robot));
  return {permit.json(no_events, now), {}};
}

std::string OperatorOrders::scan_json(TimePoint now) const {
  OrderedJson devices = OrderedJson::array();
  for (const Candidate& candidate : admission_.candidates().all(now)) {
    const Node* node = nodes_.find(candidate.uuid);
    const bool was_removed = nodes_.database() && nodes_.database()->was_removed(candidate.uuid);
    const auto age = std::chrono::duration_cast<std::chrono::seconds>(now - candidate.last_heard);
    OrderedJson device{{"uuid", to_hex(candidate.uuid)},
                       {"rssi_dbm", nullptr},
                       {"heard_s_ago", age.count()},
                       {"state", was_removed ? "removed"
                                 : node      ? "known"
                                             : "new"},
                       {"robot", nullptr}};
    if (candidate.rssi_dbm) device["rssi_dbm"] = *candidate.rssi_dbm;
    if (node != nullptr) device["robot"] = nodes_.id_of(node->address);
    devices.push_back(std::move(device));
  }
  return devices.dump();
}

// --- Robots of the mesh --------------------------------------------------------------------------

/// Returns null if the order was refused.
const Node* OperatorOrders::node_called(const std::string& robot) {
  if (is_refused(problem_with_mesh())) return nullptr;
  const Node* node = find_robot(robot);
  if (node == nullptr) order_.refuse(unknown_robot(robot));
  return node;
}

void OperatorOrders::take(const RemoveOrder& wanted, TimePoint now) {
  const Node* node = node_called(wanted.robot);
  if (node == nullptr) return;
  order_.set(Kind::remove, now + Admission::order_time_limit, node->uuid);
  order_->is_forced = wanted.is_forced;
  if (admission_.is_chosen(node->uuid)) return order_.refuse("it is joining right now");
  if (node->state == NodeState::reserved || (!link_.is_up && wanted.is_forced))
    return conversations_.on_reset(*node, node->state == NodeState::reserved, {}, now);
  if (!link_.is_up) order_.refuse(link_is_down() + "; --force forgets the robot anyway");
}

void OperatorOrders::on_removal_stored(const std::string& problem) {
  if (order_->removed.empty()) return;  // the robot is still to be reset
  if (!problem.empty())
    return order_.refuse(problem + "; the robot is removed when it can be stored");
  if (nodes_.is_saved()) order_.answer(std::move(order_->removed));
}

const Node* OperatorOrders::find_robot(const std::string& robot) const {
  const auto& nodes = nodes_.database()->nodes;
  const auto node = std::ranges::find_if(
      nodes, [&](const Node& each) { return nodes_.id_of(each.address) == robot; });
  return node == nodes.end() ? nullptr : &*node;
}

/// Returns null if the order was refused.
const Node* OperatorOrders::node_to_ask(OpenOrder::Kind kind, const std::string& robot,
                                        Duration limit, TimePoint now) {
  const Node* node = node_called(robot);
  if (node == nullptr) return nullptr;
  order_.set(kind, now + limit, node->uuid);
  if (node->state == NodeState::reserved || admission_.is_joining(node->uuid)) {
    order_.refuse(robot + " has not joined the mesh yet");
  } else if (!link_.is_up) {
    order_.refuse(link_is_down());
  } else {
    return node;
  }
  return nullptr;
}

void OperatorOrders::take(const PingOrder& wanted, TimePoint now) {
  node_to_ask(Kind::ping, wanted.robot, short_order_time_limit, now);
}

/// A changed wish makes the node's configuration outdated, so that the node is configured again.
void OperatorOrders::take(const NodeConfigOrder& wanted, TimePoint now) {
  const Node* node = node_to_ask(Kind::config, wanted.robot, Admission::order_time_limit, now);
  if (node == nullptr || !wanted.is_change()) return;
  if (!node->applied)
    return order_.refuse(wanted.robot +
                         " is configured by another tool, and this gateway leaves it so");
  NodeWishes wishes = node->wishes;
  if (wanted.ttl) wishes.ttl = *wanted.ttl;
  if (wanted.relay) wishes.relay = *wanted.relay;
  if (wanted.transmit) wishes.transmit = *wanted.transmit;
  const auto is_of_all = [&](std::uint16_t group) {
    return std::ranges::find(settings_.groups, group) != settings_.groups.end();
  };
  if (wanted.unsubscribe && is_of_all(*wanted.unsubscribe))
    return order_.refuse("all robots hear this group: take it out of ble_mesh.groups");
  if (wanted.unsubscribe) std::erase(wishes.groups, *wanted.unsubscribe);
  if (wanted.subscribe && !is_of_all(*wanted.subscribe)) {
    std::erase(wishes.groups, *wanted.subscribe);
    wishes.groups.push_back(*wanted.subscribe);
  }
  if (wishes.groups.size() > NodeWishes::max_groups)
    return order_.refuse(
        fmt::format("a robot may have {} groups of its own", std::size_t{NodeWishes::max_groups}));
  if (wanted.publish) {
    const auto model = find_publisher(wanted.publish->model);
    if (!model)
      return order_.refuse(wanted.publish->model + " is not a model that publishes: `ble config " +
                           wanted.robot + "` shows those that do");
    wishes.publications.erase(to_string(*model));
    // The gateway's own address is that of all robots, and changes with the radio's next life.
    const auto address = wanted.publish->address;
    if (address && (settings_.gateway_group || !nodes_.is_own(*address)))
      wishes.publications[to_string(*model)] = *address;
  }
  Node& changed = *nodes_.change().find(node->uuid);
  changed.wishes = wishes;
  changed.applied->is_changing = true;
  nodes_.history(changed.uuid).retry_at = now;
  nodes_.announce_change();
}

// --- The mesh ------------------------------------------------------------------------------------

void OperatorOrders::take(const ImportOrder& wanted, TimePoint) {
  if (refresh_.is_on()) return order_.refuse(is_refreshing);
  auto imported = decode_imported_mesh(wanted.text);
  if (!imported.has_value())
    return order_.refuse("the file can't be imported: " + imported.error().why);
  std::optional<NodeDatabase> own;
  if (nodes_.database()) own = *nodes_.database();
  auto merged = merge_imported_mesh(own, std::move(*imported), settings_.address);
  if (!merged.has_value())
    return order_.refuse("the file can't be imported: " + merged.error().why);
  if (nodes_.is_beginning()) return order_.refuse("the mesh's keys are being made; try again");
  if (!nodes_.is_saved() || !admission_.is_idle())
    return order_.refuse("the mesh is being changed right now; try again");
  order_.set(Kind::import_mesh, when_stored);
  order_->before = std::move(own);
  nodes_.replace(std::move(*merged));
}

/// The address is on disk before the other gateway gets it, so that it is not given away again.
void OperatorOrders::take(const ExportOrder& wanted, TimePoint) {
  if (is_refused(problem_with_mesh())) return;
  if (refresh_.is_on()) return order_.refuse(is_refreshing);
  const NodeDatabase& database = *nodes_.database();
  if (wanted.address != 0) {
    if (std::ranges::find(database.gateways, wanted.address) == database.gateways.end())
      return order_.refuse(
          fmt::format("no gateway of this mesh was given the address 0x{:04x}", wanted.address));
    return answer_export(wanted.address);
  }
  const auto address = nodes_.address_for_gateway();
  if (!address) return order_.refuse("no unicast address below 0x0100 is left for another gateway");
  order_.set(Kind::export_mesh, when_stored);
  order_->address = *address;
  nodes_.change().gateways.push_back(*address);
}

void OperatorOrders::answer_export(std::uint16_t address) {
  order_.answer(exported_mesh_json(*nodes_.database(), address, nodes_.room_at(address), gateway_));
}

void OperatorOrders::on_stored(const std::string& problem, TimePoint now) {
  const bool is_import = order_.is(Kind::import_mesh);
  if (order_.is(Kind::refresh_keys)) return on_refresh_stored(problem);
  if (order_.is(Kind::remove)) return on_removal_stored(problem);
  if (!is_import && !order_.is(Kind::export_mesh)) return;
  if (!problem.empty()) {
    if (is_import) {
      undo_import(problem, now);
    } else {
      std::erase(nodes_.change().gateways, order_->address);
    }
    return order_.refuse(problem);
  }
  if (!nodes_.is_saved()) return;
  const NodeDatabase& database = *nodes_.database();
  if (!is_import) return answer_export(order_->address);
  if (!order_->before) radio_.change_keys(radio_keys(database), now);
  nodes_.announce_change();
  warn_of_unheard_robots();
  order_.answer(fmt::format(R"({{"nodes":{}}})", database.nodes.size()));
}

/// Puts the former mesh back, but keeps what the radio has reported since the import.
void OperatorOrders::undo_import(const std::string& problem, TimePoint now) {
  if (!order_->before) {
    nodes_.replace({});
    return radio_.on_keys_failed(problem, now);  // it may have asked for keys
  }
  NodeDatabase& before = *order_->before;
  before.life = nodes_.database()->life;
  before.iv_index = nodes_.database()->iv_index;
  nodes_.replace(std::move(before));
}

/// Warns if this radio does not hear the address that robots of another gateway's mesh publish to.
void OperatorOrders::warn_of_unheard_robots() {
  if (!nodes_.is_guest()) return;
  const auto is_unheard = [&](const Node& node) {
    return node.applied && node.applied->destination != settings_.destination();
  };
  const auto& nodes = nodes_.database()->nodes;
  const auto node = std::ranges::find_if(nodes, is_unheard);
  if (node == nodes.end()) return;
  notify(Severity::warning,
         fmt::format("robots of this mesh publish to 0x{:04x}, which this gateway does not hear: "
                     "give the same ble_mesh.gateway_group to all gateways of the mesh",
                     node->applied->destination));
}

void OperatorOrders::take(const ResetBoardOrder&, TimePoint now) {
  order_.set(Kind::reset_board, now + short_order_time_limit);
  notify(
      Severity::warning,
      "an operator has the radio cleared: its sequence numbers start over, and it sends from the "
      "next address");
  radio_.clear(now);
}

void OperatorOrders::on_radio_cleared(const std::string& problem) {
  if (!order_.is(Kind::reset_board)) {  // the operator has its answer already
    if (!problem.empty()) notify(Severity::warning, "the radio was not cleared: " + problem);
    return;
  }
  if (problem.empty()) return order_.answer(R"({"cleared":true})");
  order_.refuse("the radio was not cleared: " + problem);
}

// --- The mesh's keys -----------------------------------------------------------------------------

void OperatorOrders::take(const RefreshKeysOrder& wanted, TimePoint now) {
  if (is_refused(problem_with_refresh(wanted))) return;
  order_.set(Kind::refresh_keys, now + short_order_time_limit);
  leave_behind(wanted);
  if (!refresh_.is_on()) return begin_refresh();
  if (nodes_.is_saved()) order_.answer(refresh_.json());
}

void OperatorOrders::begin_refresh() {
  if (const auto keys = make_keys()) return refresh_.begin(*keys);
  notify(Severity::error, no_randomness);
  order_.refuse(no_randomness);
}

std::string OperatorOrders::problem_with_refresh(const RefreshKeysOrder& wanted) const {
  if (std::string problem = problem_with_mesh(); !problem.empty()) return problem;
  if (nodes_.is_shared())
    return "other gateways have radios in this mesh and would keep the old keys: stop "
           "slam-gateway, take their addresses out of \"gateways\" in mesh.json, refresh the keys, "
           "then let them "
           "join again with `ble export`";
  if (survey_.is_on() && !refresh_.is_on())
    return "`ble topology --measure` is running; try again when it has ended";
  for (const std::string& robot : wanted.left_behind) {
    const Node* node = find_robot(robot);
    if (node == nullptr) return unknown_robot(robot);
    if (node->refreshed != RefreshStep::none)
      return fmt::format(
          "{} has the new keys already: when this refresh has ended, begin another "
          "one without it",
          robot);
  }
  return {};
}

/// A robot that was sent a new key may have it, even if it did not answer.
void OperatorOrders::leave_behind(const RefreshKeysOrder& wanted) {
  std::vector<Uuid> left;
  for (const Node& node : nodes_.database()->nodes) {
    const bool is_named = std::ranges::find(wanted.left_behind, nodes_.id_of(node.address)) !=
                          wanted.left_behind.end();
    const bool is_silent =
        wanted.leaves_silent && node.refreshed == RefreshStep::none && refresh_.has_failed(node);
    if (is_named || is_silent) left.push_back(node.uuid);
  }
  for (const Uuid& uuid : left) {
    const std::uint16_t address = nodes_.find(uuid)->address;
    const std::string id = nodes_.id_of(address);
    conversations_.drop(address);
    admission_.remove(uuid);
    notify(Severity::notice,
           id + " keeps the mesh's old keys and is removed from this mesh" +
               (refresh_.is_on() ? "; it may have heard the new keys: if strangers may have it, "
                                   "refresh the keys again after this"
                                 : ""),
           id);
  }
}

void OperatorOrders::on_refresh_stored(const std::string& problem) {
  if (!problem.empty())
    return order_.refuse(problem + "; the keys are refreshed when it can be stored");
  if (refresh_.is_on() && nodes_.is_saved()) order_.answer(refresh_.json());
}

// --- Orders that end by themselves ---------------------------------------------------------------

/// Returns true for new settings that the robot does not have yet: they are on disk or on their
/// way.
bool OperatorOrders::has_new_settings() const {
  const Node* node = order_.is(Kind::config) ? nodes_.find(order_->uuid) : nullptr;
  return node != nullptr && node->applied && node->applied->is_changing;
}

void OperatorOrders::on_link_down() {
  if (!order_ || order_->kind > Kind::config || !order_->removed.empty()) return;
  order_.refuse("the BLE link went down: " + link_.down_reason +
                (has_new_settings() ? "; the new settings are kept and tried again" : ""));
}

void OperatorOrders::on_deadline(TimePoint now) {
  if (!order_ || now < order_->due) return;
  if (order_.is(Kind::scan)) return order_.answer(scan_json(now));
  const std::string was_busy = "the gateway was busy with its robots or with the disk; ";
  if (order_.is(Kind::remove) && order_->removed.empty())  // its reset may just have begun
    return order_.refuse("the robot is still in the mesh: " + was_busy +
                         "see `ble nodes` before you try again");
  if (order_.is(Kind::config) && !has_new_settings())
    return order_.refuse(was_busy + "try again later");
  if (order_.is(Kind::ping))
    return order_.refuse(
        "the gateway is configuring this robot, which does not answer; try again later");
  const Node* node = nodes_.find(order_->uuid);
  const bool is_under_way = admission_.is_chosen(order_->uuid) ||
                            (node != nullptr && node->state == NodeState::provisioned);
  if (order_.is(Kind::provision) && !is_under_way)
    return order_.refuse("it was not heard: is it switched on, in reach, and in no mesh?");
  order_.refuse("it takes longer: the order continues in the background; see `ble nodes`");
}

}  // namespace slamgw::ble
