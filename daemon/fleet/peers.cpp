// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/peers.hpp"

#include <algorithm>

namespace slamgw::fleet {

using std::chrono::milliseconds;

namespace {

/// A stranger may send any number.
constexpr std::uint64_t longest_up_ms = 30ULL * 24 * 3'600'000;

}  // namespace

milliseconds Peers::Way::delay_of(const Beat& beat, TimePoint now) {
  const std::int64_t now_ms =
      std::chrono::duration_cast<milliseconds>(now.time_since_epoch()).count();
  // Unsigned, because a stranger may send any number.
  const auto took = static_cast<std::int64_t>(static_cast<std::uint64_t>(now_ms) -
                                              static_cast<std::uint64_t>(beat.sent_ms));
  if (now - window_start >= window) {
    shortest_before_ms = std::exchange(shortest_ms, INT64_MAX);
    window_start = now;
  }
  shortest_ms = std::min(shortest_ms, took);
  const std::int64_t shortest = std::min(shortest_ms, shortest_before_ms);
  constexpr std::uint64_t longest_ms = 3'600'000;
  const std::uint64_t longer =
      static_cast<std::uint64_t>(took) - static_cast<std::uint64_t>(shortest);  // shortest <= took
  return milliseconds(std::min(longer, longest_ms));
}

bool Peers::on_beat(const std::string& gateway, Life life, const Beat& beat, TimePoint now) {
  const auto known = peers_.find(gateway);
  if (known == peers_.end() && peers_.size() >= max_peers) return false;
  if (known == peers_.end() || known->second.life != life) {
    auto& past = past_lives_[gateway];
    if (std::ranges::find(past, life) != past.end()) return false;
    if (known != peers_.end()) {
      if (is_earlier_life(life, known->second.life)) return false;
      past.push_back(known->second.life);
      if (past.size() > max_past_lives) past.pop_front();
    }
    peers_[gateway] = {};
    peers_[gateway].life = life;
    ways_[gateway] = {};
  }
  Peer& peer = peers_[gateway];
  const TimePoint sent = now - ways_[gateway].delay_of(beat, now);
  peer.alive_until =
      std::max<TimePoint>(peer.alive_until, sent + milliseconds(beat.period_ms) * death_periods);
  peer.hears_since = sent - milliseconds(std::min(beat.up_ms, longest_up_ms));
  peer.digest = {beat.count, beat.digest};
  return true;
}

const Peers::Peer* Peers::find(const std::string& gateway) const {
  const auto peer = peers_.find(gateway);
  return peer == peers_.end() ? nullptr : &peer->second;
}

Peers::Peer* Peers::find(const std::string& gateway) {
  const auto peer = peers_.find(gateway);
  return peer == peers_.end() ? nullptr : &peer->second;
}

bool Peers::is_alive(const std::string& gateway, Life life, TimePoint now) const {
  const Peer* peer = find(gateway);
  return peer && peer->life == life && now < peer->alive_until;
}

bool Peers::is_alive(const std::string& gateway, TimePoint now) const {
  const Peer* peer = find(gateway);
  return peer && now < peer->alive_until;
}

std::size_t Peers::count_alive(TimePoint now) const {
  return static_cast<std::size_t>(std::ranges::count_if(
      peers_, [&](const auto& peer) { return now < peer.second.alive_until; }));
}

bool Peers::has_witness(TimePoint since, TimePoint now) const {
  return std::ranges::any_of(peers_, [&](const auto& each) {
    return now < each.second.alive_until && each.second.hears_since <= since;
  });
}

void Peers::forget_dead(TimePoint now) {
  std::erase_if(peers_,
                [&](const auto& peer) { return now >= peer.second.alive_until + forget_after; });
  const auto is_gone = [&](const auto& entry) { return !peers_.contains(entry.first); };
  std::erase_if(ways_, is_gone);
  std::erase_if(past_lives_, is_gone);
}

}  // namespace slamgw::fleet
