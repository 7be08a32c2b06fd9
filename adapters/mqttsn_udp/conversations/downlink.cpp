// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/downlink.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {
namespace {

/// Returns true if messages that were lost on their way are sent again to this client later.
bool is_kept(const ClientSession& session) {
  return !session.is_clean || session.state() == ClientState::awake;
}

std::size_t publish_octets(const Outgoing& outgoing) {
  return 7 + outgoing.message->payload.size();
}

/// Removes and returns the message that was published under this MsgId and not acknowledged yet. It
/// may have been given up and wait for its next try: its acknowledgement was late.
std::optional<Outgoing> take_unacknowledged(Delivery& delivery, std::uint16_t msg_id) {
  if (delivery.publishing && delivery.publishing->attempt.msg_id == msg_id)
    return std::exchange(delivery.publishing, nullptr)->what;
  const auto waiting = std::ranges::find(delivery.queue, msg_id, &Outgoing::msg_id);
  if (msg_id == 0 || waiting == delivery.queue.end()) return std::nullopt;
  return take(delivery.queue, static_cast<std::size_t>(waiting - delivery.queue.begin()));
}

/// Returns the message to drop when there is no room: one whose topic is set aside, else the oldest
/// of QoS 0, else the oldest that was never sent, else the oldest (R117).
std::size_t least_useful(const Delivery& delivery) {
  const auto index_of = [&](auto found) {
    return static_cast<std::size_t>(found - delivery.queue.begin());
  };
  const auto set_aside = std::ranges::find_if(delivery.queue, [&](const Outgoing& waiting) {
    return TopicRegistration::is_set_aside(delivery, waiting.message->topic);
  });
  if (set_aside != delivery.queue.end()) return index_of(set_aside);
  const auto qos0 = std::ranges::find(delivery.queue, Qos::at_most_once, &Outgoing::qos);
  if (qos0 != delivery.queue.end()) return index_of(qos0);
  const auto unsent = std::ranges::find(delivery.queue, 0, &Outgoing::msg_id);
  return unsent != delivery.queue.end() ? index_of(unsent) : 0;
}

/// Returns when the time of a command is over; nothing for other messages.
std::optional<TimePoint> expiry_of(const Outgoing& outgoing) {
  if (!outgoing.command) return std::nullopt;
  return outgoing.command->came + limits::command_patience;
}

bool is_overdue(const Outgoing& outgoing, TimePoint now) {
  return outgoing.command && *expiry_of(outgoing) <= now;
}

/// Remembers a failed QoS 2 command, so that a late PUBREC does not lead to its execution.
void remember_abandoned(Delivery& delivery, const Outgoing& outgoing) {
  if (!outgoing.command || outgoing.qos != Qos::exactly_once || outgoing.msg_id == 0) return;
  if (delivery.abandoned.size() >= limits::max_abandoned)
    delivery.abandoned.erase(delivery.abandoned.begin());
  delivery.abandoned.push_back(outgoing.msg_id);
}

/// Returns why a command was not sent before its time was over.
std::string why_unsent(const ClientSession& session, const Outgoing& waiting, bool is_held) {
  const Delivery& delivery = session.delivery;
  if (waiting.msg_id != 0 && !delivery.paused_until) return "no acknowledgement";
  if (!session.is_connected()) return "the robot is not connected";
  if (session.state() == ClientState::asleep) return "the robot sleeps and did not wake in time";
  if (delivery.paused_until) return "the robot says that it is congested";
  const auto id = session.topics.id_of(waiting.message->topic);
  const bool awaits_regack =
      id && std::ranges::find(delivery.registering, *id, &Registering::topic_id) !=
                delivery.registering.end();
  if (awaits_regack) return "the robot did not answer the registration of this topic";
  if (delivery.is_stalled) return "the robot does not answer";
  if (is_held) return "the robot's address has not shown that it receives";
  return "earlier messages for the robot took too long";
}

}  // namespace

