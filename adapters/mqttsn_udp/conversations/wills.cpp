// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/wills.hpp"

#include <fmt/format.h>

#include <utility>

namespace slamgw::mqttsn {

bool Wills::is_allowed(const std::string& client_id, const std::string& robot,
                       const std::string& topic, WireQos qos, TimePoint now) {
  if (qos == WireQos::minus_one || !is_valid_topic_name(topic)) return false;
  if (context_.policy.may_publish(client_id, robot, topic)) return true;
  context_.tally.count(Count::topics_refused);
  if (const auto times = refused_.on_event(now)) {
    context_.emit(Notice{Severity::notice,
                         fmt::format("{} may not have a will on '{}': a matching filter in "
                                     "topics.extra_publish would allow it ({} such wills)",
                                     robot, topic, *times),
                         robot});
  }
  return false;
}

void Wills::on_willtopicupd(ClientSession& session, const WillTopicUpd& update, TimePoint now) {
  ReturnCode code = ReturnCode::accepted;
  if (update.topic.empty()) {
    session.will.reset();
  } else if (!is_allowed(session.client_id, session.robot, update.topic, update.qos, now)) {
    code = ReturnCode::not_supported;
  } else {
    if (!session.will) session.will.emplace();
    session.will->topic = update.topic;
    session.will->qos = static_cast<Qos>(update.qos);
    session.will->retain = update.retain;
  }
  context_.set_dirty(session);
  context_.send(session, WillTopicResp{code});
}

void Wills::on_willmsgupd(ClientSession& session, WillMsgUpd update) {
  if (!session.will) return context_.send(session, WillMsgResp{ReturnCode::not_supported});
  session.will->message = std::move(update.message);
  context_.set_dirty(session);
  context_.send(session, WillMsgResp{ReturnCode::accepted});
}

void Wills::publish(const ClientSession& session) {
  if (!session.will) return;
  const Will& will = *session.will;
  context_.emit(Report{Mesh::thread, session.robot, will.topic, will.message, will.qos, will.retain,
                       Receipt{Mesh::thread, 0}, true});
}

}  // namespace slamgw::mqttsn
