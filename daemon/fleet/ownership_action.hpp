// SPDX-License-Identifier: Apache-2.0
// What Ownership decides, for its shell to do.
#pragma once

#include <cstdint>
#include <string>
#include <variant>

#include "daemon/core/messages.hpp"
#include "daemon/fleet/claim.hpp"

namespace slamgw::fleet {

/// At the broker, now or never: nothing of it is of use later.
struct PublishNow {
  BrokerMessage message;
};
/// This gateway's retained `state`, once more.
struct AnnounceGateway {};
/// For Settings::were_others_about of the next process.
struct RememberOthers {
  bool are_about = false;
};
struct SubscribeFleet {
  std::string filter;
};
struct UnsubscribeFleet {
  std::string filter;
};
/// The robot is this gateway's from now on. `dead_owner`: may have left presence behind.
struct TakeOverRobot {
  std::string robot;
  std::string dead_owner;  ///< empty: it was nobody's, or its owner has made way
  Bytes session;           ///< what the former owner knew of it; may be empty
};
/// The robot is another gateway's: its session ends here without will, its presence is withdrawn.
/// Answered by on_given_up() with the session when `is_awaited`.
struct GiveUpRobot {
  std::string robot;
  Claim to;
  bool is_awaited = false;
};
struct CarryOut {
  BrokerMessage command;
};
struct EndCommand {
  std::string robot;
  std::string type;
  CommandResult result = CommandResult::refused;
  std::string why;
  Duration after{};  ///< since it came here; zero: it did not
};
/// As PublishNow; answered by on_outcome_acknowledged() or on_outcome_refused().
struct PublishOutcomeNow {
  std::uint64_t id = 0;
  BrokerMessage message;
};
/// Stored, if the broker is away.
struct PublishOutcome {
  BrokerMessage message;
};
struct PublishWill {
  Report will;
};

using OwnershipAction =
    std::variant<PublishNow, AnnounceGateway, RememberOthers, SubscribeFleet, UnsubscribeFleet,
                 TakeOverRobot, GiveUpRobot, CarryOut, EndCommand, PublishOutcomeNow,
                 PublishOutcome, PublishWill, Notice>;

}  // namespace slamgw::fleet
