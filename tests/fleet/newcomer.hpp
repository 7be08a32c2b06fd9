// SPDX-License-Identifier: Apache-2.0
// A gateway that finds out who else is about, without a world around it.
#pragma once

#include <gtest/gtest.h>

#include "daemon/fleet/ownership.hpp"

namespace slamgw::fleet::test {

using namespace std::chrono_literals;

/// One gateway without a world around it.
class Newcomer : public testing::Test {
 protected:
  explicit Newcomer(bool were_others_about = false)
      : ownership({"p", "gw-0"}, {Enabled::automatic, process, were_others_about},
                  [this] { return local; }) {}
  static constexpr Life process = 0x10000;
  Now at(Duration after) const { return {TimePoint{} + 1h + after, {}}; }
  void command(Duration after) {
    ownership.on_command({"p/server/r/cmd", {}, Qos::at_least_once, false}, "r", "cmd", at(after));
  }
  void state_comes(const std::string& gateway, Duration after, bool retain = true) {
    ownership.on_broker_message({"p/gateway/" + gateway + "/state",
                                 to_bytes(R"({"state":"online"})"), Qos::at_least_once, retain},
                                at(after));
  }
  void states_answered(Duration after, SubscribeAnswer answer = SubscribeAnswer::granted) {
    ownership.on_subscribe_result("p/gateway/+/state", answer, at(after));
  }
  void others_answered(Duration after) {
    for (const char* filter :
         {"p/server/+/+", "p/fleet/all/+", "p/fleet/to/gw-0/+", "p/gateway/+/commands/+"})
      ownership.on_subscribe_result(filter, SubscribeAnswer::granted, at(after));
  }
  std::size_t carried_out() {
    std::size_t count = 0;
    while (const auto action = ownership.next_action())
      count += std::holds_alternative<CarryOut>(*action) ? 1 : 0;
    return count;
  }
  std::vector<LocalRobot> local;  ///< robots that it has
  Ownership ownership;
};

}  // namespace slamgw::fleet::test
