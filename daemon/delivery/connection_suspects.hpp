// SPDX-License-Identifier: Apache-2.0
// Which topics a broker may have closed the connection for. Brokers close it in place of refusing:
// Mosquitto for a packet that is too large, NATS for a `.` in a topic. Only what the broker had not
// answered can be the cause, and who was unanswered at two losses in a row is a suspect; HeldTopics
// tries suspects alone. Pure; part of the outbox.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "daemon/core/time.hpp"
#include "daemon/delivery/outbox_entry.hpp"

namespace slamgw {

class ConnectionSuspects {
 public:
  /// QoS 0 that was written, which has no answer: more than a broker is sent in the time that
  /// its closing takes to arrive, as a rule.
  static constexpr std::size_t most_written = 64;
  /// Two losses that lie further apart have nothing to do with each other.
  static constexpr std::chrono::hours longest_between{1};
  /// Debian 12's Mosquitto closes the connection after each PUBACK that refuses.
  static constexpr std::chrono::seconds refusal_to_loss{1};

  /// QoS 0 went to the network. `sequence` as in PublishAtBroker.
  void on_written(std::uint64_t sequence, std::string topic);
  /// The broker has answered it, and so has read all that was sent before it.
  void on_answered(std::uint64_t sequence);
  struct Refused {
    std::string topic;
    Refusal refusal;
    TimePoint at{};
  };
  void on_refused(Refused refused) { refused_ = std::move(refused); }
  /// The refusal for which the broker has closed the connection; null: there was none.
  const Refused* explanation(TimePoint now) const {
    return refused_ && now - refused_->at < refusal_to_loss ? &*refused_ : nullptr;
  }
  /// The connection is lost, and nothing explains it. Returns the topics that were unanswered at
  /// the loss before too.
  std::vector<std::string> on_loss(const OutboxEntries& unanswered, TimePoint now);
  /// A new connection: what was written to the old one is the past.
  void on_link_up();

 private:
  struct Written {
    std::uint64_t sequence = 0;
    std::string topic;
  };

  void drop_oldest();

  std::deque<Written, RecyclingAllocator<Written>>
      written_;  // by rising sequence, after the last answer
  std::set<std::string> last_unanswered_;
  TimePoint last_loss_{};
  std::optional<Refused> refused_;  ///< the last one of this connection
};

}  // namespace slamgw
