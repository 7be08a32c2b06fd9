// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/refusals.hpp"

#include <functional>
#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

void Refusals::on_refusal(Count what, std::string_view who, std::string text,
                          const std::string& robot, TimePoint now) {
  tally_.count(what);
  const std::uint64_t key =
      std::hash<std::string_view>{}(who)*31 + static_cast<std::uint64_t>(what);
  if (told_.contains(key)) return;
  if (!lines_.take(limits::refusal_lines_burst, limits::refusal_lines_per_second, now)) return;
  if (told_.size() >= limits::max_told_refusals) {
    told_.erase(oldest_first_.front());
    oldest_first_.pop_front();
  }
  told_.insert(key);
  oldest_first_.push_back(key);
  output_.emit(Notice{Severity::notice, std::move(text), robot});
}

void Refusals::forget_all() {
  told_.clear();
  oldest_first_.clear();
}

}  // namespace slamgw::mqttsn