/// A kept session gets messages without a matching subscription, too. The robot may have come from
/// another gateway whose note is lost; then the broker knows its subscriptions better.
void Downlink::on_broker_message(ClientSession& session, const RobotMessage& incoming,
                                 TimePoint now) {
  const BrokerMessage& message = incoming.message;
  const Subscription* wanted = Subscriptions::best_match(session, message.topic);
  const bool is_asked_elsewhere =
      !session.is_clean &&
      rules_.policy.may_subscribe(session.client_id, session.robot, message.topic);
  if (incoming.is_unasked || (!wanted && !is_asked_elsewhere))
    return refuse_command(message, incoming.command,
                          wanted ? "the robot had not subscribed then, or has moved since it came"
                                 : "the robot has not subscribed to " + message.topic);
  Outgoing outgoing;
  outgoing.message = std::make_shared<const BrokerMessage>(message);
  outgoing.qos = message.qos;
  if (wanted) {
    outgoing.qos = std::min(message.qos, wanted->qos);
    outgoing.topic_id_type = wanted->topic_id_type;
    outgoing.predefined_id = wanted->topic_id;
  }
  outgoing.command = begin_command(session, message, incoming.command, now);
  enqueue(session, std::move(outgoing), now);
}

void Downlink::enqueue(ClientSession& session, Outgoing outgoing, TimePoint now) {
  if (is_too_large(session, outgoing, now)) return;
  const bool outlives_connection = !session.is_clean && outgoing.qos != Qos::at_most_once;
  if (!session.is_connected() && !outlives_connection)
    return refuse(session, outgoing, "the robot is not connected", now);
  const bool is_unanswered =
      TopicRegistration::is_set_aside(session.delivery, outgoing.message->topic);
  if (is_unanswered && (outgoing.command || !outlives_connection)) {
    output_.count(Count::queue_dropped);
    return refuse(session, outgoing, "the robot does not answer messages on this topic", now);
  }
  if (outgoing.qos != Qos::at_most_once) output_.mark_unsaved(session);
  session.delivery.queue.push_back(std::move(outgoing));
  keep_in_bounds(session, now);
}

void Downlink::pump(ClientSession& session, TimePoint now) {
  expire_commands(session, now);
  if (may_send(session) && !session.delivery.is_stalled) {
    resume_releases(session, now);
    resume_withheld(session, now);
  }
  while (may_send(session) && send_next(session, now)) {
  }
  if (is_stopping_) refuse_unkept(session, now);
}

/// SUBACK comes before the messages of its subscription (R98), so open answers hold delivery back.
bool Downlink::may_send(const ClientSession& session) const {
  const Delivery& delivery = session.delivery;
  const bool is_listening = session.state() == ClientState::active ||
                            (session.state() == ClientState::awake && delivery.wake_budget > 0);
  return is_listening && session.answers.empty() && !delivery.paused_until;
}

/// Publishes the first message that is ready. A command waits for an earlier command whose topic is
/// being registered; no other message waits for another's registration. After one wait, an open
/// PUBLISH yields to commands on other topics; to all messages on them if its topic failed before.
bool Downlink::send_next(ClientSession& session, TimePoint now) {
  Delivery& delivery = session.delivery;
  const auto is_fresh = [](const Attempt& each) { return each.repeat_at && each.is_fresh(); };
  const Publishing* open = delivery.publishing.get();
  const bool must_wait = open && (open->what.command || open->attempt.is_fresh());
  if (must_wait || std::ranges::any_of(delivery.releasing, is_fresh)) return false;
  const std::string open_topic = open ? open->what.message->topic : "";
  const bool is_for_commands =
      delivery.is_stalled || (open && !TopicRegistration::has_failed(delivery, open_topic));
  bool must_commands_wait = false;
  bool is_held = false;
  for (std::size_t i = 0; i < delivery.queue.size(); ++i) {
    const bool is_command = delivery.queue[i].command != nullptr;
    must_commands_wait |= is_command && delivery.is_stalled && delivery.queue[i].msg_id != 0;
    if (is_command ? must_commands_wait : is_for_commands) continue;
    if (open && delivery.queue[i].message->topic == open_topic) continue;
    switch (registration_.prepare(session, delivery.queue[i], now)) {
      case TopicRegistration::Readiness::ready:
        if (!is_within_allowance(session, delivery.queue[i])) {
          is_held = true;
          break;
        }
        publish(session, take(delivery.queue, i), now);
        return true;
      case TopicRegistration::Readiness::impossible:
        output_.count(Count::queue_dropped);
        refuse(session, take(delivery.queue, i), "the robot has no topic id left", now);
        return true;
      case TopicRegistration::Readiness::waits_shortly: must_commands_wait |= is_command; break;
      case TopicRegistration::Readiness::waits: break;
      case TopicRegistration::Readiness::is_held: is_held = true; break;
    }
  }
  if (is_held && !is_awaiting(session)) registration_.probe(session, now);
  return false;
}

