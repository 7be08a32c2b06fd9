// SPDX-License-Identifier: Apache-2.0
// Who says that a robot is his: a claim, and the order of claims. The greatest claim wins, so that
// claims may arrive doubled, late and in any order.
#pragma once

#include <compare>
#include <cstdint>
#include <string>

namespace slamgw::fleet {

/// One span of membership of one gateway: the upper 48 bits are random for each process, the lower
/// 16 count its lives. A gateway that was cut off for longer than its lease begins a new life, and
/// everybody drops the claims of the old one.
using Life = std::uint64_t;

constexpr bool is_same_process(Life a, Life b) {
  constexpr unsigned count_bits = 16;
  return (a >> count_bits) == (b >> count_bits);
}

/// True when `a` is an earlier life than `b` of the same process. Of two processes nobody can tell.
constexpr bool is_earlier_life(Life a, Life b) { return is_same_process(a, b) && a < b; }

/// Compared by epoch first, then by gateway and life, so that two claims are never equal unless
/// they are one.
struct Claim {
  std::uint64_t epoch = 0;
  std::string gateway;
  Life life = 0;

  auto operator<=>(const Claim&) const = default;
};

/// A greater epoch is malformed: no robot moves so often. Fits into a double, as JSON readers want.
inline constexpr std::uint64_t max_epoch = std::uint64_t{1} << 52U;
/// A robot that moves once a second for 30 000 years. Only a forger gets here; who owns a robot
/// under such an epoch begins again at 1, so that the robot can go on to others.
inline constexpr std::uint64_t spent_epoch = std::uint64_t{1} << 40U;

}  // namespace slamgw::fleet
