// SPDX-License-Identifier: Apache-2.0
// Finds out whether the broker's access list gives this gateway the rights that it needs. A broker
// may grant a subscription and send nothing (Mosquitto does, without the right to read), or take a
// message and drop it silently. So at each connect the gateway sends messages to itself, one where
// it publishes and one where commands come from, and waits for both. Pure; driven by Gateway.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "daemon/core/messages.hpp"
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
  /// The last level of the probe's topics; not a command for a robot.
  static constexpr std::string_view level = "probe";
  /// A broker answers within milliseconds; a message that is not back after this time was blocked.
  static constexpr std::chrono::seconds patience{10};
  /// A missing right is probed again after this time: the access list may have been corrected.
  static constexpr std::chrono::seconds retry{60};

  explicit RightsProbe(const TopicScheme& scheme);

  /// Returns the filters to subscribe to at each connect.
  std::vector<std::string> filters() const;
  bool is_own(const std::string& filter) const;
  /// Call at each change of the link. `is_probing`: the broker is online, and the configuration
  /// wants to probe.
  void on_broker_link(bool is_probing);
  /// Takes the broker's answer for one of the filters. Returns the message to publish now (QoS 0,
  /// not retained).
  std::optional<BrokerMessage> on_subscribe_result(const std::string& filter, bool granted,
                                                   const Now& now);
  /// Returns true for a message of the probe, which the caller drops.
  bool take(const BrokerMessage& message);
  std::optional<TimePoint> deadline() const;
  /// Call at the deadline; may be called at any time. Returns the messages to publish again.
  std::vector<BrokerMessage> on_tick(const Now& now);

  /// Returns an empty list while no right is known to be missing.
  std::vector<MissingRight> missing() const;
  /// Returns a line for the log when the missing rights have changed since the last call.
  std::optional<Notice> next_notice();

 private:
  enum class State : std::uint8_t { idle, waiting, heard, unheard };
  /// One probed topic.
  struct Place {
    std::string topic;
    MissingRight right;
    State state = State::idle;
    std::string nonce{};
    TimePoint sent{};
  };

  BrokerMessage ask(Place& place, const Now& now);

  std::array<Place, 2> places_;  // under gateway/, under server/
  bool is_probing_ = false;      ///< the broker is online, and the configuration wants to probe
  std::uint64_t asked_ = 0;
  std::vector<MissingRight> reported_;
};

}  // namespace slamgw
