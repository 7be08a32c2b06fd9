// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/delivery.hpp"

#include <utility>

namespace slamgw::mqttsn {

void DeliveryQueue::push_back(Outgoing outgoing) {
  octets_ += outgoing.octets();
  waiting_.push_back(std::move(outgoing));
}

void DeliveryQueue::push_front(Outgoing outgoing) {
  octets_ += outgoing.octets();
  waiting_.insert(waiting_.begin(), std::move(outgoing));
}

Outgoing DeliveryQueue::take(std::size_t index) {
  const auto at = waiting_.begin() + static_cast<std::ptrdiff_t>(index);
  Outgoing taken = std::move(*at);
  waiting_.erase(at);
  if (waiting_.empty()) waiting_ = {};  // its memory too
  octets_ -= taken.octets();
  return taken;
}

}  // namespace slamgw::mqttsn
