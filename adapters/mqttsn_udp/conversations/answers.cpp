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
  session.answers.push_back({0, 0, std::move(packet)});
}

void Answers::refuse_for_room(ClientSession& session, Packet congestion) {
  if (!settings_.is_full_silent()) answer(session, std::move(congestion));
}

std::uint64_t Answers::hold(ClientSession& session, std::uint16_t msg_id) {
  session.answers.push_back({++last_ticket_, msg_id, std::nullopt});
  return last_ticket_;
}

bool Answers::is_held(const ClientSession& session, std::uint16_t msg_id) const {
  return std::any_of(
      session.answers.begin(), session.answers.end(),
      [&](const PendingAnswer& held) { return held.ticket != 0 && held.msg_id == msg_id; });
}

void Answers::release(ClientSession& session, std::uint64_t ticket, Packet packet) {
  const auto held =
      std::find_if(session.answers.begin(), session.answers.end(),
                   [&](const PendingAnswer& answer) { return answer.ticket == ticket; });
  if (held != session.answers.end()) held->packet = std::move(packet);
  while (!session.answers.empty() && session.answers.front().packet) {
    output_.send(session, *session.answers.front().packet);
    session.answers.erase(session.answers.begin());
  }
  if (session.answers.empty()) session.answers = {};  // its memory too
}

}  // namespace slamgw::mqttsn
