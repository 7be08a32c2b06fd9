// SPDX-License-Identifier: Apache-2.0
// Requests of RobotSessions to its shell (the first group: calls of an MQTT client) and its reports
// to the core (the second group). Plain values.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <variant>

#include "daemon/core/messages.hpp"

namespace slamgw::sessions {

/// CONNECT with the robot's client id. Answered by on_attached() or on_attach_failed().
struct OpenSession {
  std::string robot;
  bool is_clean = false;  ///< clean start: the broker forgets the robot's former session
};
/// DISCONNECT. The connection reports nothing more. `is_forgotten`: the session ends with it.
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
/// Any request whose answer the broker sends after all its earlier messages. Answered by
/// on_fence(): then the broker has our acknowledgements of all messages from before the request,
/// and the session was still this gateway's.
struct AskFence {
  std::string robot;
  std::uint64_t number = 0;
};
/// PUBLISH to the robot's own mailbox, on its own connection: the marker comes back after all
/// messages that the broker had kept.
struct SendMarker {
  std::string robot;
  std::string text;
};

/// This gateway now serves the robot. `was_present`: the broker had a session of the robot.
struct SessionHeld {
  std::string robot;
  bool was_present = false;
};
/// `broken`: this side has ended the connection, because of an error.
enum class LossReason : std::uint8_t { taken, broker_gone, broken };
/// This gateway does not hold the session any more.
struct SessionLost {
  std::string robot;
  LossReason why = LossReason::taken;
};
/// The session was still held when prove() was called.
struct SessionProven {
  std::string robot;
};
/// The messages that waited for a robot that starts a clean session were refused; the broker now
/// forgets them.
struct SessionSorted {
  std::string robot;
};
/// The broker's answer to RobotSessions::subscribe(). A refused filter is asked for again until
/// unsubscribe().
struct FilterAnswered {
  std::string robot;
  std::string filter;
  bool is_granted = false;
};
/// A message for the robot that no other gateway has. `is_unasked`: it came only for the gateway's
/// own filter, or one that was given up, so the robot is not subscribed to its topic.
struct TakeMessage {
  std::string robot;
  BrokerMessage message;
  bool is_unasked = false;
};
/// A command that waited at the broker while no gateway held the session, or until its robot
/// started a clean session. It is refused.
struct RefuseStale {
  std::string robot;
  BrokerMessage message;
  bool has_begun_anew = false;
};

/// The retained note of the robot; empty when there is none. Answers read_note(). Nothing: the note
/// could not be read, because the session is not held.
struct NoteRead {
  std::string robot;
  std::optional<Bytes> note;
};
/// Another client repeatedly takes the session of a robot that is heard here, or no longer does.
struct SessionContested {
  std::string robot;
  bool is_contested = false;
};

using SessionAction =
    std::variant<OpenSession, CloseSession, SubscribeSession, UnsubscribeSession, AskFence,
                 SendMarker, SessionHeld, SessionLost, SessionProven, SessionSorted, FilterAnswered,
                 TakeMessage, RefuseStale, NoteRead, SessionContested, Notice>;

}  // namespace slamgw::sessions
