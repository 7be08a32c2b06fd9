// SPDX-License-Identifier: Apache-2.0
// A bad radio for one direction of one robot: decides, from a seed, what becomes of each datagram.
// It carries nothing itself; the shell does the waiting.
#pragma once

#include <chrono>
#include <vector>

#include "simulation/random.hpp"
#include "simulation/time.hpp"

namespace slamgw::sim::sn {

/// Probabilities 0..1.
struct ImpairmentSettings {
  double loss = 0;
  double duplicate = 0;
  double reorder = 0;  ///< of being held back 5-50 ms, so that later datagrams overtake it
  std::chrono::milliseconds delay{0};
};

class Impairment {
 public:
  Impairment(const ImpairmentSettings& settings, Random random)
      : settings_(settings), random_(random) {}

  /// The delay of each copy that arrives; empty when the datagram is lost. Draws the same number of
  /// random values each time, so that the n-th datagram's fate depends on the seed alone.
  std::vector<Duration> next_fate() {
    const bool is_lost = random_.chance(settings_.loss);
    const bool is_doubled = random_.chance(settings_.duplicate);
    const bool is_held = random_.chance(settings_.reorder);
    const std::chrono::milliseconds held{5 + random_.below(46)};
    if (is_lost) return {};
    const Duration delay = settings_.delay + (is_held ? held : std::chrono::milliseconds{0});
    return std::vector<Duration>(is_doubled ? 2 : 1, delay);
  }

 private:
  ImpairmentSettings settings_;
  Random random_;
};

}  // namespace slamgw::sim::sn
