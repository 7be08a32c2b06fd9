// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/meshes.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <type_traits>
#include <utility>

#include "adapters/ble_mesh_bluez/io/meshd_adapter.hpp"
#include "adapters/ble_mesh_usb_cdc/io/board_adapter.hpp"
#include "adapters/ble_mesh_usb_cdc/io/cobs_adapter.hpp"
#include "adapters/mqttsn_udp/io/mqttsn_adapter.hpp"

namespace slamgw {
namespace {

TopicPolicy policy_of(const Config& config, const TopicScheme& scheme) {
  return {scheme, config.topics.extra_publish, config.topics.extra_subscribe};
}

}  // namespace

Meshes::Meshes(boost::asio::io_context& io, const Config& config, const TopicScheme& scheme,
               SessionStore& sessions, DescriptorStore& descriptors, MeshListener& listener)
    : scheme_(scheme), relay_(config.ble_mesh.relay) {
  const RobotNames names(config.robots, Bans(config.bans));
  if (config.ble_mesh.enabled) make_ble(io, config, listener);
  if (config.mqttsn.enabled) {
    auto adapter = std::make_unique<mqttsn::MqttsnAdapter>(
        io, config.mqttsn, policy_of(config, scheme), names, listener, &sessions, &descriptors,
        config.robot_keys);
    thread_ = adapter.get();
    adapters_[Mesh::thread] = std::move(adapter);
    thread_->refuse_names([this](const std::string& robot) {
      return std::ranges::any_of(all_meshes, [&](Mesh mesh) {
        return mesh != Mesh::thread && presence_of(mesh, robot).has_value();
      });
    });
  }
}

void Meshes::make_ble(boost::asio::io_context& io, const Config& config, MeshListener& listener) {
  const RobotNames names(config.robots, Bans(config.bans));
  switch (config.ble_mesh.protocol) {
    case ble::Protocol::nordic_serial: {
      ble_sessions_.emplace(io, config.store.directory, DiskSessionStore::ble_commands(),
                            [&listener](Notice notice) { listener.on_mesh_event(notice); });
      const auto make = [&]<class Adapter>(std::type_identity<Adapter>) {
        auto adapter = std::make_unique<Adapter>(io, config.ble_mesh, scheme_, names,
                                                 config.store.directory, *ble_sessions_, listener);
        ble_ = adapter.get();
        adapters_[Mesh::ble] = std::move(adapter);
      };
      switch (config.ble_mesh.radio) {
        case ble::RadioChoice::nordic: make(std::type_identity<ble::BoardAdapter>{}); break;
        case ble::RadioChoice::bluez: make(std::type_identity<ble::MeshdAdapter>{}); break;
      }
      break;
    }
    case ble::Protocol::cobs: {
      auto adapter =
          std::make_unique<ble::CobsAdapter>(io, config.ble_mesh, scheme_, names, listener);
      cobs_ = adapter.get();
      adapters_[Mesh::ble] = std::move(adapter);
      break;
    }
  }
}

Meshes::~Meshes() = default;

bool Meshes::has_any() const {
  return std::ranges::any_of(adapters_, [](const auto& adapter) { return adapter != nullptr; });
}

bool Meshes::are_settled() const {
  return std::ranges::all_of(adapters_,
                             [](const auto& adapter) { return !adapter || adapter->is_settled(); });
}

std::optional<Presence> Meshes::presence_of(Mesh mesh, const std::string& robot) const {
  return adapters_[mesh] ? adapters_[mesh]->presence_of(robot) : std::nullopt;
}

void Meshes::deliver(const DeliverToMesh& action) {
  for (const Mesh mesh : all_meshes)
    if (adapters_[mesh] && (!action.mesh || action.mesh == mesh))
      adapters_[mesh]->on_broker_message(action.message);
}

std::vector<std::string> Meshes::relay_filters() const {
  std::vector<std::string> filters;
  if (ble_)
    for (const std::string& filter : relay_) filters.push_back(scheme_.prefix() + "/" + filter);
  return filters;
}

bool Meshes::takes(const BrokerMessage& message) {
  if (!ble_ || !message.topic.starts_with(scheme_.robot_root())) return false;
  ble_->on_robot_message(message);
  return true;
}

void Meshes::fire(const Receipt& receipt, ReceiptOutcome outcome) {
  if (adapters_[receipt.mesh]) adapters_[receipt.mesh]->on_receipt(receipt.id, outcome);
}

void Meshes::reconfigure(const Config& config) {
  const RobotNames names(config.robots, Bans(config.bans));
  if (thread_) thread_->reconfigure(policy_of(config, scheme_), names, config.robot_keys);
  if (ble_) ble_->reconfigure(names);
  if (cobs_) cobs_->reconfigure(names);
}

void Meshes::ask_where_served(std::function<bool(const std::string& robot)> served_elsewhere) {
  if (thread_) thread_->ask_where_served(std::move(served_elsewhere));
}

void Meshes::share_ble(std::function<bool(const std::string& robot)> may_serve, OnHeard on_heard) {
  if (!ble_) return;
  ble_->share_with(std::move(may_serve), [on_heard = std::move(on_heard)](const auto& heard) {
    on_heard(heard.robot, heard.radio);
  });
}

bool Meshes::is_shared(Mesh mesh) const { return mesh == Mesh::ble && ble_ && ble_->is_shared(); }

std::vector<WaitingMessage> Meshes::give_up(const std::string& robot) {
  std::vector<WaitingMessage> all;
  for (const auto& adapter : adapters_) {
    if (!adapter) continue;
    std::ranges::move(adapter->give_up(robot), std::back_inserter(all));
  }
  return all;
}

OrderAnswer Meshes::mqttsn_clients(const std::optional<std::string>& robot) const {
  if (!thread_) return {{}, "MQTT-SN is not enabled: set mqttsn.enabled to true"};
  const nlohmann::json rows = thread_->report(robot);
  if (robot && rows.empty()) return {{}, *robot + " has no MQTT-SN session here"};
  return {rows.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace), {}};
}

void Meshes::ping(const std::string& robot, OrderDone done) {
  const auto on_thread = presence_of(Mesh::thread, robot);
  const auto on_ble = presence_of(Mesh::ble, robot);
  if (!on_thread && !on_ble)
    return done({{}, "no robot called " + robot + " is known here; see slam-gatewayctl robots"});
  if (on_thread && (!on_ble || on_ble == Presence::offline))
    return thread_->ping(robot, std::move(done));
  manage_ble(PingOrder{robot}, std::move(done));
}

void Meshes::manage_ble(BleOrder order, OrderDone done) {
  if (cobs_)
    return done(
        {{}, "not supported by this link: ble_mesh.protocol is \"cobs\", which has no mesh"});
  if (!ble_) return done({{}, "the BLE mesh is not enabled: set ble_mesh.enabled to true"});
  const auto* provision = std::get_if<ProvisionOrder>(&order);
  const auto* permit = std::get_if<PermitJoinOrder>(&order);
  const std::string name = provision ? provision->robot : permit ? permit->robot : "";
  if (presence_of(Mesh::thread, name) && !presence_of(Mesh::ble, name))
    return done({{}, name + " is a Thread robot"});
  ble_->manage(order, std::move(done));
}

}  // namespace slamgw
