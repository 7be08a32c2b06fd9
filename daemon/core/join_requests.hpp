// SPDX-License-Identifier: Apache-2.0
// Permit-join over the broker: reads the requests on `<prefix>/gateway/<gw>/request/permit_join`,
// orders each one like the control socket's `ble permit-join`, and publishes the answer and the
// robots that join then (docs/topics.md). Off without `ble_mesh.provisioning.over_mqtt`. Pure; the
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

/// Have the BLE mesh carry out `order` on behalf of `who` (AuditFacts), and give the answer to
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
  /// Longest payload of a request, in bytes.
  static constexpr std::size_t max_payload = 512;
  /// Requests that come faster than this are refused.
  static constexpr Duration shortest_pause = std::chrono::seconds{1};
  /// Time between two questions to the mesh about new robots.
  static constexpr Duration interval = std::chrono::seconds{1};
  /// While robots may join, the response is published again after this time without news, for pages
  /// that were opened since.
  static constexpr Duration repeat = std::chrono::seconds{10};
  /// Events in a response. The newest are kept.
  static constexpr std::size_t max_events = 32;

  /// Takes a message of the request topic.
  void on_request(const BrokerMessage& message, const Now& now);
  /// Takes the mesh's answer to a request, and each grant of a request of the control socket.
  void on_ordered(const OrderAnswer& answer, const Now& now);
  void on_news(const OrderAnswer& answer, const Now& now);

  std::optional<JoinAction> next_action() { return actions_.pop(); }
  std::optional<TimePoint> deadline() const { return ask_at_; }
  void on_deadline(const Now& now);

  /// Adds how many requests were given to the mesh, and how many were refused.
  void add_to(Counters& counters) const;

 private:
  void refuse(const std::string& why, bool is_answered, const Now& now);

  ActionQueue<JoinAction> actions_;
  LogThrottle refusals_;
  std::optional<TimePoint> requested_at_;  ///< when the last request came that was not too fast
  std::optional<TimePoint> ask_at_;        ///< set while robots may join
  std::uint64_t before_ = 0;               ///< number of the last event before the permit
  std::uint64_t last_published_ = 0;       ///< number of the last event that was published
  TimePoint due_{};                        ///< the response is published then, even without news
  std::uint64_t ordered_ = 0;
  std::uint64_t refused_ = 0;
};

/// Returns the order in a request's payload, or a sentence that says what is wrong with it.
Result<PermitJoinOrder, std::string> parse_join_request(ByteView payload);

}  // namespace slamgw
