// SPDX-License-Identifier: Apache-2.0
// The will of each client (MQTT-SN 1.2 sections 6.3, 6.4). It lives here, not at the broker: one
// shared broker connection can't carry it (R56).
#pragma once

#include <string_view>

#include "adapters/mqttsn_udp/context.hpp"

namespace slamgw::mqttsn {

class Wills {
 public:
  explicit Wills(Context& context) : context_(context) {}

  /// Whether this client may have such a will (R55).
  bool is_allowed(std::string_view client_id, std::string_view robot, const std::string& topic,
                  WireQos qos) const;
  void on_willtopicupd(ClientSession& session, const WillTopicUpd& update);
  void on_willmsgupd(ClientSession& session, WillMsgUpd update);
  /// The client is lost. The will itself stays: the next CONNECT decides about it.
  void publish(const ClientSession& session);

 private:
  Context& context_;
};

}  // namespace slamgw::mqttsn
