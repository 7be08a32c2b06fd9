// SPDX-License-Identifier: Apache-2.0
// Gateways, robots that roam and a broker in virtual time: messages are late, doubled and in
// another order for each reader; gateways are paused, killed and cut off. Keeps count of what a
// user would notice.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "daemon/fleet/ownership.hpp"
#include "tests/fleet/virtual_time.hpp"

namespace slamgw::fleet::test {

class FleetWorld : public VirtualTime {
 public:
  struct Options {
    std::uint32_t seed = 1;
    int gateways = 4;
    int robots = 12;
    milliseconds least_delay{1};
    milliseconds most_delay{40};
    double doubled = 0.05;  ///< of QoS 1 deliveries
    double lost = 0.02;     ///< of QoS 0 deliveries
    Enabled enabled = Enabled::yes;
    bool has_unique_types = false;  ///< each command is of a type of its own
    /// The broker keeps what it has for a gateway whose connection is down, but for QoS 0. Else it
    /// forgets the gateway, which has to subscribe again.
    bool keeps_sessions = false;
    /// The broker takes a gateway's subscriptions one after the other, each in this time, and some
    /// in ten times of it (NATS).
    milliseconds subscribing{0};
  };
  /// What a user would notice; each 0 when all is well.
  struct Judgement {
    int doubled_commands = 0;   ///< went on the air twice
    int doubled_outcomes = 0;   ///< two different ones
    int repeated_outcomes = 0;  ///< word for word: the connection broke before the broker's answer
    int missing_outcomes = 0;   ///< of commands that a gateway has heard
    int unheard_commands = 0;   ///< which came while no gateway was there
    int false_wills = 0;
    int missing_wills = 0;
    int two_owners = 0;        ///< looks at which two gateways could act for one robot
    int two_online = 0;        ///< times that a robot was `online` at two gateways for 2 s
    int without_owner = 0;     ///< robots, at the end
    int strange_presence = 0;  ///< robots whose retained presence is not one `online`, at the end
    int lost_sessions = 0;     ///< robots whose session is not where they are, at the end
  };

  explicit FleetWorld(Options options);
  ~FleetWorld();

  void roam(int robot, int gateway);
  /// It says nothing any more.
  void silence(int robot);
  void command(int robot);
  void pause(int gateway);
  void resume(int gateway);
  void kill(int gateway);
  void start(int gateway);
  void cut_link(int gateway);
  void restore_link(int gateway);
  /// Gateways of different sides do not hear each other; the broker's nodes are apart.
  void set_side(int gateway, int side);
  static std::string robot_name(int robot);
  /// Octets in the name of any gateway.
  void forge(const std::string& topic, const std::string& payload);

  /// From now on.
  void lose_nothing() { options_.lost = 0; }
  /// The broker takes nothing under fleet/ from now on, and says nothing.
  void forbid_fleet() { is_fleet_forbidden_ = true; }

  int gateways() const { return static_cast<int>(nodes_.size()); }
  int robots() const { return static_cast<int>(robots_.size()); }
  int place_of(int robot) const { return robots_[static_cast<std::size_t>(robot)].at; }
  /// The gateways that could act for it now.
  std::vector<int> actors(int robot) const;
  Judgement judge() const;
  Ownership& ownership(int gateway);
  std::uint64_t published() const { return published_; }
  std::uint64_t published_by_kind(const std::string& kind) const {
    const auto found = kinds_.find(kind);
    return found == kinds_.end() ? 0 : found->second;
  }
  std::chrono::milliseconds now() const { return now_; }
  std::string describe() const;
  /// Whether the gateway where the robot is has what the first one knew of it.
  bool has_session(int robot) const;
  bool is_trusted = true;  ///< false while two sides are apart: both may act

 private:
  struct Node;
  struct Robot {
    int at = 0;
    bool is_alive = true;
    milliseconds last_said{-1};
    unsigned said = 0;  ///< messages; presence is said again with some, as the core does
    std::uint64_t wills = 0;
    std::uint64_t visit = 0;
    std::optional<milliseconds> two_online;  ///< since when it is `online` at two gateways
  };
  struct Command {
    int robot = 0;
    milliseconds said{};
    bool was_heard = false;  ///< by any gateway
    milliseconds came{};     ///< to the gateway that carried it out
    int on_air = 0;
    int outcomes = 0;
    std::string outcome;  ///< the last one, and who has told it
    int promised = 0;     ///< ends of which only the robot and the type are known
  };
  milliseconds random_delay();
  void speak(int robot, std::uint64_t visit);
  void look();
  void look_at_presence();
  std::vector<int> online_at(int robot) const;
  void to_gateway(int gateway, std::function<void(Node&)> input);
  void input(int gateway, const std::function<void(Node&)>& change);
  void drain(int gateway);
  void arm(int gateway);
  void perform(int gateway, PublishNow& action);
  void perform(int gateway, AnnounceGateway&) { say_online(gateway); }
  void perform(int gateway, RememberOthers& action) {
    remembers_others_[gateway] = action.are_about;
  }
  void perform(int gateway, SubscribeFleet& action);
  void perform(int gateway, UnsubscribeFleet& action);
  void perform(int gateway, TakeOverRobot& action);
  void perform(int gateway, GiveUpRobot& action);
  void perform(int gateway, CarryOut& action);
  void perform(int gateway, EndCommand& action);
  void perform(int gateway, PublishOutcomeNow& action);
  void perform(int gateway, PublishOutcome& action) { publish_stored(gateway, action.message); }
  void perform(int gateway, PublishWill& action);
  void perform(int gateway, Notice& action);
  void publish(int from, const BrokerMessage& message);
  void say_online(int gateway) {
    publish(gateway, {"p/gateway/" + gateway_name(gateway) + "/state",
                      to_bytes(R"({"state":"online"})"), Qos::at_least_once, true});
  }
  void publish_stored(int gateway, const BrokerMessage& message);
  void deliver(int from, int to, const BrokerMessage& message);
  void subscribe(int gateway, const std::string& filter);
  void stand(int gateway, const std::string& filter);
  void arrive(int gateway, const BrokerMessage& message);
  void count_outcome(int gateway, const BrokerMessage& message);
  void end_command(int gateway, const std::string& robot, const std::string& id,
                   const std::string& why, Duration after);
  void supervise(int gateway);
  void withdraw_leftovers(int gateway);
  std::string type_of(std::size_t command) const;
  static int robot_number(const std::string& name);
  static std::string gateway_name(int gateway);
  Now clock_of(const Node& node) const;

  Options options_;
  std::vector<std::unique_ptr<Node>> nodes_;
  std::map<int, bool> remembers_others_;  ///< gateway: over its processes
  std::vector<Robot> robots_;
  std::vector<Command> commands_;
  std::map<std::pair<int, int>, milliseconds> last_delivery_;  // one writer's messages keep order
  std::map<std::string, BrokerMessage> retained_;
  std::uint64_t published_ = 0;
  bool is_fleet_forbidden_ = false;
  std::map<std::string, std::uint64_t> kinds_;
  Judgement seen_;
  std::vector<std::string> story_;
};

}  // namespace slamgw::fleet::test
