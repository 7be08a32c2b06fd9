// SPDX-License-Identifier: Apache-2.0
// What the log says about messages that the broker does not take: each topic and reason once, and
// only so many lines in a row. Pure; part of the outbox.
#pragma once

#include <optional>
#include <string>
#include <unordered_set>

#include "daemon/core/messages.hpp"
#include "daemon/delivery/held_topics.hpp"

namespace slamgw {

class RefusalNotices {
 public:
  /// So many lines in each interval; the next interval begins with how many more there were.
  static constexpr std::size_t most_lines = 20;
  static constexpr std::chrono::seconds interval{10};

  std::optional<Notice> on_held(const std::string& topic, const Refusal& refusal, TimePoint now);
  std::optional<Notice> on_accepted(const std::string& topic, TimePoint now);
  std::optional<Notice> on_set_aside(const BrokerMessage& message, const Refusal& refusal,
                                     TimePoint now);
  /// QoS 0, of each topic once.
  std::optional<Notice> on_unacknowledged(const BrokerMessage& message, const Refusal& refusal,
                                          TimePoint now);
  /// It was neither acknowledged to a robot nor can it be set aside.
  std::optional<Notice> on_dropped(const BrokerMessage& message, const Refusal& refusal,
                                   TimePoint now);

 private:
  std::optional<Notice> within_budget(Severity severity, std::string text, TimePoint now);

  std::unordered_set<std::size_t> unacknowledged_;  // TopicCounts::slot
  TimePoint begin_{};
  std::size_t lines_ = 0;
  std::size_t left_out_ = 0;
};

}  // namespace slamgw
