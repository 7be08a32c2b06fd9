// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/carrier_choice.hpp"

#include <cmath>

namespace slamgw {

using Milliseconds = std::chrono::duration<double, std::milli>;

void CarrierChoice::on_outcome(const CommandOutcome& outcome, TimePoint now) {
  const bool is_lost = outcome.result == CommandResult::timeout;
  if (!outcome.mesh || (!is_lost && outcome.result != CommandResult::delivered)) return;
  constexpr double share_of_last = 0.25;
  const Milliseconds last = is_lost ? Milliseconds(loss_counts_as) : Milliseconds(outcome.after);
  const double before = expected(outcome.robot, *outcome.mesh, now).count();
  const double mean = before == 0 ? last.count() : before + share_of_last * (last.count() - before);
  robots_[outcome.robot][*outcome.mesh] = {mean, now};
}

Milliseconds CarrierChoice::expected(const std::string& robot, Mesh mesh, TimePoint now) const {
  const auto known = robots_.find(robot);
  if (known == robots_.end()) return Milliseconds::zero();
  const Experience& experience = known->second[mesh];
  const std::chrono::duration<double> age = now - experience.at;
  const double half_lives = age / std::chrono::duration<double>(half_life);
  return Milliseconds(experience.answer_ms * std::exp2(-half_lives));
}

}  // namespace slamgw
