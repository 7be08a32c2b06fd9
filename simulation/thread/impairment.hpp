// SPDX-License-Identifier: Apache-2.0
// A bad radio for one direction of one robot: decides, from a seed, whether each datagram is lost,
// doubled or delayed. The shell sends and waits.
#pragma once

#include <chrono>
#include <optional>
#include <vector>

#include "simulation/random.hpp"
#include "simulation/time.hpp"

namespace slamgw::sim::sn {

/// One hop of the path. IEEE 802.15.4 sends a frame again, up to three times, until it sees the
/// acknowledgement (macMaxFrameRetries), so most of its losses only take time.
struct Hop {
  double loss = 0;   ///< of each frame, and of each acknowledgement
  Duration delay{};  ///< mean of one frame; each takes 0.5 to 1.5 times that
};
constexpr unsigned link_transmissions = 4;

/// Probabilities 0..1.
struct ImpairmentSettings {
  double loss = 0;
  double duplicate = 0;
  double reorder = 0;  ///< of a delay of 5-50 ms, so that later datagrams overtake it
  std::chrono::milliseconds delay{0};
  std::vector<Hop> path{};  ///< in addition
};

class Impairment {
 public:
  Impairment(const ImpairmentSettings& settings, Random random)
      : settings_(settings), random_(random) {}

  /// Returns the delay of each copy that arrives; empty when the datagram is lost. Draws the same
  /// number of random values each time, so that the n-th datagram's fate depends on the seed alone.
  std::vector<Duration> next_fate() {
    const bool is_lost = random_.chance(settings_.loss);
    const bool is_doubled = random_.chance(settings_.duplicate);
    const bool is_held = random_.chance(settings_.reorder);
    const std::chrono::milliseconds held{5 + random_.below(46)};
    link_repeats_ = 0;
    if (is_lost) return {};
    Duration delay = settings_.delay + (is_held ? held : std::chrono::milliseconds{0});
    if (!settings_.path.empty()) {
      Random random(random_.next(), 0, Random::Use::radio);
      for (const Hop& hop : settings_.path) {
        const std::optional<Duration> took = cross(hop, random);
        if (!took) return {};
        delay += *took;
      }
    }
    return std::vector<Duration>(is_doubled ? 2 : 1, delay);
  }

  /// Returns the number of repeated frames of the last datagram.
  unsigned link_repeats() const { return link_repeats_; }

 private:
  /// Returns the time until the next node has the frame; nothing if it never arrives. If the
  /// acknowledgement is lost, the sender repeats the frame, and the receiver drops the copy.
  std::optional<Duration> cross(const Hop& hop, Random& random) {
    std::optional<Duration> arrived;
    Duration passed{};
    for (unsigned i = 0; i < link_transmissions; ++i) {
      if (i > 0) ++link_repeats_;
      passed += std::chrono::duration_cast<Duration>(hop.delay * (0.5 + random.unit()));
      const bool is_frame_lost = random.chance(hop.loss);
      if (!is_frame_lost && !arrived) arrived = passed;
      if (!is_frame_lost && !random.chance(hop.loss)) break;
    }
    return arrived;
  }

  ImpairmentSettings settings_;
  Random random_;
  unsigned link_repeats_ = 0;
};

}  // namespace slamgw::sim::sn
