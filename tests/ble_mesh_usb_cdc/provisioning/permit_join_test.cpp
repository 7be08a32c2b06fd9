// SPDX-License-Identifier: Apache-2.0
// Joining for a limited time, at a site where robots may not join by themselves.
#include <gtest/gtest.h>

#include "tests/ble_mesh_usb_cdc/provisioning_rig.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;

Settings closed() {
  Settings settings;
  settings.provisioning.enabled = false;
  return settings;
}

struct PermitRig : ProvisioningRig {
  explicit PermitRig(std::size_t devices, Settings settings = closed())
      : ProvisioningRig(std::move(settings)) {
    for (std::uint8_t n = 1; n <= devices; ++n) add(n);
    start();
  }
  json permit(std::chrono::minutes time, std::string robot = {}) {
    order(PermitJoinOrder{time, std::move(robot)});
    return answer();
  }
  /// Runs until the first device has begun to join.
  void pass_until_joining() {
    for (int i = 0; i < 1000 && board.count(0x63) == 0; ++i) {
      run_for(1ms);
      if (const Bytes beacons = board.devices.beacons(); !beacons.empty()) say(beacons);
    }
  }
  json news(std::uint64_t after = 0) {
    order(JoinEventsOrder{after});
    return answer();
  }
  std::vector<std::string> story() {
    std::vector<std::string> lines;
    const json all = news();
    for (const json& event : all["events"])
      lines.push_back(event["event"].get<std::string>() + " " + event["robot"].get<std::string>());
    return lines;
  }
};

TEST(PermitJoin, LetsRobotsJoinForLimitedTimeAndListsEvents) {
  PermitRig rig(2);
  rig.pass(20s);
  EXPECT_EQ(rig.configured(), 0u);
  const json opened = rig.permit(5min);
  EXPECT_EQ(opened["seconds_left"], 300);
  EXPECT_EQ(opened["events"], json::array());
  ASSERT_TRUE(rig.all_configured(60s));
  EXPECT_EQ(rig.story(),
            (std::vector<std::string>{"joining ", "joined ble-0100", "joining ", "joined ble-0101",
                                      "configured ble-0100", "configured ble-0101"}));
  EXPECT_EQ(rig.news(3)["events"].size(), 3u);
  EXPECT_EQ(rig.news()["under_way"], 0);
  rig.pass(5min);
  EXPECT_EQ(rig.news()["seconds_left"], 0);
  EXPECT_FALSE(rig.board.devices.is_scanning);
  EXPECT_TRUE(rig.has_notice("new robots may not join any more"));
  rig.add(3);
  rig.pass(20s);
  EXPECT_EQ(rig.configured(), 2u);
}

TEST(PermitJoin, WithNameProvisionsOneRobot) {
  PermitRig rig(3);
  rig.permit(5min, "lego-1");
  rig.pass(2min);
  EXPECT_EQ(rig.configured(), 1u);
  EXPECT_EQ(rig.on_disk().nodes.at(0).name, "lego-1");
  EXPECT_EQ(rig.story(),
            (std::vector<std::string>{"joining lego-1", "joined lego-1", "configured lego-1"}));
  EXPECT_EQ(rig.news()["seconds_left"], 0);
  EXPECT_NE(rig.permit(5min, "lego-1").get<std::string>().find("another robot already"),
            std::string::npos);
}

TEST(PermitJoin, GivesNameToNextRobotWhenFirstFails) {
  PermitRig rig(2);
  rig.board.devices.fails_at = {0xc5, 4};
  rig.permit(5min, "lego-1");
  rig.pass(1min);
  EXPECT_EQ(rig.configured(), 1u);
  const auto story = rig.story();
  ASSERT_GE(story.size(), 4u);
  EXPECT_EQ(story[1], "failed ");
  EXPECT_EQ(story.back(), "configured lego-1");
  EXPECT_EQ(std::ranges::count(rig.on_disk().nodes, "lego-1", &Node::name), 1);
}

TEST(PermitJoin, OpenedAgainWhileItsRobotJoinsEndsWithThatRobot) {
  Uuid uuid{};
  uuid[0] = 1;
  Uuid other{};
  JoinPermit permit;
  permit.open(5min, "lego-1", TimePoint{});
  permit.on_chosen(uuid);
  permit.open(5min, "lego-1", TimePoint{});
  EXPECT_FALSE(permit.admits(other));
  permit.on_joined(uuid, "lego-1");
  EXPECT_FALSE(permit.is_open());
  EXPECT_EQ(json::parse(permit.json(0, TimePoint{}))["events"].back()["event"], "joined");
  permit.open(5min, "lego-1", TimePoint{});  // the robot was removed since
  EXPECT_TRUE(permit.admits(other));
}

TEST(PermitJoin, GivesNameOnceThoughItIsOrderedTwice) {
  PermitRig rig(2);
  rig.permit(5min, "lego-1");
  rig.pass_until_joining();
  rig.permit(5min, "lego-1");
  rig.pass(3min);
  EXPECT_EQ(rig.configured(), 1u);
  EXPECT_EQ(std::ranges::count(rig.on_disk().nodes, "lego-1", &Node::name), 1);
}

TEST(PermitJoin, GivesNameOnceThoughProvisionAsksForItToo) {
  PermitRig rig(2);
  rig.permit(5min, "lego-1");
  rig.pass_until_joining();
  rig.order(ProvisionOrder{to_hex(rig.board.devices.devices[1].uuid), "lego-1"});
  rig.pass(10s);
  EXPECT_EQ(rig.answer(), "lego-1 is another robot already");
  EXPECT_EQ(rig.configured(), 1u);
  EXPECT_EQ(std::ranges::count(rig.on_disk().nodes, "lego-1", &Node::name), 1);
}

TEST(PermitJoin, EndsWhenOperatorClosesIt) {
  PermitRig rig(0);
  rig.permit(5min);
  EXPECT_EQ(rig.permit(0min)["seconds_left"], 0);
  rig.add(1);
  rig.pass(30s);
  EXPECT_EQ(rig.configured(), 0u);
}

TEST(PermitJoin, ExcludesRemovedRobotsAndOtherUuidPrefixes) {
  Settings settings = closed();
  settings.provisioning.uuid_prefixes = {"ffff"};
  PermitRig others(1, settings);
  others.permit(5min);
  others.pass(30s);
  EXPECT_EQ(others.configured(), 0u);
  PermitRig rig(1);
  rig.permit(5min);
  ASSERT_TRUE(rig.all_configured(30s));
  rig.order(RemoveOrder{"ble-0100", false});
  rig.pass(5s);
  rig.permit(5min);
  rig.pass(30s);
  EXPECT_EQ(rig.configured(), 0u);
}

TEST(PermitJoin, IsRefusedWithoutLinkAndWithInvalidName) {
  ProvisioningRig rig(closed());
  rig.order(PermitJoinOrder{5min, {}});
  EXPECT_NE(rig.answer().get<std::string>().find("link is down"), std::string::npos);
  rig.order(PermitJoinOrder{5min, "a/b"});
  EXPECT_NE(rig.answer().get<std::string>().find("1 to 64 bytes"), std::string::npos);
}

}  // namespace
}  // namespace slamgw::ble
