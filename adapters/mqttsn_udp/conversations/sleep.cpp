// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/sleep.hpp"

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

void Supervision::fall_asleep(ClientSession& session, std::chrono::seconds duration,
                              TimePoint now) {
  session.sleep_duration = duration;
  if (session.delivery.forgets_ids_asleep) session.topics.forget_known();
  sleep_again(session, now);
  output_.mark_unsaved(session);
}

void Supervision::wake(ClientSession& session, TimePoint now) {
  if (session.state() != ClientState::asleep) return;
  lifecycle_.enter(session, ClientState::awake, now);
  session.delivery.wake_budget = session.delivery.queue.size() + settings_.max_sleeping_messages;
}

void Supervision::follow(ClientSession& session, const Arrival& arrival) {
  const Peer& peer = arrival.peer;
  if (ClientSession* former = clients_.find(peer)) lifecycle_.displace(*former, arrival.now);
  if (clients_.bind(session, peer, arrival.local)) downlink_.on_address(session);
  output_.mark_unsaved(session);
  lifecycle_.report_presence(session, presence_of(session.state()), arrival.now);
}

/// When nothing is left to send or to await, PINGRESP lets the client sleep again for the same
/// duration (R119, R120).
void Supervision::settle(ClientSession& session, TimePoint now) {
  if (session.state() != ClientState::awake || !session.answers.empty()) return;
  if (downlink_.is_awaiting(session)) return;
  output_.send(session, Pingresp{});
  sleep_again(session, now);
}

void Supervision::sleep_again(ClientSession& session, TimePoint now) {
  downlink_.rest(session);
  lifecycle_.enter(session, ClientState::asleep, now);
}

void Supervision::on_deadline(TimePoint now) {
  while (ClientSession* session = clients_.pop_due(now)) on_time(*session, now);
}

/// An awake client that does not answer may have stopped listening: it gets no PINGRESP, and its
/// messages wait for its next PINGREQ (R124).
void Supervision::on_time(ClientSession& session, TimePoint now) {
  const auto lost = lost_at(session);
  if (lost && *lost <= now) return lifecycle_.lose(session, now);
  const bool is_silent = downlink_.on_time(session, now);
  if (is_silent && session.state() == ClientState::awake) sleep_again(session, now);
  advance(session, now);
}

void Supervision::advance(ClientSession& session, TimePoint now) {
  downlink_.pump(session, now);
  settle(session, now);
  if (const auto next = earlier(lost_at(session), downlink_.next_time(session)))
    clients_.wake_by(session, *next);
}

/// Returns when the client counts as lost. An awake client is supervised by repeated requests
/// instead.
std::optional<TimePoint> Supervision::lost_at(const ClientSession& session) const {
  std::chrono::seconds duration{0};
  switch (session.state()) {
    case ClientState::active: duration = session.keep_alive; break;
    case ClientState::asleep: duration = session.sleep_duration; break;
    case ClientState::awake:
    case ClientState::disconnected:
    case ClientState::lost: return std::nullopt;
  }
  if (duration.count() == 0) duration = limits::max_supervision;
  const std::chrono::duration<double> allowed = duration * settings_.keep_alive_tolerance;
  return session.last_heard + std::chrono::duration_cast<Duration>(allowed);
}

}  // namespace slamgw::mqttsn
