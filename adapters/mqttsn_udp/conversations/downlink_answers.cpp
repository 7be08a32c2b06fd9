// SPDX-License-Identifier: Apache-2.0
// What clients answer to REGISTER, PUBLISH and PUBREL, and what happens when they do not.
#include <utility>

#include "adapters/mqttsn_udp/conversations/downlink.hpp"
#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

using Stage = InFlight::Stage;

namespace {

bool is_open(const Delivery& delivery, Stage stage, std::uint16_t msg_id) {
  return delivery.in_flight && delivery.in_flight->stage == stage &&
         delivery.in_flight->msg_id == msg_id;
}

}  // namespace

void Downlink::on_regack(ClientSession& session, const Regack& regack, TimePoint now) {
  Delivery& delivery = session.delivery;
  if (!is_open(delivery, Stage::registering, regack.msg_id)) return;  // R68
  if (regack.code == ReturnCode::congestion) return pause(session, now);
  InFlight& in_flight = *delivery.in_flight;
  const std::uint16_t topic_id = in_flight.topic_id;
  const bool is_told = regack.code == ReturnCode::accepted;
  if (is_told) {
    session.topics.set_told(topic_id, true);
    context_.set_dirty(session);
  }
  if (is_told && in_flight.resumed_msg_id != 0) {
    rest(session);  // the PUBLISH again, under its old id
    return transmit(session, now);
  }
  Outgoing what = std::move(in_flight.what);
  delivery.in_flight.reset();
  if (is_told) {
    return publish(session, std::move(what), topic_id, now);
  }
  const std::string topic = what.message->topic;
  refuse(what, "the robot refused the topic", now);
  subscriptions_.drop(session, topic);  // only an exact one has this name (R67)
}

void Downlink::on_puback(ClientSession& session, const Puback& puback, TimePoint now) {
  Delivery& delivery = session.delivery;
  const bool is_qos0 = puback.msg_id == 0 && puback.code == ReturnCode::invalid_topic_id &&
                       delivery.last_qos0 && delivery.last_qos0_id == puback.topic_id;
  if (is_qos0) {
    Outgoing again = *std::exchange(delivery.last_qos0, std::nullopt);
    return register_again(session, std::move(again), puback.topic_id);
  }
  if (!is_open(delivery, Stage::published, puback.msg_id)) return;  // R92
  switch (puback.code) {
    case ReturnCode::accepted: return finish(session, CommandResult::delivered, "", now);  // R89
    case ReturnCode::congestion: return pause(session, now);
    case ReturnCode::invalid_topic_id: {
      const std::uint16_t topic_id = delivery.in_flight->topic_id;
      const Outgoing& what = delivery.in_flight->what;
      const bool can_register = what.topic_id_type == TopicIdType::normal && !what.was_refused_once;
      if (!can_register) break;
      Outgoing again = std::move(delivery.in_flight->what);
      delivery.in_flight.reset();
      return register_again(session, std::move(again), topic_id);
    }
    case ReturnCode::not_supported: break;
  }
  finish(session, CommandResult::refused, "the robot refused it", now);
}

void Downlink::on_pubrec(ClientSession& session, const Pubrec& pubrec, TimePoint now) {
  Delivery& delivery = session.delivery;
  const bool is_ours = (is_open(delivery, Stage::published, pubrec.msg_id) &&
                        delivery.in_flight->what.qos == Qos::exactly_once) ||
                       is_open(delivery, Stage::released, pubrec.msg_id);
  if (!is_ours) return context_.send(session, Pubrel{pubrec.msg_id});  // R92
  delivery.in_flight->stage = Stage::released;
  delivery.in_flight->repeats = 0;
  context_.set_dirty(session);
  transmit(session, now);
}

void Downlink::on_pubcomp(ClientSession& session, const Pubcomp& pubcomp, TimePoint now) {
  if (is_open(session.delivery, Stage::released, pubcomp.msg_id))
    finish(session, CommandResult::delivered, "", now);
}

void Downlink::on_heard(ClientSession& session) {
  Delivery& delivery = session.delivery;
  if (!std::exchange(delivery.is_stalled, false)) return;
  if (delivery.in_flight) delivery.in_flight->repeats = 0;
}

void Downlink::on_time(ClientSession& session, TimePoint now) {
  Delivery& delivery = session.delivery;
  if (delivery.paused_until && *delivery.paused_until <= now) delivery.paused_until.reset();
  if (delivery.in_flight && delivery.in_flight->retry_at && *delivery.in_flight->retry_at <= now) {
    if (delivery.in_flight->repeats >= context_.settings.retry_count) {
      give_up(session, now);
    } else {
      ++delivery.in_flight->repeats;
      context_.tally.count(Count::retransmitted);
      transmit(session, now);
    }
  }
  pump(session, now);
}

void Downlink::finish(ClientSession& session, CommandResult result, std::string why,
                      TimePoint now) {
  Delivery& delivery = session.delivery;
  if (result == CommandResult::delivered) context_.tally.count(Count::delivered_down);
  if (delivery.in_flight->what.qos != Qos::at_most_once) context_.set_dirty(session);
  commands_.end(delivery.in_flight->what.command, result, std::move(why), now);
  delivery.in_flight.reset();
}

/// "Invalid topic id": the client has forgotten it; told again, said again once (R86).
void Downlink::register_again(ClientSession& session, Outgoing outgoing, std::uint16_t topic_id) {
  session.topics.set_told(topic_id, false);
  if (outgoing.topic_id_type != TopicIdType::normal || outgoing.was_refused_once) return;
  outgoing.was_refused_once = true;
  push_front(session.delivery, std::move(outgoing));
}

/// "Congestion": this client is left alone for T_WAIT, then gets it again.
void Downlink::pause(ClientSession& session, TimePoint now) {
  session.delivery.paused_until = now + limits::t_wait;
  rest(session);
}

void Downlink::give_up(ClientSession& session, TimePoint now) {
  context_.tally.count(Count::deliveries_given_up);
  const bool is_awake = session.state == ClientState::awake;
  if (!is_awake && session.is_clean) {
    finish(session, CommandResult::timeout, "no acknowledgement", now);
  } else {
    rest(session);  // kept for later (R69, R124)
  }
  if (is_awake) {
    session.state = ClientState::asleep;
    session.last_heard = now;
  } else {
    session.delivery.is_stalled = true;
  }
}

}  // namespace slamgw::mqttsn
