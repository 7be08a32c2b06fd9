// SPDX-License-Identifier: Apache-2.0
// What waits for the broker, in order, and the receipts that fire when it is there. Pure: the
// application performs the actions. One queue for all robots keeps the order per robot and topic;
// the window bounds what is under way.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <variant>

#include "daemon/core/messages.hpp"
#include "daemon/core/protocol_machine.hpp"

namespace slamgw {

struct PublishAtBroker {
  std::uint64_t sequence = 0;
  BrokerMessage message;
};
struct FireReceipt {
  Receipt receipt;
  ReceiptOutcome outcome = ReceiptOutcome::safe;
};
/// For the MessageStore: the broker is away and a robot waits for this message's acknowledgement.
struct KeepInStore {
  std::uint64_t sequence = 0;
  BrokerMessage message;
};
struct ForgetInStore {
  std::uint64_t sequence = 0;
};

using OutboxAction = std::variant<PublishAtBroker, FireReceipt, KeepInStore, ForgetInStore>;

class Outbox {
 public:
  /// Memory bound for all that waits; beyond it acknowledged messages are refused and others
  /// dropped. 64 MiB is minutes of a thousand robots and little on a Pi.
  static constexpr std::size_t max_queued_bytes = 64u << 20;
  /// What one queued message costs besides topic and payload.
  static constexpr std::size_t message_overhead_bytes = 160;
  /// QoS 0 handed to the client and not yet written; keeps Paho's buffer (256) from overflowing.
  static constexpr std::size_t max_unacknowledged_in_flight = 64;
  /// Contract, promise 5: QoS 0 is never queued behind an outage for longer.
  static constexpr std::chrono::seconds max_unacknowledged_age{10};

  struct Statistics {
    std::uint64_t published = 0;  ///< the broker has them
    std::uint64_t dropped = 0;    ///< QoS 0 too old, without room, or lost with the link
    std::uint64_t refused = 0;    ///< no room, or the broker will never take them
  };

  /// `window`: QoS 1 and 2 messages under way at once (`broker.max_inflight`).
  explicit Outbox(std::size_t window) : window_(window) {}

  void submit(BrokerMessage message, Receipt receipt, TimePoint now);
  /// `receive_maximum` as the broker says it; one slot is left free for MQTT 5 flow control.
  void on_link_up(std::uint16_t receive_maximum, TimePoint now);
  /// What was under way is published again, in order, when the link is back (QoS 0: counted as
  /// dropped).
  void on_link_down(TimePoint now);
  void on_published(std::uint64_t sequence, TimePoint now);
  /// The broker will never take it (MQTT 5: not authorised, payload refused).
  void on_publish_refused(std::uint64_t sequence, TimePoint now);
  /// The store has made it durable.
  void on_stored(std::uint64_t sequence);

  std::optional<OutboxAction> next_action() { return actions_.pop(); }
  std::optional<TimePoint> deadline() const { return expiry_check_; }
  void on_deadline(TimePoint now);

  std::size_t depth() const { return waiting_.size() + in_flight_.size(); }
  std::size_t queued_bytes() const { return queued_bytes_; }
  const Statistics& statistics() const { return statistics_; }

 private:
  struct Entry {
    std::uint64_t sequence = 0;
    BrokerMessage message;
    Receipt receipt;
    TimePoint submitted{};
    bool is_kept = false;  ///< KeepInStore was asked for

    bool is_unacknowledged() const { return message.qos == Qos::at_most_once; }
    std::size_t cost() const;
  };

  void refuse(const Entry& entry);
  void keep(Entry& entry);
  void publish_waiting();
  void expire_unacknowledged(TimePoint now);
  std::size_t& in_flight_of(const Entry& entry);
  void finish(std::uint64_t sequence, ReceiptOutcome outcome);

  std::size_t window_;
  std::size_t effective_window_ = 0;
  bool is_up_ = false;
  std::uint64_t next_sequence_ = 1;
  std::deque<Entry> waiting_;    // sequences rise
  std::deque<Entry> in_flight_;  // sequences rise, all below those waiting
  std::size_t acknowledged_in_flight_ = 0;
  std::size_t unacknowledged_in_flight_ = 0;
  std::size_t queued_bytes_ = 0;
  std::optional<TimePoint> expiry_check_;  // while the link is down and QoS 0 waits
  Statistics statistics_;
  ActionQueue<OutboxAction> actions_;
};

}  // namespace slamgw
