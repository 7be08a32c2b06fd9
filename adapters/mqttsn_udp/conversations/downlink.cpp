// SPDX-License-Identifier: Apache-2.0
// Sending: the queue, and what leaves it. What clients answer is in downlink_answers.cpp.
#include "adapters/mqttsn_udp/conversations/downlink.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

using Stage = InFlight::Stage;

void Downlink::enqueue(ClientSession& session, Outgoing outgoing, TimePoint now) {
  if (is_too_large(session, outgoing, now)) return;
  const bool is_kept = !session.is_clean && outgoing.qos != Qos::at_most_once;
  if (!session.is_connected() && !is_kept)
    return refuse(outgoing, "the robot is not connected", now);
  if (outgoing.qos != Qos::at_most_once) context_.set_dirty(session);
  session.delivery.queued_octets += outgoing.octets();
  session.delivery.queue.push_back(std::move(outgoing));
  keep_in_bounds(session, now);
  pump(session, now);
  if (is_stopping_) refuse_unkept(session, now);
}

void Downlink::pump(ClientSession& session, TimePoint now) {
  Delivery& delivery = session.delivery;
  if (may_send(session) && delivery.in_flight && !delivery.in_flight->retry_at)
    resume(session, now);
  while (may_send(session) && !delivery.in_flight && !delivery.queue.empty())
    start_next(session, now);
  finish_wake(session, now);
  if (const auto next = next_time(session)) context_.clients.wake_by(session, *next);
}

/// SUBACK goes before what the subscription causes (R98), so open answers hold delivery back.
bool Downlink::may_send(const ClientSession& session) const {
  const Delivery& delivery = session.delivery;
  const bool is_open =
      session.state == ClientState::active ||
      (session.state == ClientState::awake && (delivery.wake_budget > 0 || delivery.in_flight));
  return is_open && session.answers.empty() && !delivery.is_stalled && !delivery.paused_until;
}

void Downlink::start_next(ClientSession& session, TimePoint now) {
  Delivery& delivery = session.delivery;
  Outgoing next = take(delivery, 0);
  if (session.state == ClientState::awake) --delivery.wake_budget;
  const auto id = topic_id(session, next);
  if (!id) {
    context_.tally.count(Count::queue_dropped);
    return refuse(next, "the robot has no topic id left", now);
  }
  if (next.topic_id_type != TopicIdType::normal || session.topics.is_told(*id))
    return publish(session, std::move(next), *id, now);
  delivery.in_flight = InFlight{std::move(next), Stage::registering, next_msg_id(delivery), *id};
  transmit(session, now);
}

std::optional<std::uint16_t> Downlink::topic_id(ClientSession& session, const Outgoing& outgoing) {
  const std::string& topic = outgoing.message->topic;
  switch (outgoing.topic_id_type) {
    case TopicIdType::predefined: return outgoing.predefined_id;
    case TopicIdType::short_name: return short_name_id(topic);
    case TopicIdType::normal:
    case TopicIdType::reserved: break;
  }
  return session.topics.assign(topic);
}

void Downlink::publish(ClientSession& session, Outgoing outgoing, std::uint16_t topic_id,
                       TimePoint now) {
  Delivery& delivery = session.delivery;
  const bool is_acknowledged = outgoing.qos != Qos::at_most_once;
  const std::uint16_t msg_id = is_acknowledged ? next_msg_id(delivery) : std::uint16_t{0};
  delivery.in_flight = InFlight{std::move(outgoing), Stage::published, msg_id, topic_id};
  transmit(session, now);
  if (is_acknowledged) return;
  delivery.last_qos0 = delivery.in_flight->what;
  delivery.last_qos0_id = topic_id;
  finish(session, CommandResult::sent, "", now);
}

/// What rested goes on; a PUBLISH whose id the client may have forgotten behind a REGISTER (R48).
void Downlink::resume(ClientSession& session, TimePoint now) {
  InFlight& in_flight = *session.delivery.in_flight;
  const bool needs_register = in_flight.stage == Stage::published &&
                              in_flight.what.topic_id_type == TopicIdType::normal &&
                              !session.topics.is_told(in_flight.topic_id);
  if (needs_register) {
    in_flight.stage = Stage::registering;
    in_flight.resumed_msg_id = in_flight.msg_id;
    in_flight.msg_id = next_msg_id(session.delivery);
  }
  transmit(session, now);
}

void Downlink::transmit(ClientSession& session, TimePoint now) {
  InFlight& in_flight = *session.delivery.in_flight;
  context_.send(session, packet_in_flight(session));
  if (in_flight.stage == Stage::published) in_flight.was_sent = true;
  in_flight.retry_at = now + context_.settings.retry_interval;
}

Packet Downlink::packet_in_flight(const ClientSession& session) const {
  const InFlight& in_flight = *session.delivery.in_flight;
  const BrokerMessage& message = *in_flight.what.message;
  switch (in_flight.stage) {
    case Stage::registering: return Register{in_flight.topic_id, in_flight.msg_id, message.topic};
    case Stage::released: return Pubrel{in_flight.msg_id};
    case Stage::published: break;
  }
  return Publish{in_flight.was_sent, static_cast<WireQos>(in_flight.what.qos),
                 message.retain,     in_flight.what.topic_id_type,
                 in_flight.topic_id, in_flight.msg_id,
                 message.payload};
}

/// PINGRESP comes by itself behind the last acknowledgement (R119), or at once (R120).
void Downlink::finish_wake(ClientSession& session, TimePoint now) {
  const Delivery& delivery = session.delivery;
  if (session.state != ClientState::awake || !session.answers.empty()) return;
  if (delivery.in_flight && delivery.in_flight->retry_at) return;
  context_.send(session, Pingresp{});
  session.state = ClientState::asleep;
  session.last_heard = now;
  rest(session);
}

