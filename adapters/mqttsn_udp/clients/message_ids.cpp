// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/message_ids.hpp"

#include <algorithm>

namespace slamgw::mqttsn {
namespace {

bool is_in_use(const Delivery& delivery, std::uint16_t id) {
  const auto has_id = [id](const auto& request) { return request.attempt.msg_id == id; };
  return (delivery.publishing && has_id(*delivery.publishing)) ||
         std::ranges::any_of(delivery.registering, has_id) ||
         std::ranges::any_of(delivery.releasing, has_id) ||
         std::ranges::count(delivery.abandoned, id) > 0 ||
         std::ranges::any_of(delivery.queue,
                             [id](const Outgoing& waiting) { return waiting.msg_id == id; });
}

}  // namespace

void restart_message_ids(Delivery& delivery, std::uint16_t random) {
  delivery.last_msg_id = random;
  delivery.base_msg_id = random;
}

bool is_since_restart(const Delivery& delivery, std::uint16_t msg_id) {
  const auto distance = [&](std::uint16_t id) {
    return static_cast<std::uint16_t>(id - delivery.base_msg_id);
  };
  return distance(msg_id) != 0 && distance(msg_id) <= distance(delivery.last_msg_id);
}

std::uint16_t next_message_id(Delivery& delivery) {
  do {
    ++delivery.last_msg_id;
  } while (delivery.last_msg_id == 0 || is_in_use(delivery, delivery.last_msg_id));
  return delivery.last_msg_id;
}

}  // namespace slamgw::mqttsn