/// Repeats withheld requests: the datagram that just came may pay for them, or for a probe.
void Downlink::resume_withheld(ClientSession& session, TimePoint now) {
  Delivery& delivery = session.delivery;
  registration_.resume_withheld(session);
  if (!delivery.publishing || !delivery.publishing->attempt.is_withheld) return;
  repeat(session, *delivery.publishing);
  const bool is_withheld = delivery.publishing->attempt.is_withheld;
  if (is_withheld && delivery.registering.empty()) registration_.probe(session, now);
}

void Downlink::repeat(ClientSession& session, Publishing& open) {
  open.attempt.is_withheld = !output_.may_send(session, publish_octets(open.what));
  if (open.attempt.is_withheld) return output_.count(Count::unvalidated);
  output_.count(Count::retransmitted);
  transmit(session, open.what, open.topic_id, open.attempt.msg_id);
}

/// Returns true if the allowance of an address that is not validated lets this message leave. QoS 1
/// and 2 may use it up, because they ask for an answer. QoS 0 leaves enough for a REGISTER. While a
/// REGISTER is unanswered, QoS 0 waits unless the client has pinged with its id.
bool Downlink::is_within_allowance(const ClientSession& session, const Outgoing& outgoing) const {
  if (output_.is_validated(session)) return true;
  std::size_t octets = publish_octets(outgoing);
  if (outgoing.qos == Qos::at_most_once) {
    const auto is_unanswered = [](const auto& open) { return !open.attempt.is_fresh(); };
    const bool is_half_proven = session.delivery.is_half_proven;
    if (!is_half_proven && std::ranges::any_of(session.delivery.registering, is_unanswered))
      return false;
    octets += registration_.probe_octets() + AddressValidation::max_header_octets;
  }
  return output_.may_send(session, octets);
}

void Downlink::publish(ClientSession& session, Outgoing outgoing, TimePoint now) {
  Delivery& delivery = session.delivery;
  if (delivery.publishing && outgoing.qos != Qos::at_most_once) {
    const TimePoint begun = delivery.publishing->attempt.begun;
    Outgoing yielding = std::exchange(delivery.publishing, nullptr)->what;
    const std::string& topic = yielding.message->topic;
    if (++yielding.yields > limits::max_yields || TopicRegistration::has_failed(delivery, topic))
      registration_.set_aside(session, topic, begun, now);
    delivery.queue.insert(delivery.queue.begin(), std::move(yielding));
  }
  if (session.state() == ClientState::awake) --delivery.wake_budget;
  const std::uint16_t topic_id = TopicRegistration::topic_id(session, outgoing).value_or(0);
  if (outgoing.qos == Qos::at_most_once) {
    transmit(session, outgoing, topic_id, 0);
    finish(session, outgoing, CommandResult::sent, "", now);
    delivery.last_qos0_id = topic_id;
    delivery.last_qos0 = std::make_unique<Outgoing>(std::move(outgoing));
    return;
  }
  const std::uint16_t msg_id = outgoing.msg_id != 0 ? outgoing.msg_id : next_message_id(delivery);
  transmit(session, outgoing, topic_id, msg_id);
  outgoing.msg_id = msg_id;
  delivery.publishing = std::make_unique<Publishing>(
      Publishing{std::move(outgoing), topic_id, begin_attempt(settings_, delivery, msg_id, now)});
}

