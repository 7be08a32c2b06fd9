// SPDX-License-Identifier: Apache-2.0
// A session leaves the machine as a snapshot and goes on from one: over a restart of the daemon, or
// from another gateway's note (R47; docs/topics.md, promise 7).
#pragma once

#include "adapters/mqttsn_udp/clients/session_snapshot.hpp"
#include "adapters/mqttsn_udp/conversations/connecting.hpp"
#include "adapters/mqttsn_udp/conversations/supervision.hpp"

namespace slamgw::mqttsn {

class Restoring {
 public:
  Restoring(const NameRules& rules, ClientTable& clients, Output& output,
            Subscriptions& subscriptions, CommandWatch& commands, Downlink& downlink,
            Lifecycle& lifecycle, const Connecting& connecting, Supervision& supervision)
      : rules_(rules),
        clients_(clients),
        output_(output),
        subscriptions_(subscriptions),
        commands_(commands),
        downlink_(downlink),
        lifecycle_(lifecycle),
        connecting_(connecting),
        supervision_(supervision) {}

  /// Nothing: there is no such session (any more).
  std::optional<SessionSnapshot> snapshot(const std::string& client_id, TimePoint now) const;
  /// The client goes on as if nothing had happened. False when it can't be taken (known already, no
  /// room, or its client id is now another robot's name); its commands are refused then.
  bool restore(const SessionSnapshot& snapshot, TimePoint now);

  /// Of a note from before a restart: it may have been changed by another gateway since, so only a
  /// change here is a reason for a new one.
  static constexpr std::uint64_t unknown_note_hash = 1;

 private:
  void adopt_commands(const Delivery& delivery);
  void refuse_commands(const SessionSnapshot& snapshot, TimePoint now);

  const NameRules& rules_;
  ClientTable& clients_;
  Output& output_;
  Subscriptions& subscriptions_;
  CommandWatch& commands_;
  Downlink& downlink_;
  Lifecycle& lifecycle_;
  const Connecting& connecting_;
  Supervision& supervision_;
};

}  // namespace slamgw::mqttsn
