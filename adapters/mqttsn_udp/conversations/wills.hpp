// SPDX-License-Identifier: Apache-2.0
// The will of each client (MQTT-SN 1.2 sections 6.3, 6.4). It lives here, not at the broker,
// where each takeover of the robot's session would publish or cancel it (R56).
#pragma once

#include <string>

#include "adapters/mqttsn_udp/conversations/conversation.hpp"

namespace slamgw::mqttsn {

class Wills : Conversation {
 public:
  explicit Wills(const Conversation& common) : Conversation(common) {}

  /// Returns the will's topic as the broker knows it. Returns nothing if this client may not have
  /// such a will (R55), which is counted and logged.
  std::optional<std::string> allowed_topic(const std::string& client_id, const std::string& robot,
                                           const std::string& topic, WireQos qos, TimePoint now);
  void on_willtopicupd(ClientSession& session, const WillTopicUpd& update, TimePoint now);
  void on_willmsgupd(ClientSession& session, WillMsgUpd update);
  /// Publishes the will of a lost client. The will itself stays: the next CONNECT decides about it.
  void publish(const ClientSession& session);
};

}  // namespace slamgw::mqttsn