/// Sends the PUBLISH, with DUP if it was sent before, unless the client refuses DUP.
void Downlink::transmit(ClientSession& session, const Outgoing& outgoing, std::uint16_t topic_id,
                        std::uint16_t msg_id) {
  const bool is_dup = outgoing.msg_id != 0 && !session.delivery.refuses_dup;
  output_.send(session,
               Publish{is_dup, static_cast<WireQos>(outgoing.qos), outgoing.message->retain,
                       outgoing.topic_id_type, topic_id, msg_id, outgoing.message->payload});
  if (!output_.is_traced) return;
  const bool has_id = outgoing.qos != Qos::at_most_once;
  output_.emit(
      MessageStep{.kind = StepKind::sent,
                  .mesh = Mesh::thread,
                  .robot = session.robot,
                  .topic = outgoing.message->topic,
                  .qos = outgoing.qos,
                  .wire = {has_id ? std::optional(msg_id) : std::nullopt, outgoing.msg_id != 0},
                  .bytes = outgoing.message->payload.size(),
                  .command = outgoing.command ? outgoing.command->id : CommandId::none});
}

void Downlink::on_address(ClientSession& session) {
  session.delivery.is_half_proven = false;
  // A session that began at another gateway must not repeat the MsgIds of that gateway: the robot
  // would take a new message for a repeat.
  const bool is_new = session.delivery.last_msg_id == 0;
  if (random_ && (is_new || !output_.is_validated(session)))
    restart_message_ids(session.delivery, random_());
}

/// Validates the client's address, if the answer fits an open request (`is_asked`) whose MsgId was
/// sent to this address only. Any other answer may be a guess, and counts as wrong.
void Downlink::on_answer(ClientSession& session, std::uint16_t msg_id, bool is_asked,
                         TimePoint now) {
  if (!session.peer) return;
  const bool is_right = is_asked && is_since_restart(session.delivery, msg_id);
  output_.validation.on_answer(session.peer->endpoint.address, is_right, now);
  if (is_right && output_.is_validated(session)) clients_.set_answered(session);
}

void Downlink::learn_from_answer(ClientSession& session, std::uint16_t msg_id, TimePoint now) {
  const auto& open = session.delivery.publishing;
  const bool is_asked = open && open->attempt.msg_id == msg_id;
  if (is_asked) on_answered(session.delivery, open->attempt, now);
  if (msg_id != 0) on_answer(session, msg_id, is_asked, now);  // 0: it is about QoS 0
}

void Downlink::on_regack(ClientSession& session, const Regack& regack, TimePoint now) {
  const auto& registering = session.delivery.registering;
  const auto open = std::ranges::find_if(
      registering, [&](const Registering& asked) { return asked.attempt.msg_id == regack.msg_id; });
  const bool is_open = open != registering.end();
  const bool may_lack_topic_id = regack.topic_id == 0 && regack.code != ReturnCode::accepted;
  const bool is_asked = is_open && (open->topic_id == regack.topic_id || may_lack_topic_id);
  on_answer(session, regack.msg_id, is_asked, now);
  if (!is_open) return;  // R68
  const auto topic = registration_.on_regack(session, regack, now);
  if (topic) output_.mark_changed(session);
  switch (regack.code) {
    case ReturnCode::accepted: return;
    case ReturnCode::congestion: return pause(session, now);
    case ReturnCode::invalid_topic_id:
    case ReturnCode::not_supported: break;
  }
  if (!topic) return;
  drop_if(session, "the robot refused the topic", now, [&](const Outgoing& waiting) {
    return waiting.topic_id_type == TopicIdType::normal && waiting.message->topic == *topic;
  });
  subscriptions_.drop(session, *topic);  // only an exact filter has this name (R67)
}

void Downlink::on_puback(ClientSession& session, const Puback& puback, TimePoint now) {
  Delivery& delivery = session.delivery;
  // Some clients mean "invalid topic id" and say "not supported", with topic id 0.
  const bool is_unknown_id = puback.code == ReturnCode::invalid_topic_id ||
                             (puback.code == ReturnCode::not_supported && puback.topic_id == 0);
  const bool is_qos0 = puback.msg_id == 0 && is_unknown_id && delivery.last_qos0 &&
                       (delivery.last_qos0_id == puback.topic_id || puback.topic_id == 0);
  if (is_qos0) return register_again(session, *std::exchange(delivery.last_qos0, nullptr));
  learn_from_answer(session, puback.msg_id, now);
  if (puback.code == ReturnCode::congestion) {
    if (delivery.publishing && delivery.publishing->attempt.msg_id == puback.msg_id)
      pause(session, now);
    return;
  }
  const bool was_repeated = delivery.publishing && delivery.publishing->attempt.repeats > 0;
  auto answered = take_unacknowledged(delivery, puback.msg_id);
  if (!answered) return;                    // R92
  if (puback.code == ReturnCode::accepted)  // also of QoS 2 (R89)
    return finish(session, *answered, CommandResult::delivered, "", now);
  if (answered->was_refused_once)
    return finish(session, *answered, CommandResult::refused, "the robot refused it", now);
  if (is_unknown_id && answered->topic_id_type == TopicIdType::normal)
    return register_again(session, std::move(*answered));
  if (puback.code == ReturnCode::not_supported && was_repeated && !delivery.refuses_dup) {
    delivery.refuses_dup = true;
    answered->was_refused_once = true;
    delivery.queue.insert(delivery.queue.begin(), std::move(*answered));
    return;
  }
  finish(session, *answered, CommandResult::refused, "the robot refused it", now);
}

