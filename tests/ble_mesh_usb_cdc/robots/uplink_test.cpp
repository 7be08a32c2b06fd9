// SPDX-License-Identifier: Apache-2.0
// Messages of robots: reports, receipts, STATUS and presence.
#include <gtest/gtest.h>

#include "tests/ble_mesh_usb_cdc/mesh_rig.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

class Uplink : public ::testing::Test {
 protected:
  explicit Uplink(Settings settings = {}) : rig(std::move(settings)) { rig.start(); }

  std::vector<std::string> statuses() {
    rig.run_for(20ms);
    return rig.sent_to(first_robot);
  }

  MeshRig rig;
};

TEST_F(Uplink, ReportsASetWithAReceiptAndAnswersWhenItIsSafe) {
  rig.hear(first_robot, update_set, 0xc003);
  const auto reports = rig.all<Report>();
  ASSERT_EQ(reports.size(), 1u);
  EXPECT_EQ(reports[0].robot, "nr1");
  EXPECT_EQ(reports[0].topic, "ntnu-slam/robot/nr1/update");
  EXPECT_EQ(reports[0].payload, hex("0a 00 ec ff"));
  EXPECT_EQ(reports[0].qos, Qos::at_least_once);
  EXPECT_FALSE(reports[0].retain);
  EXPECT_TRUE(reports[0].receipt.is_owed());
  EXPECT_TRUE(statuses().empty());
  rig.receipt(reports[0].receipt.id);
  EXPECT_EQ(statuses(), std::vector<std::string>{"cc590000"});
  EXPECT_EQ(rig.board.sent.at(0).ttl, 4);
}

TEST_F(Uplink, NamesTypesByModel) {
  rig.hear(first_robot, "c7 59 00 01");
  rig.hear(first_robot, "cb 59 00 01");
  rig.hear(first_robot, "cf 59 00 01");
  const auto reports = rig.all<Report>();
  ASSERT_EQ(reports.size(), 3u);
  EXPECT_EQ(reports[0].topic, "ntnu-slam/robot/nr1/adv");
  EXPECT_EQ(reports[1].topic, "ntnu-slam/robot/nr1/update");
  EXPECT_EQ(reports[2].topic, "ntnu-slam/robot/nr1/cmd");
}

TEST_F(Uplink, PublishesAllUnreliableMessagesWithoutAcknowledgement) {
  for (int i = 0; i < 3; ++i) rig.hear(first_robot, "cb 59 00 0a 00 ec ff");
  const auto reports = rig.all<Report>();
  ASSERT_EQ(reports.size(), 3u);
  EXPECT_FALSE(reports[0].receipt.is_owed());
  EXPECT_EQ(reports[0].qos, Qos::at_least_once);
  EXPECT_TRUE(statuses().empty());
}

TEST_F(Uplink, PublishesRepeatsOnceAndAnswersThemAgain) {
  constexpr std::string_view greeting = "c5 59 00 68 69";
  rig.hear(first_robot, greeting);
  rig.run_for(280ms);
  rig.hear(first_robot, greeting);  // before the receipt: no answer
  EXPECT_EQ(rig.all<Report>().size(), 1u);
  rig.receipt(1);
  EXPECT_EQ(statuses().size(), 1u);
  rig.run_for(260ms);  // iv after the last copy: the STATUS was lost
  rig.hear(first_robot, greeting);
  EXPECT_EQ(statuses().size(), 2u);
  EXPECT_EQ(rig.all<Report>().size(), 1u);
}

