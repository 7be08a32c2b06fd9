// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/pb_adv.hpp"

#include <algorithm>

namespace slamgw::sim::ble {

void PbAdv::transmit(bool is_to_board, LinkSignal signal, TimePoint now) {
  int repeats = 0;
  while (random_.chance(loss_)) {
    if (++repeats > max_repeats) return;
  }
  const std::pair<std::uint32_t, bool> direction{signal.link, is_to_board};
  TimePoint& last = last_arrival_[direction];
  last = std::max(last, now) + signal_time + repeat_time * repeats;
  const bool is_end = signal.kind == LinkSignal::Kind::close;
  in_flight_.emplace(last, Arrival{is_to_board, std::move(signal)});
  if (!is_end) return;
  last_arrival_.erase({direction.first, true});
  last_arrival_.erase({direction.first, false});
}

std::optional<TimePoint> PbAdv::next_arrival() const {
  if (in_flight_.empty()) return std::nullopt;
  return in_flight_.begin()->first;
}

std::optional<PbAdv::Arrival> PbAdv::take(TimePoint now) {
  if (in_flight_.empty() || in_flight_.begin()->first > now) return std::nullopt;
  Arrival first = std::move(in_flight_.begin()->second);
  in_flight_.erase(in_flight_.begin());
  return first;
}

}  // namespace slamgw::sim::ble