/// PUBREC means that the client has taken over the message. PUBREL is repeated until PUBCOMP; one
/// that stays unanswered holds nothing back (MQTT-SN 1.2 section 6.6).
void Downlink::on_pubrec(ClientSession& session, const Pubrec& pubrec, TimePoint now) {
  Delivery& delivery = session.delivery;
  learn_from_answer(session, pubrec.msg_id, now);
  if (std::ranges::count(delivery.abandoned, pubrec.msg_id) > 0) return;
  const auto open = std::ranges::find(delivery.releasing, pubrec.msg_id, &Attempt::msg_id);
  if (open != delivery.releasing.end()) {
    open->repeats = std::max(open->repeats, 1U);
    return output_.send(session, Pubrel{pubrec.msg_id});
  }
  const auto received = take_unacknowledged(delivery, pubrec.msg_id);
  if (!received) return output_.send(session, Pubrel{pubrec.msg_id});  // R92
  finish(session, *received, CommandResult::delivered, "", now);
  if (delivery.releasing.size() >= limits::max_open_releases)
    delivery.releasing.erase(delivery.releasing.begin());
  delivery.releasing.push_back(begin_attempt(settings_, delivery, pubrec.msg_id, now));
  output_.mark_unsaved(session);
  output_.send(session, Pubrel{pubrec.msg_id});
}

void Downlink::on_pubcomp(ClientSession& session, const Pubcomp& pubcomp, TimePoint now) {
  std::vector<Attempt>& releasing = session.delivery.releasing;
  const auto open = std::ranges::find(releasing, pubcomp.msg_id, &Attempt::msg_id);
  if (open == releasing.end()) return;
  on_answered(session.delivery, *open, now);
  releasing.erase(open);
  output_.mark_unsaved(session);
}

/// Sends the resting PUBRELs, once the client was heard since their last transmission.
void Downlink::resume_releases(ClientSession& session, TimePoint now) {
  Delivery& delivery = session.delivery;
  for (Attempt& open : delivery.releasing) {
    if (open.repeat_at || session.last_heard <= open.begun) continue;
    open = begin_attempt(settings_, delivery, open.msg_id, now);
    output_.send(session, Pubrel{open.msg_id});
  }
}

/// Repeats PUBRELs that are due. One that is given up rests if the client sent nothing at all since
/// it began; then this returns true. Otherwise it is forgotten, and only a PUBREC brings it back
/// (R92).
bool Downlink::repeat_releases(ClientSession& session, TimePoint now) {
  bool is_silent = false;
  const auto is_over = [&](Attempt& open) {
    switch (check_attempt(settings_, open, now)) {
      case Due::nothing: return false;
      case Due::repeat:
        output_.count(Count::retransmitted);
        output_.send(session, Pubrel{open.msg_id});
        return false;
      case Due::give_up: break;
    }
    open.repeat_at.reset();
    const bool was_heard = session.last_heard > open.begun;
    is_silent |= !was_heard;
    return was_heard;
  };
  if (std::erase_if(session.delivery.releasing, is_over) > 0) output_.mark_unsaved(session);
  return is_silent;
}

