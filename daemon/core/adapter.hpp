// SPDX-License-Identifier: Apache-2.0
// The border between a mesh and the core. One MeshAdapter per mesh (an I/O shell around its
// machine); one MeshListener (the application). All calls on the loop's thread; none blocks; none
// throws. Either side may call the other from inside a call: a shell that is draining its machine
// queues what comes in (MachineDriver does that).
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "daemon/core/messages.hpp"

namespace slamgw {

/// Hears what a mesh reports; never called from inside a question (presence_of, counters).
class MeshListener {
 public:
  virtual ~MeshListener() = default;
  virtual void on_mesh_event(MeshEvent event) = 0;
};

/// Carries out what the core asks of one mesh.
class MeshAdapter {
 public:
  virtual ~MeshAdapter() = default;

  /// Opens its sockets or port and keeps them open from then on, retrying by itself. Throws
  /// std::runtime_error only for what an operator must fix (an address in use).
  virtual void start() = 0;
  /// The daemon is about to end: takes no new messages where that can be avoided, but acknowledges
  /// those it has. Reports the outcome of each command that does not outlive the daemon.
  virtual void stop_listening() {}
  /// Says goodbye where the protocol has one and closes everything. No events after it returns.
  virtual void stop() = 0;

  /// The receipt of an earlier Report fires. Called once for each owed receipt.
  virtual void on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome) = 0;
  /// A message from the broker for one of this mesh's robots; one that the mesh does not know is
  /// dropped.
  virtual void on_broker_message(const RobotMessage& message) = 0;
  /// The answer to an earlier SubscribeRequest.
  virtual void on_subscribe_result(const std::string& robot, const std::string& filter,
                                   bool granted) = 0;
  /// This gateway holds the robot's session at the broker from now on.
  virtual void on_session_held(const std::string& /*robot*/) {}
  /// Another gateway serves the robot now: its service here ends at once, without a will and
  /// without a PresenceChange. Returns what has not been on the air yet; commands that were end as
  /// `timeout`.
  virtual std::vector<WaitingMessage> give_up(const std::string& /*robot*/) { return {}; }
  /// What is kept of a robot that is offline goes, as an operator asked.
  virtual void forget(const std::string& /*robot*/) {}
  /// Answers NoteRequest; empty when there is no note.
  virtual void on_note(const std::string& /*robot*/, ByteView /*note*/) {}
  /// The link to the broker came or went.
  virtual void on_broker_link(bool is_up) = 0;

  /// On while an operator watches messages: reports every MeshStep; off: only repeats.
  virtual void trace(bool is_on) = 0;

  virtual Counters counters() const = 0;
  /// Nothing where robots need no place.
  virtual std::optional<MeshPlaces> places() const { return std::nullopt; }
  /// Whether a command can reach this robot here; nothing when it is not one of this mesh's. A
  /// robot behind a link that is down is offline.
  virtual std::optional<Presence> presence_of(const std::string& robot) const = 0;
  /// Commands that wait for this robot or are on their way to it.
  virtual std::size_t queued_for(const std::string& robot) const = 0;
};

}  // namespace slamgw
