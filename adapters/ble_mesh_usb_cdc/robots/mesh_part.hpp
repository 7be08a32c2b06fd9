// SPDX-License-Identifier: Apache-2.0
// What Robots, Uplink and Downlink share; and whether this gateway deals with what a robot says. In
// a mesh that only this gateway's radio hears, always. In one that several gateways share, all
// radios hear a robot. The gateway that holds the robot's session at the broker reports and
// acknowledges what it says; the others are silent. Part of BleMesh.
#pragma once

#include <functional>
#include <string>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/provisioning/provisioner_part.hpp"
#include "adapters/ble_mesh_usb_cdc/robots/robot.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::ble {

class ServiceGate {
 public:
  /// Whether this gateway holds the robot's session.
  using MayServe = std::function<bool(const std::string& robot)>;

  /// `nodes` outlives it. `has_group`: robots publish to a group of the gateways. Without one, a
  /// single radio hears them, even if other gateways have the keys.
  ServiceGate(const NodeTable& nodes, bool has_group) : nodes_(nodes), has_group_(has_group) {}

  void ask(MayServe may_serve) { may_serve_ = std::move(may_serve); }
  /// Other gateways have radios in this mesh.
  bool is_shared() const { return has_group_ && nodes_.is_shared(); }
  bool is_open_for(const Robot& robot) const { return !is_shared() || may_serve_(robot.id); }
  /// A robot that joined after the mesh was brought in here: the gateway that took it in knows its
  /// name, this one does not, and would publish under another.
  bool is_stranger(std::uint16_t address) const {
    return nodes_.is_guest() && nodes_.find_joined(address) == nullptr;
  }

 private:
  const NodeTable& nodes_;
  const bool has_group_;
  MayServe may_serve_ = [](const std::string&) { return true; };
};

class MeshPart {
 public:
  /// All of them outlive it. `is_traced`: each transmission and acknowledgement is a MeshStep.
  MeshPart(const Settings& settings, const TopicScheme& topics, Radio& radio, const LinkState& link,
           const ServiceGate& gate, ActionQueue<MeshAction>& actions, const bool& is_traced)
      : settings_(settings),
        topics_(topics),
        radio_(radio),
        link_(link),
        gate_(gate),
        actions_(actions),
        is_traced_(is_traced) {}

 protected:
  void emit(MeshEvent event) { actions_.push(std::move(event)); }

  const Settings& settings_;
  const TopicScheme& topics_;
  Radio& radio_;
  const LinkState& link_;
  const ServiceGate& gate_;
  ActionQueue<MeshAction>& actions_;
  const bool& is_traced_;
};

}  // namespace slamgw::ble