void Downlink::finish(ClientSession& session, const Outgoing& outgoing, CommandResult result,
                      std::string why, TimePoint now) {
  if (result == CommandResult::delivered || result == CommandResult::sent)
    output_.count(Count::delivered_down);
  if (result == CommandResult::delivered)
    TopicRegistration::on_delivered(session.delivery, outgoing.message->topic);
  if (outgoing.qos != Qos::at_most_once) output_.mark_unsaved(session);
  end_command(outgoing.command, result, std::move(why), now);
}

/// Registers a topic id again that the client has forgotten, and sends the message once more under
/// a new MsgId (R86). A client that forgets ids while it sleeps forgets all of them each time.
void Downlink::register_again(ClientSession& session, Outgoing outgoing) {
  if (outgoing.topic_id_type != TopicIdType::normal || outgoing.was_refused_once) return;
  if (session.state() == ClientState::awake || session.state() == ClientState::asleep) {
    session.delivery.forgets_ids_asleep = true;
    session.topics.forget_known();
  } else if (const auto id = session.topics.id_of(outgoing.message->topic)) {
    session.topics.find(*id)->is_known = false;
  }
  outgoing.was_refused_once = true;
  outgoing.msg_id = 0;
  session.delivery.queue.insert(session.delivery.queue.begin(), std::move(outgoing));
}

/// Leaves a client that said "congestion" alone for T_WAIT; then its messages are sent again.
void Downlink::pause(ClientSession& session, TimePoint now) {
  session.delivery.paused_until = now + limits::t_wait;
  rest(session);
}

void Downlink::on_heard(ClientSession& session) {
  session.delivery.is_stalled = false;
  TopicRegistration::on_heard(session.delivery);
}

void Downlink::on_reconnect(ClientSession& session) {
  rest(session);
  session.delivery.paused_until.reset();
  session.delivery.set_aside.clear();
}

void Downlink::rest(ClientSession& session) {
  Delivery& delivery = session.delivery;
  delivery.is_stalled = false;
  delivery.registering.clear();
  for (Attempt& open : delivery.releasing) {
    open.repeat_at.reset();
    open.begun = TimePoint::min();
  }
  if (delivery.publishing)
    delivery.queue.insert(delivery.queue.begin(),
                          std::exchange(delivery.publishing, nullptr)->what);
}

bool Downlink::is_awaiting(const ClientSession& session) const {
  const Delivery& delivery = session.delivery;
  return delivery.publishing || !delivery.registering.empty() ||
         std::ranges::any_of(delivery.releasing,
                             [](const Attempt& open) { return open.repeat_at.has_value(); });
}

bool Downlink::on_time(ClientSession& session, TimePoint now) {
  Delivery& delivery = session.delivery;
  expire_commands(session, now);
  if (delivery.paused_until && *delivery.paused_until <= now) delivery.paused_until.reset();
  bool is_silent = repeat_releases(session, now);
  for (const auto& unanswered : registration_.on_time(session, now)) {
    is_silent |= !unanswered.was_heard;
    drop_unregistered(session, unanswered.topic, now);
  }
  if (!delivery.publishing) return is_silent;
  Publishing& open = *delivery.publishing;
  switch (check_attempt(settings_, open.attempt, now)) {
    case Due::nothing: break;
    case Due::repeat: repeat(session, open); break;
    case Due::give_up: is_silent |= give_up(session, now); break;
  }
  return is_silent;
}

/// Gives up the open PUBLISH. A client that sent nothing at all gets commands only until it is
/// heard (R133). One that sleeps asks with its next PINGREQ (R124).
bool Downlink::give_up(ClientSession& session, TimePoint now) {
  output_.count(Count::deliveries_given_up);
  const Publishing open = *std::exchange(session.delivery.publishing, nullptr);
  const bool was_heard = session.last_heard > open.attempt.begun;
  session.delivery.is_stalled = !was_heard;
  if (is_kept(session)) {
    session.delivery.queue.insert(session.delivery.queue.begin(), open.what);  // R69, R124
    const bool is_sleeper = session.state() == ClientState::awake;
    if (was_heard || !(open.what.command || is_sleeper))
      registration_.set_aside(session, open.what.message->topic, open.attempt.begun, now);
  } else {
    remember_abandoned(session.delivery, open.what);
    finish(session, open.what, CommandResult::timeout, "no acknowledgement", now);
  }
  return !was_heard;
}

