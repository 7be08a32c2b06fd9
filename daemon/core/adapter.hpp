// SPDX-License-Identifier: Apache-2.0
// The border between a mesh and the core. One MeshAdapter per mesh (an I/O shell around its
// machine); one MeshListener (the application). All calls on the loop's thread; none blocks; none
// throws. Either side may call the other from inside a call: a shell that is draining its machine
// queues what comes in (MachineDriver does that).
#pragma once

#include <string>

#include "daemon/core/messages.hpp"

namespace slamgw {

/// Told by adapters what their mesh says.
class MeshListener {
 public:
  virtual ~MeshListener() = default;
  virtual void on_mesh_event(MeshEvent event) = 0;
};

/// Told by the core what its mesh should do.
class MeshAdapter {
 public:
  virtual ~MeshAdapter() = default;

  /// Opens its sockets or port and keeps them open from then on, retrying by itself. Throws
  /// std::runtime_error only for what an operator must mend (an address in use).
  virtual void start() = 0;
  /// The daemon is about to end: hears nothing new where it can be avoided, but still acknowledges
  /// what it has heard. The outcome of each command that does not outlive the daemon is told now.
  virtual void stop_listening() {}
  /// Orderly end: says goodbye where the protocol has one, closes everything. No events after it
  /// returns.
  virtual void stop() = 0;

  /// The receipt of an earlier Report fires. Called once for each owed receipt.
  virtual void on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome) = 0;
  /// A message that matches one of this mesh's subscriptions. `command` comes back in the
  /// CommandOutcome when the message is a command for a robot of this mesh.
  virtual void on_broker_message(const BrokerMessage& message, CommandId command) = 0;
  /// The broker's answer to an earlier SubscribeRequest, or the core's when it already holds that
  /// subscription.
  virtual void on_subscribe_result(const std::string& filter, bool granted) = 0;
  /// The link to the broker came or went.
  virtual void on_broker_link(bool is_up) = 0;

  virtual Counters counters() const = 0;
  /// Commands that wait for this robot or are on their way to it, as far as the mesh knows.
  virtual std::size_t queued_for(const std::string&) const { return 0; }
};

}  // namespace slamgw
