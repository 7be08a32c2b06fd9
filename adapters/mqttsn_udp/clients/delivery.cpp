// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/delivery.hpp"

#include <utility>

namespace slamgw::mqttsn {

void Outgoing::rename(const NewName& new_name) {
  auto topic = new_name(message->topic);
  if (!topic) return;
  BrokerMessage renamed = *message;
  renamed.topic = std::move(*topic);
  message = std::make_shared<const BrokerMessage>(std::move(renamed));
}

void Delivery::rename(const NewName& new_name) {
  queue.rename(new_name);
  if (publishing) publishing->what.rename(new_name);
  if (last_qos0) last_qos0->rename(new_name);
  for (SetAside& entry : set_aside) entry.topic = new_name(entry.topic).value_or(entry.topic);
}

void DeliveryQueue::rename(const NewName& new_name) {
  octets_ = 0;
  for (Outgoing& outgoing : waiting_) {
    outgoing.rename(new_name);
    octets_ += outgoing.octets();
  }
}

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
