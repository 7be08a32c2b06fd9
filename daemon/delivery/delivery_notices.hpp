// SPDX-License-Identifier: Apache-2.0
// Log lines about messages that the broker refuses and about a failing store. Pure; part of the
// outbox.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <unordered_set>
#include <utility>

#include "daemon/core/log_throttle.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/delivery/message_store.hpp"

namespace slamgw {

/// Notices of Occasion::broker_refusal, whose number the log bounds.
class RefusalNotices {
 public:
  static Notice on_refused_topic(const std::string& topic, const Refusal& refusal);
  static Notice on_accepted(const std::string& topic);
  enum class Fate : std::uint8_t {
    dead_letter,       ///< it is not tried again by itself
    not_acknowledged,  ///< it cannot become a dead letter, so its robot keeps it
    own_retained,      ///< a newer message of the gateway itself follows
  };
  /// Reports a message of `bytes` octets that is not delivered.
  static Notice on_undelivered(Fate fate, const std::string& topic, std::size_t bytes,
                               const Refusal& refusal);
  /// Reports dropped QoS 0 messages, each topic once.
  std::optional<Notice> on_unacknowledged(const BrokerMessage& message, const Refusal& refusal);

 private:
  std::unordered_set<std::size_t> unacknowledged_;  // reported topics, by SlotSums::slot
};

/// Reports why the store cannot be written or read: once a minute, because a store may take some
/// writes and not others. Reports the end of a failure that it has reported.
class StoreTrouble {
 public:
  /// Returns the present failure; empty while the store can be written and read.
  const std::string& why() const { return !write_.empty() ? write_ : read_; }
  std::uint64_t failures() const { return failures_; }

  enum class Way : std::uint8_t { write, read };
  std::optional<Notice> on_failed(Way way, const std::string& error, TimePoint now);
  std::optional<Notice> on_worked(Way way);
  /// Call when the store is open, or is not for the reason `why`.
  void on_opened(std::string why) { write_ = std::move(why); }

 private:
  static constexpr std::chrono::minutes interval{1};

  std::string write_;
  std::string read_;
  std::uint64_t failures_ = 0;
  LogThrottle throttle_{interval};
  bool is_said_ = false;
};

}  // namespace slamgw