/// Drops messages on a topic whose REGISTER stays unanswered, except those of QoS 1 and 2 for
/// clients whose messages are kept.
void Downlink::drop_unregistered(ClientSession& session, const std::string& topic, TimePoint now) {
  output_.count(Count::deliveries_given_up);
  drop_if(session, "the robot did not answer the registration of this topic", now,
          [&](const Outgoing& waiting) {
            const bool is_lasting = is_kept(session) && waiting.qos != Qos::at_most_once;
            return waiting.message->topic == topic && !is_lasting;
          });
}

void Downlink::drop_all(ClientSession& session, const std::string& why, TimePoint now) {
  rest(session);
  drop_if(session, why, now, [](const Outgoing&) { return true; });
  Delivery& delivery = session.delivery;
  delivery.releasing.clear();
  delivery.set_aside.clear();
  delivery.paused_until.reset();
  delivery.last_qos0.reset();
}

void Downlink::drop_volatile(ClientSession& session, const std::string& why, TimePoint now) {
  drop_if(session, why, now,
          [](const Outgoing& waiting) { return waiting.qos == Qos::at_most_once; });
  keep_in_bounds(session, now);
}

/// No REGACK comes any more, so messages that wait for a REGACK are refused, too.
void Downlink::refuse_unkept(ClientSession& session, TimePoint now) {
  rest(session);
  drop_if(session, stopped, now,
          [](const Outgoing& waiting) { return waiting.qos == Qos::at_most_once; });
}

void Downlink::drop_unwanted(ClientSession& session, const std::string& filter, TimePoint now) {
  drop_if(session, "the robot has unsubscribed", now, [&](const Outgoing& waiting) {
    const std::string& topic = waiting.message->topic;
    return filter_matches(filter, topic) && !Subscriptions::best_match(session, topic);
  });
}

std::vector<WaitingMessage> Downlink::take_unsent(ClientSession& session, TimePoint now) {
  std::vector<WaitingMessage> unsent;
  rest(session);
  for (const Outgoing& next : std::exchange(session.delivery.queue, {})) {
    if (next.command && next.command->is_reported) continue;  // sent at QoS 0, see register_again()
    const bool is_from_before = next.command && next.command->id == CommandId::none;
    if (next.msg_id != 0 || is_from_before) {  // an earlier process may have sent it
      end_command(next.command, CommandResult::timeout, "the robot moved to another gateway", now);
      continue;
    }
    WaitingMessage& waiting = unsent.emplace_back(WaitingMessage{*next.message});
    if (!next.command) continue;
    waiting.command = next.command->id;
    waiting.message.waited = std::chrono::duration_cast<Waited>(now - next.command->came);
    next.command->is_reported = true;  // by the other gateway
  }
  return unsent;
}

template <class Predicate>
void Downlink::drop_if(ClientSession& session, const std::string& why, TimePoint now,
                       Predicate is_dropped) {
  DeliveryQueue& queue = session.delivery.queue;
  std::erase_if(queue, [&](const Outgoing& waiting) {
    if (!is_dropped(waiting)) return false;
    refuse(session, waiting, why, now);
    return true;
  });
  if (queue.empty()) queue.shrink_to_fit();
}

/// A command of QoS 0 that was sent and waits for another registration is withdrawn, too.
void Downlink::expire_commands(ClientSession& session, TimePoint now) {
  Delivery& delivery = session.delivery;
  if (delivery.publishing && is_overdue(delivery.publishing->what, now)) {
    const auto open = std::exchange(delivery.publishing, nullptr);
    time_out(session, open->what, "no acknowledgement", now);
  }
  const bool is_held = !output_.is_validated(session);
  std::erase_if(delivery.queue, [&](const Outgoing& waiting) {
    if (!is_overdue(waiting, now)) return false;
    time_out(session, waiting, why_unsent(session, waiting, is_held), now);
    return true;
  });
  if (delivery.queue.empty()) delivery.queue.shrink_to_fit();
}

void Downlink::time_out(ClientSession& session, const Outgoing& outgoing, std::string why,
                        TimePoint now) {
  remember_abandoned(session.delivery, outgoing);
  output_.mark_unsaved(session);
  end_command(outgoing.command, CommandResult::timeout, std::move(why), now);
}

