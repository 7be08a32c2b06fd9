// SPDX-License-Identifier: Apache-2.0
// Over which mesh a robot with an address on both is commanded when both reach it: the one that the
// configuration prefers, else the one that answered faster and lost less lately. Pure.
#pragma once

#include <chrono>
#include <map>
#include <string>

#include "daemon/core/messages.hpp"

namespace slamgw {

class CarrierChoice {
 public:
  /// A lost command counts as one that was answered after so long.
  static constexpr std::chrono::milliseconds loss_counts_as{10'000};
  /// An old experience counts half after so long, so that the other mesh is tried again.
  static constexpr std::chrono::seconds half_life{60};

  void on_outcome(const CommandOutcome& outcome, TimePoint now);
  /// The expected time until an answer; zero for a mesh that was not tried lately.
  std::chrono::duration<double, std::milli> expected(const std::string& robot, Mesh mesh,
                                                     TimePoint now) const;
  void forget(const std::string& robot) { robots_.erase(robot); }

 private:
  struct Experience {
    double answer_ms = 0;  ///< a mean in which the last outcome counts a quarter
    TimePoint at{};
  };

  std::map<std::string, PerMesh<Experience>> robots_;
};

}  // namespace slamgw
