// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/delivery.hpp"

#include <algorithm>
#include <utility>

namespace slamgw::mqttsn {

Duration RetransmissionTimeout::first(Duration longest) const {
  return std::min(timeout_, longest);
}

Duration RetransmissionTimeout::next(Duration last, unsigned repeats, Duration longest) {
  constexpr unsigned even = 4;
  return std::min(repeats <= even ? last : last * 3 / 2, longest);
}

void RetransmissionTimeout::on_answer(Duration round_trip) {
  round_trip_.on_answer(round_trip);
  timeout_ = std::max(round_trip_.timeout(), shortest);
}

void RetransmissionTimeout::on_ambiguous_answer(Duration since_first, Duration since_last) {
  const bool answers_last_copy = round_trip_.is_known() && since_last <= round_trip_.timeout();
  if (!answers_last_copy) timeout_ = std::clamp(since_first * 3 / 2, timeout_, 2 * timeout_);
}

void Outgoing::rename(const NewName& new_name) {
  auto topic = new_name(message->topic);
  if (!topic) return;
  BrokerMessage renamed = *message;
  renamed.topic = std::move(*topic);
  message = std::make_shared<const BrokerMessage>(std::move(renamed));
}

void Delivery::rename(const NewName& new_name) {
  for (Outgoing& waiting : queue) waiting.rename(new_name);
  if (publishing) publishing->what.rename(new_name);
  if (last_qos0) last_qos0->rename(new_name);
  for (SetAside& entry : set_aside) entry.topic = new_name(entry.topic).value_or(entry.topic);
}

Outgoing take(DeliveryQueue& queue, std::size_t index) {
  const auto at = queue.begin() + static_cast<std::ptrdiff_t>(index);
  Outgoing taken = std::move(*at);
  queue.erase(at);
  if (queue.empty()) queue.shrink_to_fit();
  return taken;
}

namespace {

bool is_in_use(const Delivery& delivery, std::uint16_t id) {
  const auto has_id = [id](const auto& request) { return request.attempt.msg_id == id; };
  return (delivery.publishing && has_id(*delivery.publishing)) ||
         std::ranges::any_of(delivery.registering, has_id) ||
         std::ranges::find(delivery.releasing, id, &Attempt::msg_id) != delivery.releasing.end() ||
         std::ranges::count(delivery.abandoned, id) > 0 ||
         std::ranges::any_of(delivery.queue,
                             [id](const Outgoing& waiting) { return waiting.msg_id == id; });
}

}  // namespace

void restart_message_ids(Delivery& delivery, std::uint16_t random) {
  delivery.last_msg_id = random & highest_msg_id;
  delivery.base_msg_id = delivery.last_msg_id;
}

bool is_since_restart(const Delivery& delivery, std::uint16_t msg_id) {
  const auto distance = [&](int id) {
    return (id - delivery.base_msg_id % highest_msg_id + highest_msg_id) % highest_msg_id;
  };
  return msg_id <= highest_msg_id && distance(msg_id) != 0 &&
         distance(msg_id) <= distance(delivery.last_msg_id);
}

void skip_message_ids(Delivery& delivery) {
  constexpr int skipped = 256;  // a session is saved within half a second
  delivery.last_msg_id =
      static_cast<std::uint16_t>((delivery.last_msg_id + skipped) % highest_msg_id);
}

std::uint16_t next_message_id(Delivery& delivery) {
  do {
    delivery.last_msg_id = delivery.last_msg_id < highest_msg_id ? delivery.last_msg_id + 1 : 1;
  } while (is_in_use(delivery, delivery.last_msg_id));
  return delivery.last_msg_id;
}

}  // namespace slamgw::mqttsn
