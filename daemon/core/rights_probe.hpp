// SPDX-License-Identifier: Apache-2.0
// Whether the broker lets this gateway do what it must. A broker may grant a subscription and send
// nothing (Mosquitto does, when the access list has no right to read), or take a message and drop
// it, and say nothing. So at each connect the gateway says something to itself where it publishes
// and where commands come from, and listens for it. Pure; driven by Gateway.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw {

/// What the gateway cannot do, and the lines of Mosquitto's access control list that allow it.
struct MissingRight {
  std::string what;
  std::string grant;
  bool operator==(const MissingRight&) const = default;
};

class RightsProbe {
 public:
  /// The last level of its topics; no robot's command.
  static constexpr std::string_view level = "probe";
  /// A broker answers within milliseconds; a message that was not back by then was not let through.
  static constexpr std::chrono::seconds patience{10};
  /// While something is missing it is tried again: an access list may be corrected meanwhile.
  static constexpr std::chrono::seconds retry{60};

  explicit RightsProbe(const TopicScheme& scheme);

  /// To be subscribed at each connect.
  std::vector<std::string> filters() const;
  bool is_own(const std::string& filter) const;
  void on_broker_link(bool is_up);
  /// The broker's answer for one of the filters; what is to be published now (QoS 0, not retained).
  std::optional<BrokerMessage> on_subscribe_result(const std::string& filter, bool granted,
                                                   const Now& now);
  /// How many copies of the newest message under `server/` have come back; nothing while none has.
  /// They come in a row. A broker that sends several has sent one for each subscription.
  std::optional<unsigned> copies() const { return copies_; }
  /// True when the message is one of the probe's; the caller drops it.
  bool take(const BrokerMessage& message, TimePoint now);
  std::optional<TimePoint> deadline() const;
  /// At the deadline, or any time. What is to be published again.
  std::vector<BrokerMessage> on_tick(const Now& now);

  /// Empty while nothing is known to be missing.
  std::vector<MissingRight> missing() const;
  /// How long the last message was on its way to the broker and back.
  std::optional<Duration> round_trip() const { return round_trip_; }
  /// When what is missing has changed since the last call: a line for the log.
  std::optional<Notice> next_notice();

 private:
  enum class State : std::uint8_t { idle, waiting, heard, unheard };
  /// One place to talk to itself.
  struct Place {
    std::string topic;
    MissingRight right;
    State state = State::idle;
    std::string nonce{};
    TimePoint sent{};
  };

  BrokerMessage ask(Place& place, const Now& now);
  void count_copies(const Place& place, std::string_view said);

  std::array<Place, 2> places_;  // under gateway/, under server/
  bool is_broker_up_ = false;
  std::uint64_t asked_ = 0;
  std::string heard_under_server_;
  std::optional<unsigned> copies_;
  std::optional<Duration> round_trip_;
  std::vector<MissingRight> told_;
};

}  // namespace slamgw
