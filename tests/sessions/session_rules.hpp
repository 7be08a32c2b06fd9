// SPDX-License-Identifier: Apache-2.0
// One gateway's sessions, step by step. The test plays the broker.
#pragma once

#include <gtest/gtest.h>

#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "daemon/sessions/robot_sessions.hpp"

namespace slamgw::sessions {

using std::chrono::milliseconds;
using std::chrono::seconds;

inline const std::string mailbox = "ntnu-slam/fleet/robots/r1/waiting";
inline const std::string note_topic = "ntnu-slam/fleet/robots/r1";
inline const std::string all_commands = "ntnu-slam/server/r1/+";

class RobotSessionRules : public testing::Test {
 protected:
  /// Removes all actions and returns those of one kind.
  template <class Action>
  std::vector<Action> drain() {
    std::vector<Action> wanted;
    while (auto action = sessions.next_action())
      if (auto* it = std::get_if<Action>(&*action)) wanted.push_back(std::move(*it));
    return wanted;
  }
  void forget_actions() {
    while (sessions.next_action()) {
    }
  }
  void attach(bool is_present = false) {
    sessions.on_heard("r1", now);
    sessions.on_attached("r1", is_present, now);
    forget_actions();
  }
  void pass(Duration time) {
    now.mono += time;
    sessions.on_deadline(now);
  }
  static BrokerMessage command(const std::string& payload, Qos qos = Qos::at_least_once) {
    return {"ntnu-slam/server/r1/run", to_bytes(payload), qos, false};
  }
  void arrives(BrokerMessage message, std::vector<std::uint32_t> ids = {}) {
    sessions.on_message("r1", std::move(message), ids, now);
  }
  void subscribe(const std::string& filter, Qos qos = Qos::at_least_once) {
    sessions.subscribe("r1", filter, qos, /*is_standing=*/false, now);
  }
  void resume(const std::string& filter, Qos qos = Qos::at_least_once) {
    sessions.subscribe("r1", filter, qos, /*is_standing=*/true, now);
  }
  void grants(const std::string& filter, bool is_granted = true) {
    sessions.on_subscribed("r1", filter, is_granted, now);
  }
  /// Returns the identifier that the session gives to a filter of the robot.
  std::uint32_t subscribed_id(const std::string& filter) {
    subscribe(filter);
    std::uint32_t id = 0;
    for (const auto& each : drain<SubscribeSession>())
      if (each.filter == filter) id = each.id;
    grants(filter);
    forget_actions();
    return id;
  }
  /// Answers all fences so far and returns the messages that are taken.
  std::vector<TakeMessage> fenced() {
    std::vector<TakeMessage> taken;
    for (std::uint64_t last = 1; last > 0;) {
      last = 0;
      while (auto action = sessions.next_action()) {
        if (const auto* fence = std::get_if<AskFence>(&*action)) last = fence->number;
        if (auto* take = std::get_if<TakeMessage>(&*action)) taken.push_back(std::move(*take));
      }
      if (last > 0) sessions.on_fence("r1", last, now);
    }
    return taken;
  }
  std::vector<std::string> subscribed() {
    std::vector<std::string> filters;
    for (const auto& each : drain<SubscribeSession>()) filters.push_back(each.filter);
    return filters;
  }

  Now now{TimePoint{std::chrono::hours{1}}, WallTime{}};
  bool is_served_elsewhere = false;
  RobotSessions sessions{SessionNames(TopicScheme("ntnu-slam", "pi1")),
                         [this](const std::string&) { return is_served_elsewhere; },
                         TimePoint{std::chrono::hours{1}}, 50};
};

class RobotSessionRulesUp : public RobotSessionRules {
 protected:
  RobotSessionRulesUp() { sessions.on_broker_up(/*is_v5=*/true, /*is_other=*/false, now); }
};

class RobotSessionRules311 : public RobotSessionRules {
 protected:
  RobotSessionRules311() { sessions.on_broker_up(/*is_v5=*/false, /*is_other=*/false, now); }
};

}  // namespace slamgw::sessions
