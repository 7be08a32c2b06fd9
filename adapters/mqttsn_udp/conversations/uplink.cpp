// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/uplink.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "adapters/mqttsn_udp/conversations/own_names.hpp"
#include "adapters/mqttsn_udp/limits.hpp"
#include "daemon/core/spare_buffers.hpp"

namespace slamgw::mqttsn {

namespace {

WireFacts wire_facts(const Publish& publish) {
  const bool has_id = publish.qos == WireQos::one || publish.qos == WireQos::two;
  return {has_id ? std::optional(publish.msg_id) : std::nullopt, publish.dup};
}

Qos qos_of(const Publish& publish) {
  return publish.qos == WireQos::minus_one ? Qos::at_most_once : static_cast<Qos>(publish.qos);
}

std::string_view reason_of(ReturnCode code) {
  switch (code) {
    case ReturnCode::accepted: break;
    case ReturnCode::congestion: return "too many of its messages wait for the broker";
    case ReturnCode::invalid_topic_id: return "its topic id is not registered";
    case ReturnCode::not_supported: return "it may not publish to this topic";
  }
  return {};
}

}  // namespace

void Uplink::on_publish(ClientSession& session, Publish publish, TimePoint now) {
  Result<std::string, ReturnCode> topic = topic_of(session, publish, now);
  if (!topic) return refuse(session, publish, topic.error());
  switch (publish.qos) {
    case WireQos::zero:
    case WireQos::minus_one:
      return report(session, std::move(publish), std::move(*topic), no_receipt);
    case WireQos::one:
    case WireQos::two:
      return publish_with_receipt(session, std::move(publish), std::move(*topic), now);
  }
}

/// A PUBREL is always answered: the client must be able to end its exchange (R75). A copy of the
/// PUBLISH that the network delivers after it is still known for a while if the client counts its
/// MsgIds (R137).
void Uplink::on_pubrel(ClientSession& session, const Pubrel& pubrel, TimePoint now) {
  if (session.repeats.on_pubrel(pubrel.msg_id, now)) output_.mark_unsaved(session);
  output_.send(session, Pubcomp{pubrel.msg_id});
}

void Uplink::on_unconnected_publish(const Peer& peer, const ClientSession* session, Publish publish,
                                    TimePoint now) {
  const std::string client_id = session ? session->client_id : std::string();
  std::string topic =
      rules_.topic_of(client_id, publish.topic_id_type, publish.topic_id).value_or("");
  const TopicScheme& scheme = rules_.policy.scheme();
  if (session)
    topic = replace_robot(scheme, topic, client_id, session->robot).value_or(std::move(topic));
  const auto parsed = scheme.parse_robot_topic(topic);
  std::string robot = session ? session->robot : std::string(parsed ? parsed->robot : "");
  const bool is_allowed =
      settings_.allow_unconnected_publish && is_valid_topic_name(topic) &&
      (session || robot.empty() || rules_.robot_at(peer, rules_.client_of(robot)) == robot) &&
      rules_.policy.may_publish(client_id, robot, topic);
  if (!is_allowed) {
    const std::string who = session ? robot : to_string(peer);
    const char* remedy = settings_.allow_unconnected_publish
                             ? "its topic is unknown or another robot's, or "
                               "topics.extra_publish does not allow it"
                             : "mqttsn.allow_unconnected_publish is false";
    return refusals_.on_refusal(
        Count::unconnected_refused, who,
        fmt::format("a message of QoS -1 from {} is refused: {}", who, remedy), {}, now);
  }
  output_.count(Count::published_up);
  output_.emit(Report{.mesh = Mesh::thread,
                      .robot = std::move(robot),
                      .topic = std::move(topic),
                      .payload = std::move(publish.payload),
                      .qos = Qos::at_most_once,
                      .retain = publish.retain,
                      .receipt = no_receipt,
                      .address = session ? "" : to_string(peer),
                      .is_proven = session && session->has_answered});
}

void Uplink::on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome, TimePoint now) {
  const auto found = open_.find(receipt_id);
  if (found == open_.end()) return;
  const auto session = found->second.lock();
  open_.erase(found);
  if (!session) return;
  --session->open_receipts;
  switch (outcome) {
    case ReceiptOutcome::safe: return on_safe(*session, receipt_id, now);
    case ReceiptOutcome::refused: return on_refused(*session, receipt_id);
  }
}

