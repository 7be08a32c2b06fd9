// SPDX-License-Identifier: Apache-2.0
// The actions that the core leaves for the application. Gateway, Commands and PresencePublisher
// leave them in one queue, so their order is the order in which things happened. Pure values.
#pragma once

#include <optional>
#include <string>
#include <variant>

#include "daemon/core/messages.hpp"
#include "daemon/core/protocol_machine.hpp"
#include "daemon/core/traffic_event.hpp"

namespace slamgw {

/// Publish `message` through the outbox, which fires the receipt.
struct Upload {
  BrokerMessage message;
  Receipt receipt;
};
/// A robot's message: show it to the observers, then publish its upload().
struct PassUp {
  TrafficEvent event;
  bool retain = false;
  /// Moves the topic and the payload out of `event`.
  Upload upload();
};
/// The core has forgotten the robot, to make room or because an operator asked. The robot's session
/// in its mesh stays.
struct RobotForgotten {
  std::string robot;
};
/// Open this robot's session at the broker: a command came for it, but the robot has only shown its
/// name so far.
struct WantSession {
  std::string robot;
};
/// Subscribe for the gateway itself, at QoS 0.
struct SubscribeAtBroker {
  std::string filter;
};
struct UnsubscribeAtBroker {
  std::string filter;
};
/// `mesh`: the mesh that carries the command; nothing: every mesh gets the message.
struct DeliverToMesh {
  std::optional<Mesh> mesh;
  RobotMessage message;
};

/// Tell the sender, who has asked for it, how the command has ended here.
struct AnswerAsker {
  Sender asker;
  CommandOutcome outcome;
};

/// CommandOutcome as an action: show it to the observers.
using GatewayAction = std::variant<PassUp, FireReceipt, Upload, RobotForgotten, WantSession,
                                   SubscribeAtBroker, UnsubscribeAtBroker, DeliverToMesh,
                                   CommandOutcome, AnswerAsker, TrafficEvent, MessageStep, Notice>;
using GatewayActions = ActionQueue<GatewayAction>;

}  // namespace slamgw
