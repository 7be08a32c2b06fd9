// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/pending_sends.hpp"

#include <algorithm>
#include <utility>

namespace slamgw {

nlohmann::json outcome_json(std::string_view outcome, std::int64_t after_ms,
                            const std::string& why) {
  return {{"outcome", outcome}, {"after_ms", after_ms}, {"why", why}};
}

bool PendingSends::add(std::string robot, std::string type, Done done, TimePoint now) {
  if (waiting_.size() >= max_waiting) return false;
  waiting_.push_back({std::move(robot), std::move(type), std::move(done), now});
  return true;
}

void PendingSends::on_outcome(const CommandOutcome& outcome) {
  const auto waiting = std::find_if(waiting_.begin(), waiting_.end(), [&](const Waiting& w) {
    return w.robot == outcome.robot && w.type == outcome.type;
  });
  if (waiting == waiting_.end()) return;
  const Done done = std::move(waiting->done);
  waiting_.erase(waiting);
  done(outcome_json(to_string(outcome.result), outcome.after.count(), outcome.why));
}

void PendingSends::on_time(TimePoint now) {
  while (!waiting_.empty() && now - waiting_.front().since >= patience) {
    const Done done = std::move(waiting_.front().done);
    waiting_.pop_front();
    done(outcome_json("timeout", std::chrono::milliseconds(patience).count(),
                      "no mesh took the command: the robot has not subscribed to it"));
  }
}

}  // namespace slamgw
