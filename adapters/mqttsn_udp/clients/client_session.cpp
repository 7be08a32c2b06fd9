// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/client_session.hpp"

namespace slamgw::mqttsn {

std::optional<std::uint16_t> ClientSession::assign_topic(std::string_view name) {
  if (const auto known = topics.id_of(name)) return known;
  std::vector<std::uint16_t> in_use{delivery.last_qos0_id};
  if (delivery.publishing) in_use.push_back(delivery.publishing->topic_id);
  for (const Registering& open : delivery.registering) in_use.push_back(open.topic_id);
  return topics.assign(name, in_use);
}

}  // namespace slamgw::mqttsn
