// SPDX-License-Identifier: Apache-2.0
// Wiring, time and what does not come from clients. Their messages are in sn_gateway_receive.cpp.
#include "adapters/mqttsn_udp/sn_gateway.hpp"

#include <utility>

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
      registration_(context_, answers_, uplink_, refusals_),
      wills_(context_, refusals_),
      lifecycle_(context_, subscriptions_, downlink_, uplink_, wills_),
      sleep_(context_, downlink_, lifecycle_),
      supervision_(context_, commands_, downlink_, lifecycle_, sleep_),
      roaming_(context_, lifecycle_),
      connecting_(context_, lifecycle_, downlink_, wills_, refusals_, guard_),
      renaming_(context_, subscriptions_, lifecycle_, connecting_),
      restoring_(context_, subscriptions_, commands_, downlink_, lifecycle_, connecting_,
                 supervision_),
      discovery_(context_, guard_) {}

void SnGateway::on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome, TimePoint) {
  uplink_.on_receipt(receipt_id, outcome);
}

void SnGateway::on_broker_message(const BrokerMessage& message, CommandId command, TimePoint now) {
  supervision_.expire_commands(now);
  for (auto& [session, outgoing] : fan_out_.on_broker_message(message, command, now)) {
    downlink_.enqueue(*session, std::move(outgoing), now);
    supervision_.advance(*session, now);
  }
}

void SnGateway::on_subscribe_result(const std::string& filter, bool granted, TimePoint now) {
  for (ClientSession* session : subscriptions_.on_subscribe_result(filter, granted, now)) {
    if (!granted) downlink_.drop_unwanted(*session, now);
    supervision_.advance(*session, now);
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
  supervision_.on_deadline(now);
}

std::optional<TimePoint> SnGateway::deadline() const {
  return earlier(
      earlier(earlier(discovery_.deadline(), connecting_.deadline()), subscriptions_.deadline()),
      earlier(supervision_.deadline(), roaming_.deadline()));
}

void SnGateway::reconfigure(TopicPolicy policy, RobotNames names, TimePoint now) {
  context_.policy = std::move(policy);
  context_.names = std::move(names);
  refusals_.forget_all();
  renaming_.on_names(now);
  for (const auto& [id, session] : context_.clients.all()) {
    subscriptions_.drop_forbidden(*session, now);
    supervision_.advance(*session, now);
  }
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

void SnGateway::connect(const Roaming::WaitingConnect& waited, TimePoint now) {
  connecting_.on_connect(waited.peer, waited.local, waited.connect, waited.fingerprint, now);
  if (ClientSession* session = context_.clients.find(waited.peer))
    supervision_.advance(*session, now);
}

void SnGateway::take_over(const std::string& robot, std::optional<SessionSnapshot> session,
                          TimePoint now) {
  if (session && session->robot == robot && !context_.clients.find_robot(robot)) {
    session->saved_at = now;  // the other gateway's clock says nothing here
    session->peer.reset();
    session->state = ClientState::disconnected;
    restoring_.restore(*session, now);
  }
  if (const auto waited = roaming_.take(robot)) connect(*waited, now);
}

}  // namespace slamgw::mqttsn
