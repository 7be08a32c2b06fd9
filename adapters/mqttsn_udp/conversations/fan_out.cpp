// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/fan_out.hpp"

#include <algorithm>
#include <memory>
#include <utility>

namespace slamgw::mqttsn {
namespace {

using Match = Subscriptions::Match;

/// The best match of each session, in the order of their first CONNECT.
void keep_best(std::vector<Match>& matches) {
  const auto is_better = [](const Match& a, const Match& b) {
    if (a.session->serial != b.session->serial) return a.session->serial < b.session->serial;
    if (a.subscription->qos != b.subscription->qos)
      return a.subscription->qos > b.subscription->qos;
    return a.subscription->topic_id_type > b.subscription->topic_id_type;
  };
  std::sort(matches.begin(), matches.end(), is_better);
  const auto is_same = [](const Match& a, const Match& b) { return a.session == b.session; };
  matches.erase(std::unique(matches.begin(), matches.end(), is_same), matches.end());
}

}  // namespace

std::vector<FanOut::Recipient> FanOut::on_broker_message(const BrokerMessage& message,
                                                         CommandId command, TimePoint now) {
  std::vector<Match> matches = subscriptions_.match(message.topic);
  if (message.retain) {
    std::erase_if(matches, [&](const Match& match) {
      return !subscriptions_.takes_retained(*match.subscription, message.topic, now);
    });
  }
  if (command == CommandId::none) {
    std::erase_if(matches, [&](const Match& match) {
      return commands_.is_command_for(*match.session, message.topic);
    });
  }
  keep_best(matches);
  std::vector<Recipient> deliveries;
  bool has_robot = message.retain;  // such a one may have been given already
  const auto shared = std::make_shared<const BrokerMessage>(message);
  for (const auto& [session, subscription] : matches) {
    Outgoing outgoing;
    outgoing.message = shared;
    outgoing.qos = std::min(message.qos, subscription->qos);
    outgoing.topic_id_type = subscription->topic_id_type;
    outgoing.predefined_id = subscription->topic_id;
    outgoing.command = commands_.begin(*session, message, command, now);
    has_robot = has_robot || outgoing.command;
    deliveries.push_back({session, std::move(outgoing)});
  }
  if (command != CommandId::none && !has_robot) commands_.refuse_unsubscribed(message, command);
  return deliveries;
}

}  // namespace slamgw::mqttsn
