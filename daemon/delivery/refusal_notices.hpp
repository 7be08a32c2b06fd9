// SPDX-License-Identifier: Apache-2.0
// What the log says about messages that the broker does not take: each topic and reason once, and
// only so many lines in a row. Pure; part of the outbox.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <unordered_set>

#include "daemon/core/messages.hpp"
#include "daemon/delivery/message_store.hpp"

namespace slamgw {

/// Why a message was not taken in.
struct NoRoom {
  std::uint64_t count = 0;        ///< messages that the line stands for
  std::uint64_t store_bytes = 0;  ///< while the store is full; else 0
  std::uint64_t store_max_bytes = 0;
  bool is_of_refused_topic = false;
  std::size_t memory_bytes = 0;
  StoreShares::Share largest{};  ///< of the store
};
Notice no_room_notice(const NoRoom& no_room);

class RefusalNotices {
 public:
  /// So many lines in each interval; the next interval begins with how many more there were.
  static constexpr std::size_t most_lines = 20;
  static constexpr std::chrono::seconds interval{10};

  std::optional<Notice> on_refused_topic(const std::string& topic, const Refusal& refusal,
                                         TimePoint now);
  std::optional<Notice> on_accepted(const std::string& topic, TimePoint now);
  /// A message of `bytes` octets has become one that is not tried again.
  std::optional<Notice> on_dead_letter(const std::string& topic, std::size_t bytes,
                                       const Refusal& refusal, TimePoint now);
  /// QoS 0, of each topic once.
  std::optional<Notice> on_unacknowledged(const BrokerMessage& message, const Refusal& refusal,
                                          TimePoint now);
  /// It was neither acknowledged to a robot nor can it be a dead letter.
  std::optional<Notice> on_dropped(const std::string& topic, std::size_t bytes,
                                   const Refusal& refusal, TimePoint now);

 private:
  std::optional<Notice> within_budget(Severity severity, std::string text, TimePoint now);

  std::unordered_set<std::size_t> unacknowledged_;  // TopicCounts::slot
  TimePoint begin_{};
  std::size_t lines_ = 0;
  std::size_t left_out_ = 0;
};

}  // namespace slamgw