TEST_F(Uplink, TracesRepeatsAlwaysAndOtherStepsOnRequest) {
  rig.hear(first_robot, "d2 59 00 07 0a 00 ec ff");
  rig.hear(first_robot, "d2 59 00 07 0a 00 ec ff");
  rig.receipt(1);
  auto steps = rig.all<MessageStep>();
  ASSERT_EQ(steps.size(), 1u);
  EXPECT_EQ(steps[0].kind, StepKind::repeat);
  EXPECT_EQ(steps[0].topic, "ntnu-slam/robot/nr1/update");
  EXPECT_EQ(steps[0].wire.message_id, 7);
  EXPECT_TRUE(steps[0].radio);
  EXPECT_EQ(rig.all<Report>()[0].wire.message_id, 7);

  rig.mesh.on_trace(true);
  rig.hear(first_robot, "d2 59 00 08 0a 00 ec ff");
  rig.receipt(2);
  rig.hear(first_robot, "d2 59 00 09 0a 00 ec ff");
  rig.receipt(3, ReceiptOutcome::refused);
  rig.command("nr1/cmd", hex("01 00 02 00"));
  rig.run_for(2s);
  steps = rig.all<MessageStep>();
  ASSERT_GE(steps.size(), 5u);
  EXPECT_EQ(steps[1].kind, StepKind::acknowledged);
  EXPECT_EQ(steps[1].receipt, (Receipt{Mesh::ble, 2}));
  EXPECT_EQ(steps[2].kind, StepKind::refused);
  EXPECT_EQ(steps[3].kind, StepKind::sent);
  EXPECT_EQ(steps[3].topic, "ntnu-slam/server/nr1/cmd");
  EXPECT_EQ(steps[3].wire.is_dup, false);
  EXPECT_FALSE(steps[3].bytes) << "the trace knows the payload's size";
  EXPECT_EQ(steps[4].wire.is_dup, true);
  EXPECT_EQ(steps[4].command, steps[3].command);
}

TEST_F(Uplink, PublishesDoubtfulUpdateTwiceRatherThanNever) {
  rig.hear(first_robot, update_set);
  rig.receipt(1);
  rig.run_for(280ms);
  rig.hear(first_robot, update_set);
  EXPECT_EQ(rig.all<Report>().size(), 2u);
  rig.receipt(2);
  EXPECT_EQ(statuses().size(), 2u);
}

TEST_F(Uplink, PublishesRepeatedUpdateOnceWhenPeriodIsKnown) {
  for (std::uint64_t i = 1; i <= 20; ++i) {
    rig.hear(first_robot, "c9 59 00 " + to_hex(Bytes{static_cast<std::uint8_t>(i), 0, 0, 0}));
    rig.receipt(i);
    rig.run_for(i < 20 ? 200ms : 280ms);
  }
  rig.hear(first_robot, "c9 59 00 14 00 00 00");
  EXPECT_EQ(rig.all<Report>().size(), 20u);
  EXPECT_EQ(statuses().size(), 21u);
}

TEST_F(Uplink, PublishesMessagesWronglyTakenForRepeatsLater) {
  for (std::uint64_t i = 1; i <= 8; ++i) {
    rig.hear(first_robot, "c5 59 00 68 69");
    rig.receipt(rig.all<Report>().back().receipt.id);
    rig.run_for(280ms);
  }
  EXPECT_EQ(rig.sent_to(first_robot).size(), 8u);
  EXPECT_EQ(rig.all<Report>().size(), 8u);
}

TEST_F(Uplink, TransactionNumberDistinguishesNewMessagesFromRepeats) {
  rig.hear(first_robot, "d2 59 00 07 0a 00 ec ff");
  rig.receipt(1);
  EXPECT_EQ(statuses().back(), "cc59000007");
  rig.run_for(260ms);
  rig.hear(first_robot, "d2 59 00 08 0a 00 ec ff");  // at the time of a repeat
  rig.receipt(2);
  EXPECT_EQ(statuses().back(), "cc59000008");
  rig.run_for(180ms);
  rig.hear(first_robot, "d2 59 00 08 0a 00 ec ff");  // at the robot's own period
  EXPECT_EQ(statuses().size(), 3u);
  const auto reports = rig.all<Report>();
  ASSERT_EQ(reports.size(), 2u);
  EXPECT_EQ(reports[1].topic, "ntnu-slam/robot/nr1/update");
  EXPECT_EQ(reports[1].payload, hex("0a 00 ec ff"));
  rig.hear(first_robot, "d2 59 00");
  EXPECT_EQ(rig.counter("rejected"), 1u);
}

TEST_F(Uplink, PublishesAllEqualSetsOfStandingRobot) {
  for (const auto period : {200ms, 280ms, 294ms, 559ms, 1000ms}) {
    const std::size_t before = rig.all<Report>().size();
    for (int i = 0; i < 60; ++i) {
      rig.hear(first_robot, update_set);
      rig.receipt(rig.all<Report>().back().receipt.id);
      rig.run_for(period);
    }
    EXPECT_EQ(rig.all<Report>().size(), before + 60) << period.count();
    EXPECT_EQ(rig.sent_to(first_robot).size(), before + 60);
  }
}

