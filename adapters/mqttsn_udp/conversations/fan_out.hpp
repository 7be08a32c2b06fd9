// SPDX-License-Identifier: Apache-2.0
// From one broker message to the clients that get it: each once, at its highest matching QoS
// (R87, R103), retained ones only to those that wait for them (R102).
#pragma once

#include "adapters/mqttsn_udp/conversations/downlink.hpp"

namespace slamgw::mqttsn {

class FanOut {
 public:
  FanOut(Subscriptions& subscriptions, Downlink& downlink, CommandWatch& commands)
      : subscriptions_(subscriptions), downlink_(downlink), commands_(commands) {}

  void on_broker_message(const BrokerMessage& message, CommandId command, TimePoint now);

 private:
  Subscriptions& subscriptions_;
  Downlink& downlink_;
  CommandWatch& commands_;
};

}  // namespace slamgw::mqttsn
