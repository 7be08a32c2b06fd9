// SPDX-License-Identifier: Apache-2.0
// The core between a mesh and a broker that the test plays.
#pragma once

#include <gtest/gtest.h>

#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "daemon/core/gateway.hpp"

namespace slamgw::test {

inline bool is_of_rights_probe(const SubscribeAtBroker& subscribe) {
  return subscribe.filter.ends_with("/probe");
}

class GatewayRig : public testing::Test {
 protected:
  template <class Action>
  std::vector<Action> drain() {
    std::vector<Action> wanted;
    while (auto action = gateway.next_action()) {
      if (auto* it = std::get_if<Action>(&*action)) wanted.push_back(std::move(*it));
      auto* up = std::get_if<PassUp>(&*action);
      if constexpr (std::is_same_v<Action, Upload>)
        if (up) wanted.push_back(up->upload());
    }
    return wanted;
  }

  void say(MeshEvent event) { gateway.on_mesh_event(std::move(event), now); }
  void broker_is(bool up) {
    broker.is_up = up;
    broker.since = now.wall;
    gateway.on_broker_link(now);
  }
  void broker_comes() {
    broker_is(true);
    while (gateway.next_action()) {
    }
  }

  static Report update_from(const std::string& robot, Bytes payload) {
    return {Mesh::thread,
            robot,
            "ntnu-slam/robot/" + robot + "/update",
            std::move(payload),
            Qos::at_least_once,
            false,
            Receipt{Mesh::thread, 7}};
  }

  Now now{TimePoint{std::chrono::hours{1}}, WallTime{std::chrono::seconds{1'700'000'000}}};
  static constexpr std::size_t max_open_commands = 20;
  /// The presence that the meshes return for a robot.
  std::map<std::pair<Mesh, std::string>, Presence> reach;
  BrokerLink broker;
  Gateway gateway{TopicScheme("ntnu-slam", "pi1"),
                  {"0.1.0", UpdateMode::positions, now.wall, max_open_commands},
                  broker,
                  [this](Mesh mesh, const std::string& robot) -> std::optional<Presence> {
                    const auto known = reach.find({mesh, robot});
                    if (known == reach.end()) return std::nullopt;
                    return known->second;
                  }};
};

/// One of several gateways; the test plays the others.
class SharedGatewayRig : public GatewayRig {
 protected:
  void SetUp() override {
    gateway.set_places({[this](const std::string& robot) { return held.contains(robot); },
                        [this](const std::string& robot) { return elsewhere.contains(robot); },
                        [this](const std::string& robot) {
                          return held.contains(robot) || elsewhere.contains(robot) ||
                                 left.contains(robot);
                        },
                        [this](const std::string& robot) { return refused.contains(robot); },
                        [this] { return is_alone; },
                        [this](const std::string& robot, const std::string&) {
                          return !unsubscribed.contains(robot);
                        }});
  }
  void session_comes(const std::string& robot, bool was_present = true,
                     const std::string& dead_owner = {}) {
    held.insert(robot);
    gateway.on_session_held(robot, was_present, dead_owner, now);
  }
  void pass(Duration time) {
    now.mono += time;
    gateway.on_deadline(now);
  }
  /// Connects the broker and waits for the retained messages of other gateways.
  void broker_comes() {
    GatewayRig::broker_comes();
    pass(PresencePublisher::settling);
    while (gateway.next_action()) {
    }
  }

  std::set<std::string> held;       ///< robots whose sessions this gateway holds
  std::set<std::string> elsewhere;  ///< robots that another living gateway shows
  std::set<std::string> left;       ///< robots that a dead gateway shows
  std::set<std::string> refused;    ///< robots whose sessions the broker refuses
  /// Robots that have no subscription.
  std::set<std::string> unsubscribed;
  bool is_alone = false;
};

}  // namespace slamgw::test
