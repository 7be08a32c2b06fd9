// SPDX-License-Identifier: Apache-2.0
// From one broker message to the clients that get it: each once, at its highest matching QoS
// (R87, R103), retained ones only to those that wait for them (R102).
#pragma once

#include <utility>
#include <vector>

#include "adapters/mqttsn_udp/conversations/command_watch.hpp"
#include "adapters/mqttsn_udp/conversations/subscriptions.hpp"

namespace slamgw::mqttsn {

class FanOut {
 public:
  FanOut(Subscriptions& subscriptions, CommandWatch& commands)
      : subscriptions_(subscriptions), commands_(commands) {}

  struct Recipient {
    ClientSession* session = nullptr;
    Outgoing outgoing;
  };
  /// In the order of the clients' first CONNECT.
  std::vector<Recipient> on_broker_message(const BrokerMessage& message, CommandId command,
                                           TimePoint now);

 private:
  Subscriptions& subscriptions_;
  CommandWatch& commands_;
};

}  // namespace slamgw::mqttsn
