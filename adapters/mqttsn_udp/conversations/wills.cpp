// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/wills.hpp"

#include <fmt/format.h>

#include <utility>

#include "adapters/mqttsn_udp/conversations/own_names.hpp"

namespace slamgw::mqttsn {

std::optional<std::string> Wills::allowed_topic(const std::string& client_id,
                                                const std::string& robot, const std::string& topic,
                                                WireQos qos, TimePoint now) {
  std::string name = replace_robot(rules_.policy.scheme(), topic, client_id, robot).value_or(topic);
  const bool is_will = qos != WireQos::minus_one && is_valid_topic_name(name);
  if (is_will && rules_.policy.may_publish(client_id, robot, name)) return name;
  refusals_.on_refusal(
      Count::wills_refused, client_id,
      is_will ? fmt::format("{} may not have a will on '{}': a matching filter in "
                            "topics.extra_publish would allow it",
                            robot, topic)
              : fmt::format("{} may not have a will on '{}': the name is invalid, or the QoS is -1",
                            robot, topic),
      robot, now);
  return std::nullopt;
}

void Wills::on_willtopicupd(ClientSession& session, const WillTopicUpd& update, TimePoint now) {
  ReturnCode code = ReturnCode::accepted;
  if (update.topic.empty()) {
    session.will.reset();
  } else if (auto topic =
                 allowed_topic(session.client_id, session.robot, update.topic, update.qos, now)) {
    if (!session.will) session.will = std::make_unique<Will>();
    session.will->topic = std::move(*topic);
    session.will->qos = static_cast<Qos>(update.qos);
    session.will->retain = update.retain;
  } else {
    code = ReturnCode::not_supported;
  }
  output_.mark_changed(session);
  output_.send(session, WillTopicResp{code});
}

void Wills::on_willmsgupd(ClientSession& session, WillMsgUpd update) {
  if (!session.will) return output_.send(session, WillMsgResp{ReturnCode::not_supported});
  session.will->message = std::move(update.message);
  output_.mark_changed(session);
  output_.send(session, WillMsgResp{ReturnCode::accepted});
}

void Wills::publish(const ClientSession& session) {
  if (!session.will) return;
  const Will& will = *session.will;
  output_.emit(Report{.mesh = Mesh::thread,
                      .robot = session.robot,
                      .topic = will.topic,
                      .payload = will.message,
                      .qos = will.qos,
                      .retain = will.retain,
                      .receipt = no_receipt,
                      .is_will = true,
                      .is_proven = session.has_answered});
}

}  // namespace slamgw::mqttsn
