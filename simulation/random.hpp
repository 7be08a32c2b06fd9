// SPDX-License-Identifier: Apache-2.0
// A small deterministic random generator (SplitMix64) with its own distributions: the standard
// library's differ between systems, and the same --seed must give the same robots everywhere.
#pragma once

#include <cstdint>

namespace slamgw::sim {

class Random {
 public:
  /// The use of a stream of numbers; streams of one seed are independent.
  enum class Use : std::uint64_t {
    body = 1,
    uplink = 2,
    downlink = 3,
    radio = 4,
    start = 5,
    roam = 6,
    uuid = 7,
    provisioning = 8,
    pb_adv = 9,
  };

  Random(std::uint64_t seed, std::uint64_t number, Use use) : state_(seed) {
    state_ = next() ^ (number * 0xd1342543de82ef95ULL);
    state_ = next() ^ (static_cast<std::uint64_t>(use) * 0xaf251af3b0f025b5ULL);
  }

  std::uint64_t next() {
    state_ += 0x9e3779b97f4a7c15ULL;
    std::uint64_t z = state_;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    return z ^ (z >> 31);
  }

  /// 0 .. limit - 1; `limit` is small against 2^32, so the bias is negligible.
  std::uint32_t below(std::uint32_t limit) {
    return static_cast<std::uint32_t>(((next() >> 32) * limit) >> 32);
  }

  /// 0 <= x < 1
  double unit() { return static_cast<double>(next() >> 11) * 0x1.0p-53; }

  /// True with this probability.
  bool chance(double probability) { return unit() < probability; }

 private:
  std::uint64_t state_;
};

}  // namespace slamgw::sim
