// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/sleep.hpp"

#include <utility>
#include <vector>

#include "adapters/mqttsn_udp/limits.hpp"

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

void Sleep::follow(ClientSession& session, const Arrival& arrival) {
  const Peer& peer = arrival.peer;
  if (ClientSession* former = clients_.find(peer)) lifecycle_.displace(*former, arrival.now);
  const bool is_new_address = session.peer != peer;
  clients_.bind(session, peer, arrival.local);
  if (is_new_address) downlink_.on_address(session);
  output_.mark_changed(session);
  lifecycle_.report_presence(session, presence_of(session.state()), arrival.now);
}

void Sleep::settle(ClientSession& session, TimePoint now) {
  if (session.state() != ClientState::awake || !session.answers.empty()) return;
  if (downlink_.is_awaiting(session)) return;
  output_.send(session, Pingresp{});
  sleep_again(session, now);
}

/// Sends no PINGRESP: a client that does not answer may have stopped listening.
void Sleep::on_unanswered(ClientSession& session, TimePoint now) {
  if (session.state() == ClientState::awake) sleep_again(session, now);
}

void Sleep::sleep_again(ClientSession& session, TimePoint now) {
  downlink_.rest(session);
  lifecycle_.enter(session, ClientState::asleep, now);
}

// --- Supervision ---------------------------------------------------------------------------------

std::optional<TimePoint> Supervision::deadline() const {
  return earlier(clients_.earliest(), commands_.deadline());
}

void Supervision::on_deadline(TimePoint now) {
  expire_commands(now);
  while (ClientSession* session = clients_.pop_due(now)) on_time(*session, now);
}

void Supervision::on_time(ClientSession& session, TimePoint now) {
  const auto lost = lost_at(session);
  if (lost && *lost <= now) return lifecycle_.lose(session, now);
  if (downlink_.on_time(session, now)) sleep_.on_unanswered(session, now);
  advance(session, now);
}

void Supervision::advance(ClientSession& session, TimePoint now) {
  downlink_.pump(session, now);
  sleep_.settle(session, now);
  if (const auto next = earlier(lost_at(session), downlink_.next_time(session)))
    clients_.wake_by(session, *next);
}

void Supervision::expire_commands(TimePoint now) {
  std::vector<ClientSession*> waiting;  // nothing is sent before all are withdrawn
  while (const auto command = commands_.pop_overdue(now)) {
    ClientSession* session = clients_.find(command->client_id);
    std::string why =
        session ? downlink_.withdraw(*session, *command) : "the robot's session has ended";
    commands_.end(command, CommandResult::timeout, std::move(why), now);
    if (session) waiting.push_back(session);
  }
  for (ClientSession* session : waiting) advance(*session, now);
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
