// SPDX-License-Identifier: Apache-2.0
// The air between boards and robots: latency per hop and segment, and losses from a seed.
// Messages from one node to another keep their order for all addresses, because replay protection
// would drop a message that another has overtaken.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "simulation/ble/board/board.hpp"
#include "simulation/random.hpp"

namespace slamgw::sim::ble {

/// A receiver of messages: one of the boards, or the robots.
struct Receiver {
  Address address = 0;  ///< identifies the receiver whose order is kept
  std::optional<std::size_t> board{};
  double loss = 0;   ///< in addition to the losses of the hops
  int level_db = 0;  ///< difference from the usual signal level
};

struct RadioSettings {
  unsigned hops = 1;  ///< between each robot and the board; relays take 1 off the TTL each
  std::vector<double> hop_loss{0};    ///< of each message on each hop, both ways; one value a hop
  std::vector<Duration> hop_delay{};  ///< means, one a hop; empty: `hop_time` each, exactly
  Duration bearer_interval{};         ///< least time between two packets of one node; 0: none
};

class Radio {
 public:
  static constexpr std::chrono::milliseconds hop_time{10};
  static constexpr std::chrono::milliseconds segment_time{10};  ///< each segment after the first
  static constexpr std::size_t max_in_flight = 10000;           ///< beyond it messages are lost

  Radio(RadioSettings settings, Random random) : settings_(std::move(settings)), random_(random) {}

  /// Returns for each receiver whether the message reaches it; the losses are independent.
  std::vector<bool> transmit(const MeshMessage& message, const std::vector<Receiver>& receivers,
                             TimePoint now);
  std::optional<TimePoint> next_arrival() const;
  /// Returns the first message that has arrived at `now`.
  std::optional<Reception> take(TimePoint now);
  bool loses_beacon() { return random_.chance(settings_.hop_loss.front()); }
  /// Returns true if the message is lost on one of the hops.
  bool loses_message();
  /// Returns the signal level of a transmitter, which depends on its place and varies by 3 dB.
  std::int8_t rssi_dbm(Address transmitter);
  bool is_silent() const { return in_flight_.empty(); }

 private:
  Duration travel_time();
  Duration time_of_segments(Address source, unsigned segments, TimePoint now);

  RadioSettings settings_;
  Random random_;
  std::map<Address, TimePoint> next_packet_;  ///< of each source, with a bearer interval
  std::multimap<TimePoint, Reception> in_flight_;
  std::map<std::pair<Address, Address>, TimePoint> last_arrival_;  ///< by source and receiver
};

}  // namespace slamgw::sim::ble
