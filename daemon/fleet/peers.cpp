// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/peers.hpp"

#include <algorithm>

namespace slamgw::fleet {

using std::chrono::milliseconds;

namespace {

/// A stranger may send any number.
constexpr std::uint64_t longest_up_ms = 30ULL * 24 * 3'600'000;

/// By two clocks. Unsigned meanwhile, because a stranger may send any number.
std::int64_t way_ms(std::int64_t sent_ms, TimePoint now) {
  return static_cast<std::int64_t>(static_cast<std::uint64_t>(to_clock_ms(now)) -
                                   static_cast<std::uint64_t>(sent_ms));
}

}  // namespace

milliseconds Peers::Way::delay_of(const Beat& beat, TimePoint now) {
  if (now - window_start >= window) {
    shortest_before_ms = std::exchange(shortest_ms, INT64_MAX);
    window_start = now;
  }
  shortest_ms = std::min(shortest_ms, way_ms(beat.sent_ms, now));
  return delay_of(beat.sent_ms, now);
}

milliseconds Peers::Way::delay_of(std::int64_t sent_ms, TimePoint now) const {
  constexpr std::uint64_t longest_ms = 3'600'000;
  const std::int64_t took = way_ms(sent_ms, now);
  const std::int64_t shortest = std::min(shortest_ms, shortest_before_ms);
  if (took <= shortest) return {};
  const std::uint64_t longer =
      static_cast<std::uint64_t>(took) - static_cast<std::uint64_t>(shortest);
  return milliseconds(std::min(longer, longest_ms));
}

bool Peers::is_over(const Peer& peer, Life life) {
  const bool was_before = std::ranges::find(peer.past_lives, life) != peer.past_lives.end();
  return was_before || is_earlier_life(life, peer.life);
}

bool Peers::is_over(const std::string& gateway, Life life) const {
  const Peer* peer = find(gateway);
  return peer && is_over(*peer, life);
}

bool Peers::begin_life(Peer& peer, Life life) {
  if (is_over(peer, life)) return false;
  std::vector<Life> past = std::move(peer.past_lives);
  past.push_back(peer.life);
  if (past.size() > max_past_lives) past.erase(past.begin());
  peer = {};
  peer.life = life;
  peer.past_lives = std::move(past);
  return true;
}

bool Peers::on_beat(const std::string& gateway, Life life, const Beat& beat, TimePoint now) {
  auto known = peers_.find(gateway);
  if (known == peers_.end()) {
    if (peers_.size() >= max_peers) return false;
    known = peers_.try_emplace(gateway).first;
    known->second.life = life;
  }
  Peer& peer = known->second;
  if (peer.life != life && !begin_life(peer, life)) return false;
  const TimePoint sent = now - peer.way.delay_of(beat, now);
  peer.period = milliseconds(beat.period_ms);
  peer.alive_until = std::max<TimePoint>(peer.alive_until, sent + peer.period * death_periods);
  peer.hears_since = sent - milliseconds(std::min(beat.up_ms, longest_up_ms));
  peer.gapless_since = sent - milliseconds(std::min(beat.gapless_ms, longest_up_ms));
  peer.digest = {beat.count, beat.digest};
  return true;
}

void Peers::on_own_gap(TimePoint lost, TimePoint now) {
  for (auto& [gateway, peer] : peers_)
    if (lost < peer.alive_until)
      peer.alive_until = std::max<TimePoint>(peer.alive_until, now + peer.period * death_periods);
}

milliseconds Peers::delay_of(const std::string& gateway, Life life, std::int64_t sent_ms,
                             TimePoint now) const {
  const Peer* peer = find(gateway);
  const bool is_known = peer && sent_ms != 0 && is_same_process(peer->life, life);
  return is_known ? peer->way.delay_of(sent_ms, now) : milliseconds{};
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

std::size_t Peers::count_alive_before(const std::string& name, TimePoint now) const {
  return static_cast<std::size_t>(
      std::count_if(peers_.begin(), peers_.lower_bound(name),
                    [&](const auto& peer) { return now < peer.second.alive_until; }));
}

bool Peers::has_witness(TimePoint since, TimePoint now) const {
  return std::ranges::any_of(peers_, [&](const auto& each) {
    return now < each.second.alive_until && each.second.hears_since <= since;
  });
}

bool Peers::has_gapless_witness(TimePoint since, TimePoint now) const {
  return std::ranges::any_of(peers_, [&](const auto& each) {
    return now < each.second.alive_until && each.second.gapless_since <= since;
  });
}

void Peers::forget_dead(TimePoint now) {
  std::erase_if(peers_,
                [&](const auto& peer) { return now >= peer.second.alive_until + forget_after; });
}

}  // namespace slamgw::fleet
