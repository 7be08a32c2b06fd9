// SPDX-License-Identifier: Apache-2.0
// The core between a mesh and a broker that the test plays.
#pragma once

#include <gtest/gtest.h>

#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "daemon/core/gateway.hpp"

namespace slamgw::test {

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
  /// What the meshes answer when they are asked for a robot.
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

}  // namespace slamgw::test
