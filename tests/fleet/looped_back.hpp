// SPDX-License-Identifier: Apache-2.0
// A member of a fleet that hears itself, for tests of what it says and of what is lost.
#pragma once

#include <map>
#include <string>
#include <variant>
#include <vector>

#include "tests/fleet/newcomer.hpp"

namespace slamgw::fleet::test {

/// A gateway whose robot is "r", and a broker that gives back what it writes, or loses it.
class LoopedBack : public Newcomer {
 protected:
  using Newcomer::Newcomer;
  void SetUp() override {
    ownership.on_broker_link(true, at(0s));
    states_answered(0s);
    state_comes("gw-1", 0s);
    pass(4s);
    ownership.on_heard("r", at(now));
    pass(1s);
    ASSERT_TRUE(ownership.may_act_for("r", at(now).mono));
  }
  void pass(Duration span) {
    for (const Duration end = now + span; now < end; now += 10ms) {
      while (auto action = ownership.next_action())
        std::visit([&](auto& what) { take(what); }, *action);
      ownership.on_deadline(at(now));
    }
  }
  template <class Action>
  void take(Action&) {}
  void take(SubscribeFleet& action) {
    if (answers) ownership.on_subscribe_result(action.filter, SubscribeAnswer::granted, at(now));
  }
  void take(TakeOverRobot& action) { dead_owners[action.robot] = action.dead_owner; }
  void take(GiveUpRobot& action) { given_up.push_back(action.robot); }
  void take(CarryOut& action) {
    ++carried;
    waited = action.command.waited;
  }
  void take(EndCommand& action) { ends.push_back(action); }
  void take(PublishOutcomeNow& action) {
    ++told;
    ownership.on_outcome_acknowledged(action.id);
  }
  void take(PublishOutcome&) { ++told; }
  void take(PublishWill&) { ++wills; }
  void take(Notice& notice) { notices.push_back(notice); }
  void take(AnnounceGateway&) { ++greetings; }
  void take(RememberOthers& action) { remembered.push_back(action.are_about); }
  void take(PublishNow& action) {
    if (action.message.topic.find("/robots/") != std::string::npos) {
      EXPECT_TRUE(action.message.retain && action.message.payload.empty());
      return withdrawn.push_back(action.message.topic);
    }
    const auto message = decode("gw-0", action.message.payload);
    ASSERT_TRUE(message);
    const auto* taken = std::get_if<Taken>(&message->body);
    if (taken) said.push_back(*taken);
    if (const auto* release = std::get_if<Release>(&message->body)) releases.push_back(*release);
    if (std::holds_alternative<Heard>(message->body)) answered.push_back(action.message.topic);
    if (const auto* claim = std::get_if<ClaimRobot>(&message->body)) {
      claims.push_back(*claim);
      claims_qos.push_back(action.message.qos);
    }
    if (!is_writing_lost && (!taken || said.size() > lost))
      ownership.on_broker_message(action.message, at(now));
  }
  /// In a life that hears the others for so long, and has missed nothing.
  void beat_of_gw_1(std::uint64_t up_ms) { beat_of_gw_1(up_ms, up_ms); }
  void beat_of_gw_1(std::uint64_t up_ms, std::uint64_t gapless_ms) {
    const auto sent_ms = std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
    ownership.on_fleet_message({"gw-1", 0x20001, Beat{sent_ms, 60'000, 0, 0, up_ms, gapless_ms}},
                               at(now));
  }
  void comes_from_gw_1(const Body& body) {
    ownership.on_fleet_message({"gw-1", 0x20001, body}, at(now));
  }
  /// It notices that it was away, and gets a command that came before it hears the others.
  void come_back_to_a_command() {
    now += 40s;
    pass(10ms);
    ownership.on_command({"p/server/other/cmd", {}, Qos::at_least_once, false}, "other", "cmd",
                         at(now - 10ms));
  }
  Duration now{};
  bool answers = true;  ///< the broker, to subscriptions
  bool is_writing_lost = false;
  std::size_t lost = 0;  ///< that many of what it takes
  std::vector<Taken> said;
  std::vector<ClaimRobot> claims;
  std::vector<Qos> claims_qos;
  std::vector<Release> releases;
  std::vector<std::string> answered;  ///< where it has said that it has heard a robot
  std::vector<std::string> given_up;
  std::map<std::string, std::string> dead_owners;  ///< of robots that it has taken over
  std::vector<EndCommand> ends;
  std::vector<std::string> withdrawn;  ///< entries of robots at other gateways
  std::vector<Notice> notices;
  std::vector<bool> remembered;  ///< for the next process: whether others are about
  int carried = 0;
  Duration waited{};  ///< the last one of them
  int told = 0;
  int wills = 0;
  int greetings = 0;
  std::uint64_t taken_ = 0;
};

}  // namespace slamgw::fleet::test
