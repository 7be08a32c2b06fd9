// SPDX-License-Identifier: Apache-2.0
// Finds out whether the broker's access list gives this gateway the rights that it needs. A broker
// may grant a subscription and send nothing (Mosquitto does, without the right to read), or take a
// message and drop it silently. So at each connect the gateway sends messages to itself, one where
// it publishes and one where commands come from, and waits for both. Pure; part of Gateway.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "daemon/core/broker_link.hpp"
#include "daemon/core/gateway_actions.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw {

/// A thing that the gateway cannot do, and the lines of Mosquitto's access control list that allow
/// it.
struct MissingRight {
  std::string what;
  std::string grant;
  bool operator==(const MissingRight&) const = default;
};

class RightsProbe {
 public:
  /// The last level of the probe's topics. Robots may have commands of this type, too.
  static constexpr std::string_view level = "probe";
  /// A broker answers within milliseconds; a message that is not back after this time was blocked.
  static constexpr std::chrono::seconds patience{10};
  /// A missing right is probed again after this time: the access list may have been corrected.
  static constexpr std::chrono::seconds retry{60};

  /// `broker` and `actions` must outlive this object.
  RightsProbe(const TopicScheme& scheme, const BrokerLink& broker, GatewayActions& actions);

  void on_broker_link();
  /// Returns true for the answer to a subscription of the probe. Once that is granted, the probe
  /// publishes its message (QoS 0, not retained).
  bool on_subscribe_result(const std::string& filter, bool is_granted, const Now& now);
  /// Returns true for a message of the probe, which the caller drops.
  bool take(const BrokerMessage& message);
  /// Returns true for a message on a command topic, with this type, that the probe of any gateway
  /// has sent: it is not a command.
  static bool is_of_any_gateway(std::string_view type, const BrokerMessage& message);
  std::optional<TimePoint> deadline() const;
  void on_deadline(const Now& now);

  /// Returns an empty list while no right is known to be missing.
  std::vector<MissingRight> missing() const;

 private:
  enum class State : std::uint8_t { idle, waiting, heard, unheard };
  /// One probed topic.
  struct Place {
    std::string topic;
    MissingRight right;
    State state = State::idle;
    std::string nonce{};
    TimePoint sent{};  ///< when its message was sent, or its subscription was refused or renewed
  };

  Place* find(std::string_view topic);
  void ask(Place& place, const Now& now);
  void report_changes();

  const BrokerLink& broker_;
  GatewayActions& actions_;
  std::array<Place, 2> places_;  // under gateway/, under server/
  std::uint64_t asked_ = 0;
  std::vector<MissingRight> reported_;
};

}  // namespace slamgw
