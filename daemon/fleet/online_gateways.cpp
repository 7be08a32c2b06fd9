// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/online_gateways.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <utility>

namespace slamgw::fleet {
namespace {

using std::chrono::milliseconds;

/// Ten times what a gateway says in its state; a larger one is not of a gateway.
constexpr std::size_t max_state_octets = 4096;
constexpr std::chrono::hours silent_after{1};
/// A gateway takes part so long after it has said that it is online.
constexpr milliseconds newcomer_patience{15000};
/// A gateway that is online for so long and takes no part may not know of this one.
constexpr milliseconds greeting_after{3000};
/// Where the broker sends no retained states: before that gateway takes itself to be alone.
constexpr milliseconds early_greeting_after{300};

}  // namespace

bool OnlineGateways::on_state(const std::string& gateway, ByteView payload, TimePoint now) {
  if (payload.size() > max_state_octets) return false;
  const auto json = nlohmann::json::parse(payload.begin(), payload.end(), nullptr, false);
  if (!json.is_object() || json.value("state", nlohmann::json{}) != "online") {
    states_.erase(gateway);
    return false;
  }
  if (states_.size() >= Peers::max_peers) return false;
  const auto text = [&](const char* key) {
    return json.contains(key) && json[key].is_string() ? json[key].get<std::string>() : "";
  };
  const bool is_greeted = states_[gateway].is_greeted && states_[gateway].since == text("since");
  states_[gateway] = {text("version"), text("since"), now, is_greeted};
  return true;
}

bool OnlineGateways::is_any_about(TimePoint now) const {
  return std::ranges::any_of(
      states_, [&](const auto& each) { return now - each.second.heard < silent_after; });
}

bool OnlineGateways::take_newcomers(const Peers& peers, TimePoint now) {
  const milliseconds after = brings_retained_ ? greeting_after : early_greeting_after;
  bool is_any = false;
  for (auto& [gateway, state] : states_) {
    if (now - state.heard < after || peers.is_alive(gateway, now)) continue;
    is_any |= !std::exchange(state.is_greeted, true);
  }
  return is_any;
}

TimePoint OnlineGateways::complete_since(const Peers& peers, TimePoint now) const {
  TimePoint since = TimePoint::min();
  for (const auto& [gateway, state] : states_) {
    if (now - state.heard >= newcomer_patience) continue;
    const Peers::Peer* peer = peers.find(gateway);
    if (!peer || now >= peer->alive_until) return TimePoint::max();
    since = std::max(since, peer->hears_since);
  }
  return since;
}

}  // namespace slamgw::fleet