TEST_F(Uplink, PublishesRefusedMessageAgainWithoutAcknowledgement) {
  rig.hear(first_robot, update_set);
  rig.receipt(1, ReceiptOutcome::refused);
  EXPECT_TRUE(statuses().empty());
  rig.run_for(260ms);
  rig.hear(first_robot, update_set);
  ASSERT_EQ(rig.all<Report>().size(), 2u);
  rig.receipt(2);
  EXPECT_EQ(statuses().size(), 1u);
}

TEST_F(Uplink, ALateReceiptDoesNotAcknowledgeANewerMessage) {
  rig.hear(first_robot, update_set);
  rig.hear(first_robot, "c9 59 00 0b 00 ec ff");
  rig.receipt(1);
  EXPECT_TRUE(statuses().empty());
  rig.receipt(2);
  EXPECT_EQ(statuses().size(), 1u);
}

TEST_F(Uplink, AcknowledgesEachModelByItsOwnReceipt) {
  rig.hear(first_robot, update_set);
  rig.hear(first_robot, "c5 59 00 68 69");
  rig.receipt(1);
  rig.receipt(2);
  EXPECT_EQ(statuses(), (std::vector<std::string>{"cc590000", "c8590000"}));
}

TEST_F(Uplink, GetIsAnsweredAtOnce) {
  rig.hear(first_robot, "ca 59 00");
  EXPECT_EQ(statuses(), std::vector<std::string>{"cc590000"});
  EXPECT_TRUE(rig.all<Report>().empty());
}

TEST_F(Uplink, RejectsMessagesThatBoardTruncated) {
  Bytes event = rig.board.message(first_robot, hex(update_set));
  event[19] = 0xf0;  // actual length, low octet
  rig.say(event);
  EXPECT_TRUE(rig.all<Report>().empty());
  EXPECT_EQ(rig.counter("rejected"), 1u);
  EXPECT_TRUE(rig.has_notice("cut it short"));
}

/// Returns true if the robot's last presence change marks it as deaf.
bool is_deaf(const MeshRig& rig, std::string_view robot) {
  bool is_deaf = false;
  for (const PresenceChange& change : rig.all<PresenceChange>())
    if (change.robot == robot) is_deaf = change.is_deaf;
  return is_deaf;
}

/// Sends a robot's SET and its repeats, each answered, until the robot gives up.
void repeat_answered(MeshRig& rig, std::uint16_t robot, std::string_view set) {
  Duration gap = 280ms;
  rig.hear(robot, set);
  for (int copy = 1; copy <= 6; ++copy) {
    if (const auto reports = rig.all<Report>(); !reports.empty())
      rig.receipt(reports.back().receipt.id);
    rig.run_for(gap);
    if (copy > 1) gap *= 2;
    rig.hear(robot, set);
  }
  if (const auto reports = rig.all<Report>(); !reports.empty())
    rig.receipt(reports.back().receipt.id);
  rig.run_for(1s);
}

TEST_F(Uplink, RobotThatRepeatsAnsweredMessagesIsDeaf) {
  for (const auto set : {"c5 59 00 68 69", "c9 59 00 0a 00 ec ff", "d2 59 00 07 0a 00"}) {
    MeshRig fresh;
    fresh.start();
    repeat_answered(fresh, first_robot, set);
    EXPECT_TRUE(is_deaf(fresh, "nr1")) << set;
    EXPECT_EQ(fresh.all<PresenceChange>().back().presence, Presence::online)
        << "the state stays online";
    EXPECT_EQ(fresh.counter("robots_deaf"), 1u);
  }
}

TEST_F(Uplink, DeafRobotHearsAgainWhenItSendsItsNextMessage) {
  repeat_answered(rig, first_robot, "c5 59 00 68 69");
  rig.run_for(12s);
  rig.hear(first_robot, "c5 59 00 68 70");  // the robot gave up the last message
  EXPECT_TRUE(is_deaf(rig, "nr1"));
  rig.receipt(rig.all<Report>().back().receipt.id);
  rig.run_for(1s);
  rig.hear(first_robot, "c5 59 00 68 71");
  EXPECT_FALSE(is_deaf(rig, "nr1"));
  EXPECT_EQ(rig.all<PresenceChange>().size(), 3u);
}

TEST_F(Uplink, ADeafRobotHearsAgainWhenItAnswersACommand) {
  repeat_answered(rig, first_robot, "c5 59 00 68 69");
  rig.command("nr1/cmd", hex("01 00 02 00"));
  rig.run_for(50ms);
  rig.hear(first_robot, "d0 59 00 00");
  EXPECT_FALSE(is_deaf(rig, "nr1"));
}