void Downlink::wake(ClientSession& session, TimePoint now) {
  Delivery& delivery = session.delivery;
  session.state = ClientState::awake;
  delivery.wake_budget = delivery.queue.size() + context_.settings.max_sleeping_messages;
  pump(session, now);
}

void Downlink::rest(ClientSession& session) {
  Delivery& delivery = session.delivery;
  delivery.is_stalled = false;
  if (!delivery.in_flight) return;
  InFlight& in_flight = *delivery.in_flight;
  in_flight.retry_at.reset();
  in_flight.repeats = 0;
  if (in_flight.stage != Stage::registering) return;
  if (in_flight.resumed_msg_id != 0) {
    in_flight.stage = Stage::published;
    in_flight.msg_id = std::exchange(in_flight.resumed_msg_id, std::uint16_t{0});
  } else {
    push_front(delivery, std::move(delivery.in_flight->what));
    delivery.in_flight.reset();
  }
}

void Downlink::drop_all(ClientSession& session, const std::string& why, TimePoint now) {
  Delivery& delivery = session.delivery;
  if (delivery.in_flight) refuse(delivery.in_flight->what, why, now);
  delivery.in_flight.reset();
  delivery.paused_until.reset();
  delivery.is_stalled = false;
  delivery.last_qos0.reset();
  drop_if(session, why, now, [](const Outgoing&) { return true; });
}

void Downlink::drop_volatile(ClientSession& session, const std::string& why, TimePoint now) {
  drop_if(session, why, now,
          [](const Outgoing& waiting) { return waiting.qos == Qos::at_most_once; });
  keep_in_bounds(session, now);
}

/// No REGACK comes any more: what waits for one is in the queue again.
void Downlink::refuse_unkept(ClientSession& session, TimePoint now) {
  rest(session);
  drop_if(session, "the gateway ends before the robot could take it", now,
          [](const Outgoing& waiting) { return waiting.qos == Qos::at_most_once; });
}

void Downlink::drop_unwanted(ClientSession& session, TimePoint now) {
  drop_if(session, "the robot has unsubscribed", now, [&](const Outgoing& waiting) {
    return !subscriptions_.is_wanted(session, waiting.message->topic);
  });
}

template <class Predicate>
void Downlink::drop_if(ClientSession& session, const std::string& why, TimePoint now,
                       Predicate is_dropped) {
  Delivery& delivery = session.delivery;
  for (std::size_t i = 0; i < delivery.queue.size();) {
    if (is_dropped(delivery.queue[i])) {
      refuse(take(delivery, i), why, now);
    } else {
      ++i;
    }
  }
}

std::optional<TimePoint> Downlink::next_time(const ClientSession& session) const {
  const Delivery& delivery = session.delivery;
  const auto retry_at =
      delivery.in_flight ? delivery.in_flight->retry_at : std::optional<TimePoint>();
  return earlier(retry_at, delivery.paused_until);
}

/// Beyond the bound the oldest QoS 0 goes first, then the oldest (R117).
void Downlink::keep_in_bounds(ClientSession& session, TimePoint now) {
  Delivery& delivery = session.delivery;
  const bool is_listening =
      session.state == ClientState::active || session.state == ClientState::awake;
  const std::size_t max_messages =
      is_listening ? limits::max_queued_messages : context_.settings.max_sleeping_messages;
  while (delivery.queue.size() > max_messages ||
         delivery.queued_octets > limits::max_queued_octets) {
    const auto oldest_qos0 =
        std::find_if(delivery.queue.begin(), delivery.queue.end(),
                     [](const Outgoing& waiting) { return waiting.qos == Qos::at_most_once; });
    const bool has_qos0 = oldest_qos0 != delivery.queue.end();
    const auto index = has_qos0 ? oldest_qos0 - delivery.queue.begin() : 0;
    context_.tally.count(Count::queue_dropped);
    refuse(take(delivery, static_cast<std::size_t>(index)), "the robot's queue is full", now);
  }
}

bool Downlink::is_too_large(const ClientSession& session, const Outgoing& outgoing, TimePoint now) {
  const bool fits = context_.fits(session, 7 + outgoing.message->payload.size()) &&
                    context_.fits(session, 6 + outgoing.message->topic.size());
  if (fits) return false;
  context_.tally.count(Count::too_large_down);
  refuse(outgoing, "larger than the network carries", now);
  if (const auto times = too_large_.on_event(now)) {
    context_.emit(Notice{Severity::warning,
                         fmt::format("a message on '{}' for {} is larger than the network carries "
                                     "and was dropped ({} times)",
                                     outgoing.message->topic, session.robot, *times),
                         session.robot});
  }
  return true;
}

void Downlink::refuse(const Outgoing& outgoing, std::string why, TimePoint now) {
  commands_.end(outgoing.command, CommandResult::refused, std::move(why), now);
}

void Downlink::push_front(Delivery& delivery, Outgoing outgoing) {
  delivery.queued_octets += outgoing.octets();
  delivery.queue.insert(delivery.queue.begin(), std::move(outgoing));
}

Outgoing Downlink::take(Delivery& delivery, std::size_t index) {
  const auto at = delivery.queue.begin() + static_cast<std::ptrdiff_t>(index);
  Outgoing taken = std::move(*at);
  delivery.queue.erase(at);
  if (delivery.queue.empty()) delivery.queue = {};  // its memory too
  delivery.queued_octets -= taken.octets();
  return taken;
}

/// Non-zero, and never the one in flight: there is only one (R90).
std::uint16_t Downlink::next_msg_id(Delivery& delivery) {
  if (++delivery.last_msg_id == 0) ++delivery.last_msg_id;
  return delivery.last_msg_id;
}

}  // namespace slamgw::mqttsn
