// SPDX-License-Identifier: Apache-2.0
// Estimates how fast each mesh answers a robot with addresses on both. When both meshes reach the
// robot, commands take the mesh that the configuration prefers, else the one that lately answered
// faster and lost less. Pure.
#pragma once

#include <chrono>
#include <map>
#include <string>

#include "daemon/core/messages.hpp"

namespace slamgw {

class CarrierChoice {
 public:
  /// A lost command counts like one that was answered after this time.
  static constexpr std::chrono::milliseconds loss_counts_as{10'000};
  /// An experience counts half after this time, so that the other mesh is tried again.
  static constexpr std::chrono::seconds half_life{60};

  void on_outcome(const CommandOutcome& outcome, TimePoint now);
  /// Returns the expected time until an answer. It decays towards zero, the value of a mesh that
  /// was never tried.
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
