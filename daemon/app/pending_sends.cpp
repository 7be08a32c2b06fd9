// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/pending_sends.hpp"

#include <algorithm>
#include <utility>

namespace slamgw {

nlohmann::json outcome_json(std::string_view outcome, std::int64_t after_ms,
                            const std::string& why) {
  return {{"outcome", outcome}, {"after_ms", after_ms}, {"why", why}};
}

void PendingSends::add(CommandId command, Done done, TimePoint now) {
  waiting_.push_back({command, std::move(done), now});
}

void PendingSends::on_outcome(const CommandOutcome& outcome) {
  const auto waiting = std::ranges::find(waiting_, outcome.id, &Waiting::command);
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
                      "the mesh has not told its outcome"));
  }
}

}  // namespace slamgw