TEST_F(Uplink, CommandThatDeafRobotDoesNotAnswerNamesReason) {
  repeat_answered(rig, first_robot, "c5 59 00 68 69");
  rig.command("nr1/cmd", hex("01 00 02 00"));
  rig.run_for(20s);
  rig.hear(first_robot, "c7 59 00 01");  // the robot is still online
  rig.run_for(10s);
  ASSERT_EQ(rig.all<CommandOutcome>().size(), 1u);
  EXPECT_EQ(rig.all<CommandOutcome>()[0].why,
            "the robot did not answer; it does not hear the gateway");
}

TEST_F(Uplink, DeafRobotThatFallsSilentGoesOffline) {
  repeat_answered(rig, first_robot, "c5 59 00 68 69");
  rig.run_for(60s);
  EXPECT_EQ(rig.all<PresenceChange>().back().presence, Presence::offline);
  EXPECT_FALSE(is_deaf(rig, "nr1"));
  EXPECT_EQ(rig.counter("robots_deaf"), 0u);
}

TEST_F(Uplink, ReportsOnceWhenMostRobotsHearNothing) {
  const std::string_view set = "c5 59 00 68 69";
  rig.run_for(BleMesh::address_suspected_for);  // later than this, no other address is tried
  rig.hear(0x0203, set);                        // a third robot, which is not deaf
  repeat_answered(rig, 0x0201, set);
  EXPECT_EQ(rig.counter("mostly_deaf"), 0u) << "one robot can have a fault of its own";
  repeat_answered(rig, 0x0202, set);
  EXPECT_EQ(rig.counter("mostly_deaf"), 1u);
  EXPECT_EQ(rig.count_notices("2 of 3 robots do not hear the gateway"), 1);
  for (const auto next : {"c5 59 00 01", "c5 59 00 02"}) {
    rig.hear(0x0201, next);
    rig.receipt(rig.all<Report>().back().receipt.id);
    rig.run_for(1s);
  }
  EXPECT_EQ(rig.counter("mostly_deaf"), 0u);
  EXPECT_TRUE(rig.has_notice("most robots hear the gateway again"));
}

TEST_F(Uplink, RejectsSourcesThatAreNotUnicastAddresses) {
  rig.hear(0xc003, update_set);
  rig.hear(0x0000, update_set);
  EXPECT_EQ(rig.counter("rejected"), 2u);
  EXPECT_TRUE(rig.all<PresenceChange>().empty());
  EXPECT_EQ(rig.count_notices("rejected"), 1) << "once per burst";
}

TEST_F(Uplink, CountsOpcodesOfOtherModels) {
  rig.hear(first_robot, "82 31 00");
  rig.hear(first_robot, "7f");
  EXPECT_EQ(rig.counter("unknown_opcodes"), 1u);
  EXPECT_EQ(rig.counter("rejected"), 1u);
}

TEST_F(Uplink, ARobotIsOnlineWhileItIsHeard) {
  rig.hear(first_robot, "04 00 59 00");  // health status is enough
  auto changes = rig.all<PresenceChange>();
  ASSERT_EQ(changes.size(), 1u);
  EXPECT_EQ(changes[0].presence, Presence::online);
  EXPECT_EQ(changes[0].address, "0x0100");
  rig.run_for(29s);
  rig.hear(first_robot, "04 00 59 00");
  rig.run_for(29s);
  EXPECT_EQ(rig.all<PresenceChange>().size(), 1u);
  rig.run_for(2s);
  changes = rig.all<PresenceChange>();
  ASSERT_EQ(changes.size(), 2u);
  EXPECT_EQ(changes[1].presence, Presence::offline);
  rig.hear(first_robot, update_set);
  EXPECT_EQ(rig.all<PresenceChange>().size(), 3u);
}

TEST_F(Uplink, HeartbeatMakesRobotOnline) {
  rig.say(hex("07 d8 08 02 03 00 00 01"));
  EXPECT_EQ(rig.all<PresenceChange>().size(), 1u);
}

TEST_F(Uplink, IgnoresHeartbeatsFromInvalidAddresses) {
  for (const char* heartbeat : {"07 d8 08 02 03 00 00 00", "07 d8 08 02 03 00 03 c0"})
    rig.say(hex(heartbeat));
  EXPECT_TRUE(rig.all<PresenceChange>().empty());
}

