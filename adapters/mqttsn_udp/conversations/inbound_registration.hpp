// SPDX-License-Identifier: Apache-2.0
// REGISTER from clients (MQTT-SN 1.2 section 6.5). TopicRegistration is the other way round.
#pragma once

#include "adapters/mqttsn_udp/conversations/answers.hpp"
#include "adapters/mqttsn_udp/conversations/uplink.hpp"

namespace slamgw::mqttsn {

class InboundRegistration {
 public:
  InboundRegistration(const NameRules& rules, Output& output, Answers& answers, Uplink& uplink,
                      Refusals& refusals)
      : rules_(rules), output_(output), answers_(answers), uplink_(uplink), refusals_(refusals) {}

  void on_register(ClientSession& session, const Register& request, TimePoint now);

 private:
  bool may_listen_to(const ClientSession& session, const std::string& topic) const;
  std::string own_root(const ClientSession& session) const;
  bool makes_too_many_types(ClientSession& session, const std::string& topic, TimePoint now);

  const NameRules& rules_;
  Output& output_;
  Answers& answers_;
  Uplink& uplink_;
  Refusals& refusals_;
};

}  // namespace slamgw::mqttsn
