// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/sleep.hpp"

namespace slamgw::mqttsn {

void Sleep::fall_asleep(ClientSession& session, std::chrono::seconds duration, TimePoint now) {
  session.sleep_duration = duration;
  if (session.delivery.forgets_ids_asleep) session.topics.forget_known();
  downlink_.rest(session);
  lifecycle_.enter(session, ClientState::asleep, now);
  output_.mark_changed(session);
}

void Sleep::wake(ClientSession& session, TimePoint now) {
  if (session.state() != ClientState::asleep) return;
  lifecycle_.enter(session, ClientState::awake, now);
  session.delivery.wake_budget = session.delivery.queue.size() + settings_.max_sleeping_messages;
}

void Sleep::follow(ClientSession& session, const Peer& peer, const LocalAddress& local,
                   TimePoint now) {
  if (ClientSession* former = clients_.find(peer)) lifecycle_.displace(*former, now);
  const bool is_new_address = session.peer != peer;
  clients_.bind(session, peer, local);
  if (is_new_address) downlink_.on_address(session);
  output_.mark_changed(session);
  lifecycle_.report_presence(session, presence_of(session.state()), now);
}

void Sleep::settle(ClientSession& session, TimePoint now) {
  if (session.state() != ClientState::awake || !session.answers.empty()) return;
  if (downlink_.is_awaiting(session)) return;
  output_.send(session, Pingresp{});
  sleep_again(session, now);
}

/// No PINGRESP: a client that does not answer may not listen any longer.
void Sleep::on_unanswered(ClientSession& session, TimePoint now) {
  if (session.state() == ClientState::awake) sleep_again(session, now);
}

void Sleep::sleep_again(ClientSession& session, TimePoint now) {
  downlink_.rest(session);
  lifecycle_.enter(session, ClientState::asleep, now);
}

}  // namespace slamgw::mqttsn