/// Octets lost on the serial line can produce wrong addresses.
TEST_F(Uplink, ReplacesSilentAddressesWhenItsTableIsFull) {
  const auto last = static_cast<std::uint16_t>(first_robot + 300);
  for (std::uint16_t address = first_robot; address < last; ++address) {
    rig.hear(address, "cb 59 00 01 00");
    if (address % 100 == 0) rig.run_for(1s);
  }
  EXPECT_EQ(rig.counter("robots_online"), 256u);
  rig.run_for(60s);
  EXPECT_EQ(rig.counter("robots_online"), 0u);
  const std::size_t reports = rig.all<Report>().size();
  rig.hear(last, "cb 59 00 01 00");
  EXPECT_EQ(rig.all<Report>().size(), reports + 1);
  EXPECT_EQ(rig.all<UnsubscribeRequest>().size(), 1u);
  rig.hear(first_robot, "cb 59 00 01 00");
  EXPECT_EQ(rig.all<UnsubscribeRequest>().size(), 1u) << "a robot with a name is never replaced";
}

TEST_F(Uplink, SubscribesForConfiguredRobotsAtStartAndForAllWhenTheyComeOnline) {
  const auto filters = [&] {
    std::vector<std::string> found;
    for (const auto& request : rig.all<SubscribeRequest>()) {
      EXPECT_EQ(request.filter, "ntnu-slam/server/" + request.robot + "/+");
      found.push_back(request.robot + (request.is_standing ? " may be elsewhere" : " is here"));
    }
    return found;
  };
  EXPECT_EQ(filters(), std::vector<std::string>{"nr1 may be elsewhere"});
  rig.hear(first_robot, update_set);
  rig.hear(0x0205, update_set);
  rig.hear(0x0205, update_set);
  EXPECT_EQ(filters(),
            (std::vector<std::string>{"nr1 may be elsewhere", "nr1 is here", "ble-0205 is here"}));
}

TEST_F(Uplink, AsksAgainForASubscriptionThatWasNotGranted) {
  rig.mesh.on_subscribe_result("nr1", "ntnu-slam/server/nr1/+", false, rig.now);
  const std::size_t before = rig.all<SubscribeRequest>().size();
  rig.mesh.on_broker_link(true, rig.now);
  rig.run_for(1ms);
  EXPECT_EQ(rig.all<SubscribeRequest>().size(), before + 1);
  rig.mesh.on_broker_link(true, rig.now);
  rig.run_for(1ms);
  EXPECT_EQ(rig.all<SubscribeRequest>().size(), before + 1);
}

TEST_F(Uplink, TheNumberOfRobotsIsBounded) {
  for (std::uint16_t address = 1; address <= 300; ++address) rig.hear(address, "04 00 59 00");
  EXPECT_EQ(rig.counter("robots_online"), Robots::max_robots);
  EXPECT_TRUE(rig.has_notice("beyond the 256"));
}

TEST_F(Uplink, EvictsSessionOfReplacedAddress) {
  for (std::uint16_t address = 1; address <= 0x0101; ++address) rig.hear(address, "04 00 59 00");
  rig.run_for(60s);
  EXPECT_TRUE(rig.all<SessionEvicted>().empty());
  rig.hear(0x1234, "04 00 59 00");
  const auto evicted = rig.all<SessionEvicted>();
  ASSERT_EQ(evicted.size(), 1u);
  EXPECT_EQ(evicted[0].robot, "ble-0002") << "0x0001 is the gateway";
}

Settings with_will() {
  Settings settings;
  settings.will = WillSettings{"ntnu-slam/robot/{id}/adv", "{id} gone"};
  return settings;
}

class UplinkWithWill : public Uplink {
 protected:
  UplinkWithWill() : Uplink(with_will()) {}
};

TEST_F(UplinkWithWill, PublishesWillWhenRobotFallsSilent) {
  rig.hear(first_robot, "04 00 59 00");
  rig.run_for(31s);
  const auto reports = rig.all<Report>();
  ASSERT_EQ(reports.size(), 1u);
  EXPECT_EQ(reports[0].topic, "ntnu-slam/robot/nr1/adv");
  EXPECT_EQ(reports[0].payload, to_bytes("{id} gone"));
  EXPECT_FALSE(reports[0].receipt.is_owed());
}

}  // namespace
}  // namespace slamgw::ble
