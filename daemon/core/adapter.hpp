// SPDX-License-Identifier: Apache-2.0
// The border between a mesh and the core: one MeshAdapter per mesh (an I/O shell around its
// machine), one MeshListener (the application). All calls are made on the loop's thread; no call
// blocks, and only start() throws. Either side may call the other from inside a call: a shell that
// is draining its machine queues new inputs (MachineDriver does that).
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "daemon/core/messages.hpp"

namespace slamgw {

/// Receives the events of a mesh. Never called from inside a query (presence_of, counters).
class MeshListener {
 public:
  virtual ~MeshListener() = default;
  virtual void on_mesh_event(MeshEvent event) = 0;
};

/// Carries out the core's requests to one mesh.
class MeshAdapter {
 public:
  virtual ~MeshAdapter() = default;

  /// Opens the mesh's sockets or port and keeps them open from then on, retrying by itself. Throws
  /// std::runtime_error only for a problem that an operator must fix (an address in use).
  virtual void start() = 0;
  /// Prepares for the daemon's end: takes no new messages where that can be avoided, but
  /// acknowledges those that it has. Reports the outcome of each command that does not outlive the
  /// daemon.
  virtual void stop_listening() {}
  /// Returns true if stop() interrupts nothing that cannot be repeated. Asked after
  /// stop_listening().
  virtual bool is_settled() const { return true; }
  /// Sends the protocol's goodbye, if it has one, and closes everything. Reports no events after
  /// that.
  virtual void stop() = 0;

  /// The receipt of an earlier Report has fired. Called once for each owed receipt.
  virtual void on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome) = 0;
  /// Takes a message from the broker for one of this mesh's robots; drops it if the mesh does not
  /// know the robot.
  virtual void on_broker_message(const RobotMessage& message) = 0;
  /// The answer to an earlier SubscribeRequest.
  virtual void on_subscribe_result(const std::string& robot, const std::string& filter,
                                   bool granted) = 0;
  /// This gateway holds the robot's session at the broker from now on.
  virtual void on_session_held(const std::string& /*robot*/) {}
  /// Ends the robot's service here at once, without a will and without a PresenceChange, because
  /// another gateway serves the robot now. Returns the messages that have not been on the air yet;
  /// commands that have been on the air end as `timeout`.
  virtual std::vector<WaitingMessage> give_up(const std::string& /*robot*/) { return {}; }
  /// Deletes everything kept of a robot that is offline, as an operator asked.
  virtual void forget(const std::string& /*robot*/) {}
  /// Answers a NoteRequest. `note` is empty when there is none; nothing: it cannot be read before
  /// on_session_held().
  virtual void on_note(const std::string& /*robot*/, std::optional<ByteView> /*note*/) {}
  /// The link to the broker came up or went down.
  virtual void on_broker_link(bool is_up) = 0;

  /// On: reports every MessageStep, because an operator watches messages. Off: reports only
  /// repeats.
  virtual void trace(bool is_on) = 0;

  virtual Counters counters() const = 0;
  /// Returns nothing for a mesh whose robots need no place.
  virtual std::optional<MeshPlaces> places() const { return std::nullopt; }
  /// Returns whether a command can reach this robot here; nothing for a robot of another mesh. A
  /// robot behind a link that is down is offline.
  virtual std::optional<Presence> presence_of(const std::string& robot) const = 0;
  /// Returns how many commands wait for this robot or are on their way to it.
  virtual std::size_t queued_for(const std::string& robot) const = 0;
};

}  // namespace slamgw
