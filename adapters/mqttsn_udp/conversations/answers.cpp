// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/answers.hpp"

#include <algorithm>
#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

bool Answers::has_room(const ClientSession& session) const {
  return session.answers.size() < limits::max_pending_answers;
}

void Answers::answer(ClientSession& session, Packet packet) {
  if (session.answers.empty()) return output_.send(session, packet);
  session.answers.push_back({std::move(packet), 0, {}});
}

void Answers::refuse_for_room(ClientSession& session, Packet congestion) {
  if (!settings_.is_full_silent()) answer(session, std::move(congestion));
}

void Answers::hold(ClientSession& session, const std::string& filter, const Suback& suback) {
  session.answers.push_back({suback, suback.msg_id, filter});
}

bool Answers::is_held(const ClientSession& session, std::uint16_t msg_id) const {
  return std::ranges::any_of(session.answers, [&](const PendingAnswer& answer) {
    return !answer.filter.empty() && answer.msg_id == msg_id;
  });
}

void Answers::release(ClientSession& session, const std::string& filter, bool granted) {
  for (PendingAnswer& answer : session.answers) {
    if (answer.filter != filter) continue;
    answer.filter.clear();
    if (!granted)
      answer.packet = Suback{WireQos::zero, 0, answer.msg_id, ReturnCode::not_supported};
  }
  while (!session.answers.empty() && session.answers.front().filter.empty()) {
    output_.send(session, std::move(session.answers.front().packet));
    session.answers.erase(session.answers.begin());
  }
  if (session.answers.empty()) session.answers = {};  // its memory too
}

}  // namespace slamgw::mqttsn