/// Returns the name behind the client's topic id, as the client knows it; empty if there is none.
/// Marks a registered topic as one that the client publishes to.
std::string Uplink::name_of(ClientSession& session, const Publish& publish) const {
  if (publish.topic_id_type != TopicIdType::normal)
    return rules_.topic_of(session.client_id, publish.topic_id_type, publish.topic_id).value_or("");
  TopicTable::Topic* const known = session.topics.find(publish.topic_id);
  if (!known) return {};
  if (!std::exchange(known->is_own, true)) output_.mark_changed(session);
  return SpareBuffers<std::string>::copy(known->name);
}

Result<std::string, ReturnCode> Uplink::topic_of(ClientSession& session, const Publish& publish,
                                                 TimePoint now) {
  if (publish.topic_id_type == TopicIdType::reserved) return ReturnCode::not_supported;
  std::string topic = name_of(session, publish);
  if (topic.empty()) {
    refuse_topic_id(session, publish, now);
    return ReturnCode::invalid_topic_id;
  }
  topic = to_broker_name(rules_.policy.scheme(), session, std::move(topic));
  if (!is_valid_topic_name(topic)) return ReturnCode::not_supported;
  if (!may_publish(session, topic, now)) return ReturnCode::not_supported;
  return topic;
}

void Uplink::refuse_topic_id(const ClientSession& session, const Publish& publish, TimePoint now) {
  const bool is_predefined = publish.topic_id_type == TopicIdType::predefined;
  refusals_.on_refusal(
      Count::unknown_topic_ids, fmt::format("id {} {}", publish.topic_id, session.client_id),
      fmt::format("a message of {} is refused: {} {} {}", session.robot,
                  is_predefined ? "predefined topic id" : "topic id", publish.topic_id,
                  is_predefined ? "is not in mqttsn.predefined_topics" : "is not registered"),
      session.robot, now);
}

void Uplink::publish_with_receipt(ClientSession& session, Publish publish, std::string topic,
                                  TimePoint now) {
  const bool is_qos2 = publish.qos == WireQos::two;
  const std::uint64_t mark = fingerprint(publish);
  if (const auto* known = session.repeats.find(publish, mark, now)) {
    report_repeat(session, publish, std::move(topic));
    if (known->receipt_id == 0) acknowledge(session, *known, is_qos2);
    return;
  }
  if (session.open_receipts >= limits::max_open_receipts)
    return refuse(session, publish, ReturnCode::congestion);
  const bool did_count = session.repeats.counts_ids();
  open_[++last_receipt_] = clients_.weak(session);
  ++session.open_receipts;
  session.repeats.add(
      {mark, now, last_receipt_, publish.topic_id, publish.msg_id, 0, /*awaits_pubrel=*/is_qos2});
  if (is_qos2 || session.repeats.counts_ids() != did_count) output_.mark_unsaved(session);
  report(session, std::move(publish), std::move(topic), {Mesh::thread, last_receipt_});
}

void Uplink::acknowledge(const ClientSession& session, const RepeatFilter::Entry& message,
                         bool is_qos2) {
  if (is_qos2) return output_.send(session, Pubrec{message.msg_id});
  output_.send(session, Puback{message.topic_id, message.msg_id, ReturnCode::accepted});
}

void Uplink::report(const ClientSession& session, Publish publish, std::string topic,
                    Receipt receipt) {
  output_.count(Count::published_up);
  output_.emit(Report{.mesh = Mesh::thread,
                      .robot = session.robot,
                      .topic = std::move(topic),
                      .payload = std::move(publish.payload),
                      .qos = qos_of(publish),
                      .retain = publish.retain,
                      .receipt = receipt,
                      .wire = wire_facts(publish),
                      .is_proven = session.has_answered});
}

void Uplink::report_repeat(const ClientSession& session, const Publish& publish,
                           std::string topic) {
  output_.count(Count::repeats_suppressed);
  output_.emit(MessageStep{.kind = StepKind::repeat,
                           .mesh = Mesh::thread,
                           .robot = session.robot,
                           .topic = std::move(topic),
                           .qos = qos_of(publish),
                           .wire = wire_facts(publish),
                           .bytes = publish.payload.size()});
}

void Uplink::on_safe(ClientSession& session, std::uint64_t receipt_id, TimePoint now) {
  const RepeatFilter::Entry* const message = session.repeats.on_safe(receipt_id, now);
  if (!message) return;
  const bool sends_seldom = session.repeats.entries().size() <= limits::max_repeats_saved_at_once;
  if (message->awaits_pubrel || sends_seldom) output_.mark_unsaved(session);
  if (!session.is_connected()) return;
  acknowledge(session, *message, message->awaits_pubrel);
  if (!output_.is_traced) return;
  output_.emit(MessageStep{.kind = StepKind::acknowledged,
                           .mesh = Mesh::thread,
                           .robot = session.robot,
                           .receipt = {Mesh::thread, receipt_id}});
}

