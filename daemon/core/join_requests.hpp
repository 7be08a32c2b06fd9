// SPDX-License-Identifier: Apache-2.0
// Permit-join over the broker: reads the requests on `<prefix>/gateway/<gw>/request/permit_join`,
// has each one ordered as the control socket's `ble permit-join` is, and publishes the answer and
// who joins then (docs/topics.md). Off without `ble_mesh.provisioning.over_mqtt`. Pure; the
// application drains its actions.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <variant>

#include "daemon/core/log_throttle.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/operator_order.hpp"
#include "daemon/core/protocol_machine.hpp"
#include "daemon/core/result.hpp"

namespace slamgw {

/// Have the BLE mesh do this, for whom `who` names (AuditFacts), and give the answer to
/// JoinRequests::on_ordered().
struct OrderJoining {
  std::string who;
  PermitJoinOrder order;
};
/// Ask the BLE mesh, and give the answer to JoinRequests::on_news().
struct AskJoining {
  JoinEventsOrder order;
};
/// Publish this document as the response: QoS 0, not retained.
struct PublishJoining {
  std::string document;
};
using JoinAction = std::variant<OrderJoining, AskJoining, PublishJoining, Notice>;

class JoinRequests {
 public:
  /// Of a request, in bytes.
  static constexpr std::size_t max_payload = 512;
  /// Requests that come faster than this are refused.
  static constexpr Duration shortest_pause = std::chrono::seconds{1};
  /// Between two questions who has joined.
  static constexpr Duration interval = std::chrono::seconds{1};
  /// While robots may join, the response is published again after this time without news: it is for
  /// pages that have come since.
  static constexpr Duration repeat = std::chrono::seconds{10};
  /// Events in a response. The newest are kept.
  static constexpr std::size_t max_events = 32;

  /// A message of the request topic.
  void on_request(const BrokerMessage& message, const Now& now);
  /// The mesh's answer to a request, or that it grants one of the control socket.
  void on_ordered(const OrderAnswer& answer, const Now& now);
  void on_news(const OrderAnswer& answer, const Now& now);

  std::optional<JoinAction> next_action() { return actions_.pop(); }
  std::optional<TimePoint> deadline() const { return ask_at_; }
  void on_deadline(const Now& now);

  /// Adds how many requests were given to the mesh, and how many were not.
  void add_to(Counters& counters) const;

 private:
  void refuse(const std::string& why, bool is_answered, const Now& now);

  ActionQueue<JoinAction> actions_;
  LogThrottle refusals_;
  std::optional<TimePoint> requested_at_;  ///< the last one that was not too fast
  std::optional<TimePoint> ask_at_;        ///< while robots may join
  std::uint64_t before_ = 0;               ///< number of the last event before the permit
  std::uint64_t told_ = 0;                 ///< number of the last event that was published
  TimePoint due_{};                        ///< it is published then, also without news
  std::uint64_t ordered_ = 0;
  std::uint64_t refused_ = 0;
};

/// What a request's payload asks for, or what is wrong with it in words.
Result<PermitJoinOrder, std::string> parse_join_request(ByteView payload);

}  // namespace slamgw
