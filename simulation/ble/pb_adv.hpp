// SPDX-License-Identifier: Apache-2.0
// The provisioning bearer between the board and unprovisioned robots (PB-ADV, Mesh Profile 1.0
// section 5.3): keeps the order of a link, and repairs losses by repeats, which take time.
// Provisioning has no relays: every robot is within one hop here.
#pragma once

#include <map>
#include <optional>
#include <utility>

#include "simulation/ble/provisioning_pdu.hpp"
#include "simulation/random.hpp"

namespace slamgw::sim::ble {

class PbAdv {
 public:
  static constexpr std::chrono::milliseconds signal_time{30};
  static constexpr std::chrono::milliseconds repeat_time{500};
  static constexpr int max_repeats = 60;  ///< a transaction is given up after 30 s

  PbAdv(double loss, Random random) : loss_(loss), random_(random) {}

  struct Arrival {
    bool is_to_board = false;
    LinkSignal signal;
  };
  void transmit(bool is_to_board, LinkSignal signal, TimePoint now);
  std::optional<TimePoint> next_arrival() const;
  /// Returns the first signal that has arrived at `now`.
  std::optional<Arrival> take(TimePoint now);

 private:
  double loss_;
  Random random_;
  std::multimap<TimePoint, Arrival> in_flight_;
  std::map<std::pair<std::uint32_t, bool>, TimePoint> last_arrival_;  ///< of links not closed yet
};

}  // namespace slamgw::sim::ble