/// Leaves the message unacknowledged, so that the robot keeps it. Its repetition is a new message.
void Uplink::on_refused(ClientSession& session, std::uint64_t receipt_id) {
  output_.count(Count::receipts_refused);
  const auto message = session.repeats.on_refused(receipt_id);
  if (message && !settings_.is_full_silent() && session.is_connected())
    output_.send(session, Puback{message->topic_id, message->msg_id, ReturnCode::congestion});
  if (!output_.is_traced) return;
  output_.emit(MessageStep{.kind = StepKind::refused,
                           .mesh = Mesh::thread,
                           .robot = session.robot,
                           .receipt = {Mesh::thread, receipt_id},
                           .why = "the gateway has no room for it; the robot keeps it"});
}

void Uplink::refuse(ClientSession& session, const Publish& publish, ReturnCode code) {
  if (code == ReturnCode::congestion) output_.count(Count::receipts_refused);
  if (output_.is_traced) {
    output_.emit(MessageStep{
        .kind = StepKind::refused,
        .mesh = Mesh::thread,
        .robot = session.robot,
        .topic = to_broker_name(rules_.policy.scheme(), session, name_of(session, publish)),
        .qos = qos_of(publish),
        .wire = wire_facts(publish),
        .bytes = publish.payload.size(),
        .why = std::string(reason_of(code))});
  }
  if (code == ReturnCode::congestion && settings_.is_full_silent()) return;
  output_.send(session, Puback{publish.topic_id, publish.msg_id, code});
}

bool Uplink::may_publish(ClientSession& session, const std::string& topic, TimePoint now) {
  if (rules_.policy.may_publish(session.client_id, session.robot, topic)) return true;
  refusals_.on_refusal(Count::topics_refused, "publish " + session.client_id,
                       fmt::format("{} may not publish to '{}': a matching filter in "
                                   "topics.extra_publish would allow it",
                                   session.robot, topic),
                       session.robot, now);
  return false;
}

/// A client may need an id for what it publishes and for what it listens to (R57, R61).
void Uplink::on_register(ClientSession& session, const Register& request, TimePoint now) {
  if (!answers_.has_room(session)) return;
  const std::string topic = to_broker_name(rules_.policy.scheme(), session, request.topic_name);
  const auto answer = [&](std::uint16_t id, ReturnCode code) {
    answers_.answer(session, Regack{id, request.msg_id, code});
  };
  if (!is_valid_topic_name(topic)) return answer(0, ReturnCode::not_supported);
  if (!may_listen_to(session, topic) && !may_publish(session, topic, now))
    return answer(0, ReturnCode::not_supported);
  if (makes_too_many_types(session, topic, now)) return answer(0, ReturnCode::not_supported);
  const auto id = session.assign_topic(topic);
  if (id) {
    TopicTable::Topic& own = *session.topics.find(*id);
    own.is_own = own.is_known = true;
    output_.mark_changed(session);
    return answer(*id, ReturnCode::accepted);
  }
  refusals_.on_full_tables(session, topic, now);
  answers_.refuse_for_room(session, Regack{0, request.msg_id, ReturnCode::congestion});
}

/// Returns true if the robot registers the topic in order to listen: topics of others, and those of
/// its commands. Its own topics are for publishing, though it may listen to them as well.
bool Uplink::may_listen_to(const ClientSession& session, const std::string& topic) const {
  return !topic.starts_with(own_root(session)) &&
         rules_.policy.may_subscribe(session.client_id, session.robot, topic);
}

std::string Uplink::own_root(const ClientSession& session) const {
  return rules_.policy.scheme().robot_root() + session.robot + "/";
}

/// Each type of a robot costs a topic id of each client that listens to the robot.
bool Uplink::makes_too_many_types(ClientSession& session, const std::string& topic, TimePoint now) {
  const std::string own = own_root(session);
  if (!topic.starts_with(own) || session.topics.id_of(topic)) return false;
  const auto types = std::ranges::count_if(
      session.topics.topics(),
      [&](const TopicTable::Topic& known) { return known.is_own && known.name.starts_with(own); });
  if (static_cast<std::size_t>(types) < limits::max_types_per_robot) return false;
  refusals_.on_refusal(
      Count::topics_refused, "types " + session.client_id,
      fmt::format("{} may not make more than {} types of messages: '{}' is refused", session.robot,
                  limits::max_types_per_robot, topic),
      session.robot, now);
  return true;
}

}  // namespace slamgw::mqttsn
