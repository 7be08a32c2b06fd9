// SPDX-License-Identifier: Apache-2.0
// Wiring, time and what does not come from clients. Their messages are in sn_gateway_receive.cpp.
#include "adapters/mqttsn_udp/sn_gateway.hpp"

#include <utility>

#include "adapters/mqttsn_udp/conversations/own_names.hpp"
#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

SnGateway::SnGateway(Settings settings, TopicPolicy policy, RobotNames names, RandomSource random)
    : context_(std::move(settings), std::move(policy), std::move(names)),
      refusals_(context_),
      answers_(context_),
      subscriptions_(context_, answers_, refusals_),
      commands_(context_),
      downlink_(context_, subscriptions_, commands_, std::move(random)),
      fan_out_(subscriptions_, commands_),
      uplink_(context_, refusals_),
      wills_(context_, refusals_),
      lifecycle_(context_, subscriptions_, downlink_, uplink_, wills_),
      sleep_(context_, downlink_, lifecycle_),
      roaming_(context_, lifecycle_),
      connecting_(context_, lifecycle_, downlink_, wills_, refusals_, guard_),
      renaming_(context_, subscriptions_, lifecycle_, connecting_),
      discovery_(context_, guard_) {}

void SnGateway::on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome, TimePoint) {
  uplink_.on_receipt(receipt_id, outcome);
}

void SnGateway::on_broker_message(const BrokerMessage& message, CommandId command, TimePoint now) {
  expire_commands(now);
  for (auto& [session, outgoing] : fan_out_.on_broker_message(message, command, now)) {
    downlink_.enqueue(*session, std::move(outgoing), now);
    advance(*session, now);
  }
}

void SnGateway::on_subscribe_result(const std::string& filter, bool granted, TimePoint now) {
  for (ClientSession* session : subscriptions_.on_subscribe_result(filter, granted, now)) {
    if (!granted) downlink_.drop_unwanted(*session, now);
    advance(*session, now);
  }
}

void SnGateway::on_broker_link(bool is_up, TimePoint now) {
  subscriptions_.on_broker_link(is_up, now);
  discovery_.on_broker_link(is_up, now);
}

void SnGateway::on_deadline(TimePoint now) {
  discovery_.on_deadline(now);
  connecting_.on_deadline(now);
  while (const auto waited = roaming_.take_overdue(now)) connect(*waited, now);
  subscriptions_.on_deadline(now);
  expire_commands(now);
  while (ClientSession* session = context_.clients.pop_due(now)) on_time(*session, now);
}

void SnGateway::on_time(ClientSession& session, TimePoint now) {
  if (lifecycle_.is_overdue(session, now)) return lifecycle_.lose(session, now);
  if (downlink_.on_time(session, now)) sleep_.on_unanswered(session, now);
  advance(session, now);
}

void SnGateway::advance(ClientSession& session, TimePoint now) {
  downlink_.pump(session, now);
  sleep_.settle(session, now);
  lifecycle_.schedule(session);
}

void SnGateway::expire_commands(TimePoint now) {
  std::vector<ClientSession*> waiting;  // nothing is sent before all are withdrawn
  while (const auto command = commands_.pop_overdue(now)) {
    ClientSession* session = context_.clients.find(command->client_id);
    std::string why = session ? downlink_.withdraw(*session, *command) : "the robot has gone";
    commands_.end(command, CommandResult::timeout, std::move(why), now);
    if (session) waiting.push_back(session);
  }
  for (ClientSession* session : waiting) advance(*session, now);
}

std::optional<TimePoint> SnGateway::deadline() const {
  return earlier(
      earlier(earlier(discovery_.deadline(), connecting_.deadline()), subscriptions_.deadline()),
      earlier(earlier(context_.clients.earliest(), commands_.deadline()), roaming_.deadline()));
}

void SnGateway::reconfigure(TopicPolicy policy, RobotNames names, TimePoint now) {
  context_.policy = std::move(policy);
  context_.names = std::move(names);
  refusals_.forget_all();
  renaming_.on_names(now);
  for (const auto& [id, session] : context_.clients.all()) {
    subscriptions_.drop_forbidden(*session, now);
    advance(*session, now);
  }
}

