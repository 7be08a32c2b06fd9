// SPDX-License-Identifier: Apache-2.0
// What RobotSessions asks of its shell (the first group: calls of an MQTT client) and what it
// reports to the core (the second). Plain values.
#pragma once

#include <cstdint>
#include <string>
#include <variant>

#include "daemon/core/messages.hpp"

namespace slamgw::sessions {

/// CONNECT with the robot's client id. Answered by on_attached() or on_attach_failed().
struct OpenSession {
  std::string robot;
  bool is_clean = false;  ///< clean start: the broker forgets what it had of the robot
};
/// DISCONNECT. Nothing more comes of this connection. `is_forgotten`: the session ends with it.
struct CloseSession {
  std::string robot;
  bool is_forgotten = false;
};
/// SUBSCRIBE on the robot's connection. Answered by on_subscribed().
struct SubscribeSession {
  std::string robot;
  std::string filter;
  Qos qos = Qos::at_most_once;
  std::uint32_t id = 0;  ///< comes back with each message for this filter (MQTT 5)
  bool wants_retained = true;
};
struct UnsubscribeSession {
  std::string robot;
  std::string filter;
};
/// Any request whose answer the broker sends behind everything that it sent before. Answered by
/// on_fence(): then the broker has our acknowledgement of all that came before the request, and the
/// session was still ours.
struct AskFence {
  std::string robot;
  std::uint64_t number = 0;
};
/// PUBLISH to the robot's own mailbox, on its own connection: it comes back behind all that the
/// broker had kept.
struct SendMarker {
  std::string robot;
  std::string text;
};

/// The robot is this gateway's to serve. `was_present`: the broker had a session of it.
struct SessionHeld {
  std::string robot;
  bool was_present = false;
};
enum class LossReason : std::uint8_t { taken, broker_gone, let_go };
/// It is not any more: its service here ends now.
struct SessionLost {
  std::string robot;
  LossReason why = LossReason::taken;
};
/// The broker's answer to RobotSessions::subscribe().
struct FilterAnswered {
  std::string robot;
  std::string filter;
  bool is_granted = false;
};
/// A message for the robot that this gateway alone has. `is_unasked`: only the gateway's own filter
/// brought it, so the robot has not subscribed to it.
struct TakeMessage {
  std::string robot;
  BrokerMessage message;
  bool is_unasked = false;
};
/// A command that waited at the broker while no gateway held the session, or until its robot began
/// anew: refused, not obeyed.
struct RefuseStale {
  std::string robot;
  BrokerMessage message;
  bool has_begun_anew = false;
};

/// The retained note of the robot; empty when there is none. Answers read_note().
struct NoteRead {
  std::string robot;
  Bytes note;
};
/// Another client takes the session again and again while the robot talks here, or no longer.
struct SessionContested {
  std::string robot;
  bool is_contested = false;
};

using SessionAction = std::variant<OpenSession, CloseSession, SubscribeSession, UnsubscribeSession,
                                   AskFence, SendMarker, SessionHeld, SessionLost, FilterAnswered,
                                   TakeMessage, RefuseStale, NoteRead, SessionContested, Notice>;

}  // namespace slamgw::sessions
