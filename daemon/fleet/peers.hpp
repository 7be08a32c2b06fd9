// SPDX-License-Identifier: Apache-2.0
// The other gateways as their beats tell: which live, in which life, and what they claim. Knows
// nothing of robots. Pure; part of Ownership.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/time.hpp"
#include "daemon/fleet/claim_table.hpp"
#include "daemon/fleet/fleet_message.hpp"

namespace slamgw::fleet {

/// In periods of beats. A gateway acts for 2.4 periods after it has SENT a beat that came back;
/// others call it dead 3 periods after they would have RECEIVED its last beat without delay. No
/// beat is received before it is sent, so the gateway has stopped acting before anybody takes over.
inline constexpr double lease_periods = 2.4;
inline constexpr int death_periods = 3;

class Peers {
 public:
  /// Gateways beyond it are not heard.
  static constexpr std::size_t max_peers = 2000;

  /// The shortest way of a beat, as a difference of two clocks: of the last 30 to 60 s, for clocks
  /// drift against each other and the network may change.
  struct Way {
    static constexpr std::chrono::seconds window{30};
    std::int64_t shortest_ms = INT64_MAX;
    std::int64_t shortest_before_ms = INT64_MAX;
    TimePoint window_start{};
    /// How much later than on the shortest way a beat came.
    std::chrono::milliseconds delay_of(const Beat& beat, TimePoint now);
    /// The same of another message that its sender's clock says was sent then.
    std::chrono::milliseconds delay_of(std::int64_t sent_ms, TimePoint now) const;
  };

  struct Peer {
    Life life = 0;
    std::vector<Life> past_lives;  ///< the newest last
    Way way;
    std::chrono::milliseconds period{};
    TimePoint alive_until{};
    TimePoint hears_since{};    ///< but for short gaps
    TimePoint gapless_since{};  ///< it has missed nothing since then
    ClaimTable::Digest digest{};
    unsigned mismatches = 0;            ///< beats in a row whose digest was not ours
    std::optional<TimePoint> asked_at;  ///< for its table
  };
  /// False when it does not count: it is of a life that is over, or there is no room.
  bool on_beat(const std::string& gateway, Life life, const Beat& beat, TimePoint now);
  /// This gateway heard nobody since `lost`, when its own link broke: who lived then has as long as
  /// after a beat to be heard again.
  void on_own_gap(TimePoint lost, TimePoint now);
  bool is_alive(const std::string& gateway, Life life, TimePoint now) const;
  /// A later life of the gateway is known.
  bool is_over(const std::string& gateway, Life life) const;
  /// It lives, whatever its life.
  bool is_alive(const std::string& gateway, TimePoint now) const;
  /// How much later than on the shortest way a message came that was `sent_ms` by its sender's
  /// clock; zero when that is not known.
  std::chrono::milliseconds delay_of(const std::string& gateway, Life life, std::int64_t sent_ms,
                                     TimePoint now) const;
  const Peer* find(const std::string& gateway) const;
  Peer* find(const std::string& gateway);
  std::map<std::string, Peer>& all() { return peers_; }
  const std::map<std::string, Peer>& all() const { return peers_; }
  std::size_t count_alive(TimePoint now) const;
  /// Of those whose names come before this one.
  std::size_t count_alive_before(const std::string& name, TimePoint now) const;
  /// Some gateway that lives hears the others since then, but for short gaps.
  bool has_witness(TimePoint since, TimePoint now) const;
  /// Some gateway that lives has missed nothing since then.
  bool has_gapless_witness(TimePoint since, TimePoint now) const;
  /// Forgets gateways that have been dead for `forget_after`.
  void forget_dead(TimePoint now);

 private:
  static constexpr std::chrono::minutes forget_after{10};
  static constexpr std::size_t max_past_lives = 4;

  static bool is_over(const Peer& peer, Life life);
  /// False when that life is over.
  static bool begin_life(Peer& peer, Life life);

  std::map<std::string, Peer> peers_;
};

}  // namespace slamgw::fleet
