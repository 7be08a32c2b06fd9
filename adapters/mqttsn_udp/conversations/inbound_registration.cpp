// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/inbound_registration.hpp"

#include <fmt/format.h>

#include <algorithm>

#include "adapters/mqttsn_udp/conversations/own_names.hpp"
#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

/// A client may need an id for what it publishes and for what it listens to (R57, R61).
void InboundRegistration::on_register(ClientSession& session, const Register& request,
                                      TimePoint now) {
  if (!answers_.has_room(session)) return;
  const std::string topic = to_broker_name(rules_.policy.scheme(), session, request.topic_name);
  const auto answer = [&](std::uint16_t id, ReturnCode code) {
    answers_.answer(session, Regack{id, request.msg_id, code});
  };
  if (!is_valid_topic_name(topic)) return answer(0, ReturnCode::not_supported);
  if (!may_listen_to(session, topic) && !uplink_.may_publish(session, topic, now))
    return answer(0, ReturnCode::not_supported);
  if (makes_too_many_types(session, topic, now)) return answer(0, ReturnCode::not_supported);
  const auto id = session.assign_topic(topic);
  if (id) {
    session.topics.set_own(*id);
    session.topics.set_known(*id, true);
    output_.mark_changed(session);
    return answer(*id, ReturnCode::accepted);
  }
  answers_.refuse_for_room(session, Regack{0, request.msg_id, ReturnCode::congestion});
}

/// A robot registers the topics of others, and those of its commands, to listen to them; its own
/// only to publish, though it may listen to them as well.
bool InboundRegistration::may_listen_to(const ClientSession& session,
                                        const std::string& topic) const {
  return !topic.starts_with(own_root(session)) &&
         rules_.policy.may_subscribe(session.client_id, session.robot, topic);
}

std::string InboundRegistration::own_root(const ClientSession& session) const {
  return rules_.policy.scheme().robot_root() + session.robot + "/";
}

/// Each type of a robot costs all who listen to it a topic id.
bool InboundRegistration::makes_too_many_types(ClientSession& session, const std::string& topic,
                                               TimePoint now) {
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
