// SPDX-License-Identifier: Apache-2.0
// What the core tells the application to do. Gateway, Commands and PresencePublisher leave these
// in one queue, so their order is the order in which things happened. Pure values.
#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <variant>

#include "daemon/core/messages.hpp"
#include "daemon/core/protocol_machine.hpp"
#include "daemon/core/traffic_event.hpp"

namespace slamgw {

/// Publish it by way of the outbox, which fires the receipt. CommandOutcome, as an action: report
/// it to the operator who has sent this command.
struct Upload {
  BrokerMessage message;
  Receipt receipt;
  /// Set for the outcome of a command: how long after the command.
  std::optional<std::chrono::milliseconds> outcome_after{};
};
/// A robot's message: show it to the observers, then publish its upload().
struct PassUp {
  TrafficEvent event;
  bool retain = false;
  /// With the topic and the payload of `event`.
  Upload upload();
};
/// The core keeps nothing of the robot: it had to make room, or an operator wants it so. A session
/// in its mesh stays.
struct RobotForgotten {
  std::string robot;
};
/// A command came for a robot that has said nothing yet but its name.
struct WantSession {
  std::string robot;
};
/// For the gateway itself, at QoS 0.
struct SubscribeAtBroker {
  std::string filter;
};
struct UnsubscribeAtBroker {
  std::string filter;
};
/// `mesh`: the one that carries the command; nothing: to each mesh.
struct DeliverToMesh {
  std::optional<Mesh> mesh;
  RobotMessage message;
};

/// The command has no outcome here: tell the operator who has sent it.
struct CommandHandedOn {
  CommandId id = CommandId::none;
};

using GatewayAction = std::variant<PassUp, FireReceipt, Upload, RobotForgotten, WantSession,
                                   SubscribeAtBroker, UnsubscribeAtBroker, DeliverToMesh,
                                   CommandOutcome, CommandHandedOn, TrafficEvent, MeshStep, Notice>;
using GatewayActions = ActionQueue<GatewayAction>;

}  // namespace slamgw
