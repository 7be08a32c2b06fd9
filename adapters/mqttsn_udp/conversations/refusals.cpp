// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/refusals.hpp"

#include <fmt/format.h>

#include <functional>
#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

void Refusals::on_refusal(Count what, std::string_view who, std::string text,
                          const std::string& robot, TimePoint now) {
  output_.count(what);
  const std::uint64_t key =
      std::hash<std::string_view>{}(who)*31 + static_cast<std::uint64_t>(what);
  if (logged_.contains(key)) return;
  const ClientSession* session = clients_.find_robot(robot);
  const bool is_proven = session && session->has_answered;
  auto& [budget, left_out] = lines_[is_proven];
  if (!budget.take(limits::refusal_lines_burst, limits::refusal_lines_per_second, now)) {
    ++left_out;
    return;
  }
  if (logged_.size() >= limits::max_logged_refusals) {
    logged_.erase(oldest_first_.front());
    oldest_first_.pop_front();
  }
  logged_.insert(key);
  oldest_first_.push_back(key);
  if (left_out > 0)
    text += fmt::format(" ({} refusals since the last line)", std::exchange(left_out, 0));
  output_.emit(Notice{.severity = Severity::notice,
                      .text = std::move(text),
                      .robot = robot,
                      .is_proven = is_proven});
}

void Refusals::on_full_tables(const ClientSession& session, const std::string& name,
                              TimePoint now) {
  on_refusal(Count::topics_refused, "room " + session.client_id,
             fmt::format("{} has no room for '{}': a client may have {} topics and {} "
                         "subscriptions, and fewer when their names are long",
                         session.robot, name, limits::max_topics_per_client,
                         limits::max_subscriptions_per_client),
             session.robot, now);
}

void Refusals::forget_all() {
  logged_.clear();
  oldest_first_.clear();
}

}  // namespace slamgw::mqttsn