SnGateway::ClientCounts SnGateway::client_counts() const {
  ClientCounts counts;
  for (const auto& [id, session] : context_.clients.all()) {
    switch (session->state()) {
      case ClientState::active: ++counts.active; break;
      case ClientState::asleep:
      case ClientState::awake: ++counts.asleep; break;
      case ClientState::disconnected: ++counts.disconnected; break;
      case ClientState::lost: ++counts.lost; break;
    }
  }
  return counts;
}

std::optional<Presence> SnGateway::presence_of(const std::string& robot) const {
  const ClientSession* session = context_.clients.find_robot(robot);
  if (!session) return std::nullopt;
  return mqttsn::presence_of(session->state());
}

std::size_t SnGateway::queued_for(const std::string& robot) const {
  const ClientSession* session = context_.clients.find_robot(robot);
  if (!session) return 0;
  return session->delivery.queue.size() + (session->delivery.publishing ? 1 : 0);
}

void SnGateway::on_stop(TimePoint now) {
  downlink_.on_stop();
  for (const auto& [id, session] : context_.clients.all()) downlink_.refuse_unkept(*session, now);
}

void SnGateway::set_all_dirty() {
  for (const auto& [id, session] : context_.clients.all()) context_.set_dirty(*session);
}

std::optional<SessionSnapshot> SnGateway::snapshot(const std::string& client_id,
                                                   TimePoint now) const {
  const ClientSession* session = context_.clients.find(client_id);
  if (!session) return std::nullopt;
  SessionSnapshot out = to_snapshot(*session, now);
  out.is_validated = context_.is_validated(*session);
  if (!out.is_validated)
    out.allowance = context_.validation.allowance(session->peer->endpoint.address);
  return out;
}

void SnGateway::adopt_commands(const Delivery& delivery) {
  for (const Outgoing& waiting : delivery.queue) {
    if (waiting.command) commands_.adopt(waiting.command);
  }
}

void SnGateway::refuse_commands(const SessionSnapshot& snapshot, TimePoint now) {
  for (const MessageSnapshot& message : snapshot.messages) {
    commands_.end(command_of(message, snapshot, now), CommandResult::refused,
                  "the robot's session can't go on", now);
  }
}

void SnGateway::connect(const Roaming::WaitingConnect& waited, TimePoint now) {
  connecting_.on_connect(waited.peer, waited.local, waited.connect, waited.fingerprint, now);
  if (ClientSession* session = context_.clients.find(waited.peer)) advance(*session, now);
}

void SnGateway::take_over(const std::string& robot, std::optional<SessionSnapshot> session,
                          TimePoint now) {
  if (session && session->robot == robot && !context_.clients.find_robot(robot)) {
    session->saved_at = now;  // the other gateway's clock says nothing here
    session->peer.reset();
    session->state = ClientState::disconnected;
    restore(*session, now);
  }
  if (const auto waited = roaming_.take(robot)) connect(*waited, now);
}

bool SnGateway::restore(const SessionSnapshot& snapshot, TimePoint now) {
  const auto robot = connecting_.robot_of(snapshot.client_id);
  if (!robot || !is_valid_level(snapshot.robot) || context_.clients.is_full() ||
      context_.clients.find(snapshot.client_id)) {
    refuse_commands(snapshot, now);
    return false;
  }
  ClientSession& session = lifecycle_.begin(snapshot.client_id, *robot, now);
  apply(snapshot, session, now);
  if (*robot != snapshot.robot)
    rename_topics(context_.policy.scheme(), session, snapshot.robot, *robot);
  adopt_commands(session.delivery);
  if (snapshot.peer) {
    const IpAddress& address = snapshot.peer->endpoint.address;
    if (snapshot.is_validated) validate(address);
    context_.validation.restore_allowance(address, snapshot.allowance);
    context_.clients.bind(session, *snapshot.peer, session.local);
    downlink_.on_address(session);
  }
  subscriptions_.restore(session, now);
  lifecycle_.enter(session, snapshot.state, now);
  expire_commands(now);
  advance(session, now);
  return true;
}

}  // namespace slamgw::mqttsn
