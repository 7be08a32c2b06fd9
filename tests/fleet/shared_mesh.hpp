// SPDX-License-Identifier: Apache-2.0
// Gateways with a board each in one BLE mesh, in virtual time: every board hears every robot, as
// well as it is told to. Robots repeat an acknowledged message as reliable publish does. A gateway
// does what the BLE mesh's uplink does: passes on and acknowledges what it may serve, nothing else.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "daemon/fleet/ownership.hpp"
#include "tests/fleet/virtual_time.hpp"

namespace slamgw::fleet::test {

class SharedMesh : public VirtualTime {
 public:
  struct Options {
    std::uint32_t seed = 1;
    int gateways = 2;
    int robots = 4;
    double radio_loss = 0;   ///< of each message at each board, and of each STATUS
    double broker_loss = 0;  ///< of QoS 0 deliveries
    milliseconds most_delay{40};
  };

  explicit SharedMesh(Options options);
  ~SharedMesh();

  void kill(int gateway);
  void start(int gateway);
  void cut_link(int gateway);
  void restore_link(int gateway);
  /// A board that is not up tells its gateway so; a deaf one does not.
  void set_board(int gateway, bool is_up);
  void set_deaf(int gateway, bool is_deaf);
  void set_level(int gateway, int robot, int level_db);

  /// The gateways that may serve the robot now.
  std::vector<int> servers(int robot) const;
  /// How often a gateway became the robot's owner.
  int takeovers(int robot) const { return robots_[static_cast<std::size_t>(robot)].takeovers; }
  const Ownership& ownership(int gateway) const;

  struct Judgement {
    int messages = 0;  ///< acknowledged
    int lost = 0;      ///< acknowledged, and not at the broker
    int doubled = 0;   ///< copies too many at the broker
    int beyond = 0;    ///< of these, more than one for each time a gateway stopped serving a robot
    int two_owners = 0;      ///< messages that a second gateway could have served
    milliseconds longest{};  ///< from a message's first copy to its acknowledgement
  };
  Judgement judge() const;

 private:
  struct Node;
  struct Robot {
    std::uint64_t number = 0;
    bool is_open = false;
    milliseconds began{};
    int copies = 0;
    int takeovers = 0;
    int ends = 0;  ///< how often a gateway stopped serving it
    milliseconds longest{};
    std::map<std::uint64_t, int> arrived;
    std::set<std::uint64_t> acknowledged;
  };
  milliseconds delay();
  void say(int robot);
  void send_copy(int robot, std::uint64_t number);
  void hear(Node& node, int robot, std::uint64_t number);
  void serve(Node& node, int robot, std::uint64_t number);
  void take_over(Node& node, int robot);
  void give_up(int robot, std::uint64_t number);
  void on_status(int robot, std::uint64_t number);
  void forget(Node& node, int robot);
  void subscribe(Node& node, const std::string& filter);
  void input(Node& node, const std::function<void()>& change);
  void perform(Node& node, OwnershipAction& action);
  void publish(Node& node, const BrokerMessage& message);
  Now clock() const { return {TimePoint(std::chrono::hours(1) + now_), WallTime(now_)}; }
  static std::string name_of(int robot) { return "r" + std::to_string(robot); }

  Options options_;
  std::vector<std::unique_ptr<Node>> nodes_;
  std::vector<Robot> robots_;
  int two_owners_ = 0;
};

}  // namespace slamgw::fleet::test
