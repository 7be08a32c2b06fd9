// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/topic_ids.hpp"

#include <vector>

namespace slamgw::mqttsn {

std::optional<std::uint16_t> assign_topic(ClientSession& session, std::string_view name) {
  if (const auto known = session.topics.id_of(name)) return known;
  const Delivery& delivery = session.delivery;
  std::vector<std::uint16_t> in_use{delivery.last_qos0_id};
  if (delivery.publishing) in_use.push_back(delivery.publishing->topic_id);
  for (const Registering& open : delivery.registering) in_use.push_back(open.topic_id);
  return session.topics.assign(name, in_use);
}

}  // namespace slamgw::mqttsn
