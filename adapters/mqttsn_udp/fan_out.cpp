// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/fan_out.hpp"

#include <algorithm>
#include <memory>
#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {
namespace {

using Match = FilterTree::Match;

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

void FanOut::on_broker_message(const BrokerMessage& message, TimePoint now) {
  FilterTree::Matches matches = subscriptions_.match(message.topic);
  if (message.retain) {
    std::erase_if(matches.all, [&](const Match& match) {
      return !subscriptions_.takes_retained(*match.subscription, message.topic, now);
    });
  } else if (matches.filters > 1 && copies_.is_copy(message, matches.filters, now)) {
    return context_.tally.count(Count::copies_dropped);
  }
  keep_best(matches.all);
  if (matches.all.empty()) return;
  const auto shared = std::make_shared<const BrokerMessage>(message);
  for (const auto& [session, subscription] : matches.all) {
    Outgoing outgoing;
    outgoing.message = shared;
    outgoing.qos = std::min(message.qos, subscription->qos);
    outgoing.topic_id_type = subscription->topic_id_type;
    outgoing.predefined_id = subscription->topic_id;
    outgoing.command = commands_.begin(*session, message.topic, now);
    downlink_.enqueue(*session, std::move(outgoing), now);
  }
}

bool CopyFilter::is_copy(const BrokerMessage& message, std::size_t filters, TimePoint now) {
  std::erase_if(seen_, [&](const Seen& seen) { return seen.until < now || !seen.copies_left; });
  const std::uint64_t topic = fingerprint(as_bytes(message.topic));
  const std::uint64_t same = topic * 31 + fingerprint(message.payload);
  const auto found = std::find_if(seen_.begin(), seen_.end(),
                                  [&](const Seen& seen) { return seen.fingerprint == same; });
  if (found != seen_.end()) {
    --found->copies_left;
    return true;
  }
  if (seen_.size() >= limits::max_remembered_copies) seen_.pop_front();
  seen_.push_back({same, now + limits::copy_window, filters - 1});
  return false;
}

}  // namespace slamgw::mqttsn