std::optional<TimePoint> Downlink::next_time(const ClientSession& session) const {
  const Delivery& delivery = session.delivery;
  std::optional<TimePoint> next =
      earlier(delivery.paused_until, TopicRegistration::next_time(delivery));
  for (const Attempt& open : delivery.releasing) next = earlier(next, open.repeat_at);
  if (const Publishing* open = delivery.publishing.get())
    next = earlier(next, earlier(open->attempt.repeat_at, expiry_of(open->what)));
  for (const Outgoing& waiting : delivery.queue) next = earlier(next, expiry_of(waiting));
  return next;
}

void Downlink::keep_in_bounds(ClientSession& session, TimePoint now) {
  const Delivery& delivery = session.delivery;
  const bool is_listening =
      session.state() == ClientState::active || session.state() == ClientState::awake;
  std::size_t max_messages =
      is_listening ? limits::max_queued_messages : settings_.max_sleeping_messages;
  const bool is_held = session.is_clean && !output_.is_validated(session);
  if (is_held) max_messages = std::min(max_messages, limits::max_queued_unvalidated);
  const auto octets = [&] {
    std::size_t sum = 0;
    for (const Outgoing& waiting : delivery.queue) sum += waiting.octets();
    return sum;
  };
  while (delivery.queue.size() > max_messages || octets() > limits::max_queued_octets) {
    output_.count(Count::queue_dropped);
    refuse(session, take(session.delivery.queue, least_useful(delivery)),
           "the robot's queue is full", now);
  }
}

bool Downlink::is_too_large(ClientSession& session, const Outgoing& outgoing, TimePoint now) {
  const bool fits = output_.fits(session, publish_octets(outgoing)) &&
                    (!TopicRegistration::is_needed(session, outgoing) ||
                     output_.fits(session, 6 + outgoing.message->topic.size()));
  if (fits) return false;
  output_.count(Count::too_large_down);
  refuse(session, outgoing, "larger than the network carries", now);
  if (const auto times = too_large_.on_event(now)) {
    output_.emit(Notice{Severity::warning,
                        fmt::format("a message on '{}' for {} is larger than the network carries "
                                    "and was dropped ({} times)",
                                    outgoing.message->topic, session.robot, *times),
                        session.robot});
  }
  return true;
}

/// A robot may have obeyed a message that was sent and not acknowledged: `timeout`, not `refused`.
void Downlink::refuse(ClientSession& session, const Outgoing& outgoing, std::string why,
                      TimePoint now) {
  remember_abandoned(session.delivery, outgoing);
  if (outgoing.command) output_.mark_unsaved(session);  // the outcome is not reported again
  const bool was_sent = outgoing.msg_id != 0;
  end_command(outgoing.command, was_sent ? CommandResult::timeout : CommandResult::refused,
              std::move(why), now);
}

void Downlink::refuse_command(const BrokerMessage& message, CommandId id, std::string why) {
  const auto parsed = rules_.policy.scheme().parse_command_topic(message.topic);
  if (!parsed || id == CommandId::none) return;
  output_.emit(CommandOutcome{Mesh::thread, id, std::string(parsed->robot),
                              std::string(parsed->type), CommandResult::refused, message.waited,
                              std::move(why)});
}

/// Returns null when `message` is not a command for this client's robot.
std::shared_ptr<Command> Downlink::begin_command(const ClientSession& session,
                                                 const BrokerMessage& message, CommandId id,
                                                 TimePoint now) const {
  const auto parsed = rules_.policy.scheme().parse_command_topic(message.topic);
  if (id == CommandId::none || !parsed || parsed->robot != session.robot) return nullptr;
  return std::make_shared<Command>(Command{id, std::string(parsed->robot),
                                           std::string(parsed->type), now - message.waited, false});
}

void Downlink::end_command(const std::shared_ptr<Command>& command, CommandResult result,
                           std::string why, TimePoint now) {
  if (!command || std::exchange(command->is_reported, true)) return;
  const auto after = std::chrono::duration_cast<std::chrono::milliseconds>(now - command->came);
  output_.emit(CommandOutcome{Mesh::thread, command->id, command->robot, command->type, result,
                              after, std::move(why)});
}

}  // namespace slamgw::mqttsn
