// SPDX-License-Identifier: Apache-2.0
// The will of each client (MQTT-SN 1.2 sections 6.3, 6.4). It lives here, not at the broker: one
// shared broker connection can't carry it (R56).
#pragma once

#include <string>

#include "adapters/mqttsn_udp/context.hpp"
#include "daemon/core/burst.hpp"

namespace slamgw::mqttsn {

class Wills {
 public:
  explicit Wills(Context& context) : context_(context) {}

  /// Whether this client may have such a will (R55); a refusal is counted, and said once per burst.
  bool is_allowed(const std::string& client_id, const std::string& robot, const std::string& topic,
                  WireQos qos, TimePoint now);
  void on_willtopicupd(ClientSession& session, const WillTopicUpd& update, TimePoint now);
  void on_willmsgupd(ClientSession& session, WillMsgUpd update);
  /// The client is lost. The will itself stays: the next CONNECT decides about it.
  void publish(const ClientSession& session);

 private:
  Context& context_;
  Burst refused_;
};

}  // namespace slamgw::mqttsn
