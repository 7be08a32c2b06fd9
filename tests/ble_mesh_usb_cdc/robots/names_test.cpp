// SPDX-License-Identifier: Apache-2.0
// A reload of `robots` of the configuration: robots get new names while they are online, and lose
// no message.
#include <gtest/gtest.h>

#include <map>

#include "tests/ble_mesh_usb_cdc/mesh_rig.hpp"
#include "tests/ble_mesh_usb_cdc/provisioning_rig.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

constexpr std::string_view acknowledged_update = "c9 59 00 0a 00 ec ff";

void rename(MeshRig& rig, std::vector<RobotName> names) {
  rig.events.clear();
  rig.mesh.on_names(RobotNames(std::move(names)), rig.now);
  rig.run_for(Duration::zero());
}

/// Returns the presence changes in order, such as "name online".
std::vector<std::string> presence_of(const MeshRig& rig) {
  std::vector<std::string> lines;
  for (const PresenceChange& change : rig.all<PresenceChange>())
    lines.push_back(change.robot + " " + std::string(to_string(change.presence)));
  return lines;
}

TEST(Names, RenamedRobotGoesOfflineAndComesOnlineUnderItsNewName) {
  MeshRig rig;
  rig.start();
  rig.hear(0x0100, "cb 59 00 01 00 02 00");
  rename(rig, {{"nr2", 0x0100, {}}});
  EXPECT_EQ(presence_of(rig), (std::vector<std::string>{"nr1 offline", "nr2 online"}));
  ASSERT_EQ(rig.all<UnsubscribeRequest>().size(), 1u);
  EXPECT_EQ(rig.all<UnsubscribeRequest>()[0].robot, "nr1");
  EXPECT_EQ(rig.all<UnsubscribeRequest>()[0].filter, "ntnu-slam/server/nr1/+");
  ASSERT_EQ(rig.all<SubscribeRequest>().size(), 1u);
  EXPECT_EQ(rig.all<SubscribeRequest>()[0].robot, "nr2");
  EXPECT_EQ(rig.all<SubscribeRequest>()[0].filter, "ntnu-slam/server/nr2/+");
  EXPECT_EQ(rig.asked().size(), 1u) << "for the robot under its new name";
  rig.hear(0x0100, "cb 59 00 01 00 02 00");
  EXPECT_EQ(rig.all<Report>().back().topic, "ntnu-slam/robot/nr2/update");
  rig.command("nr2/cmd", hex("01 00 02 00"));
  rig.run_for(100ms);
  EXPECT_EQ(rig.sent_to(0x0100).size(), 1u);
  EXPECT_TRUE(rig.is_up() || rig.all<LinkChange>().empty()) << "the board is not configured again";
}

TEST(Names, BannedRobotGoesOfflineAndItsCommandsEnd) {
  MeshRig rig;
  rig.start();
  rig.hear(0x0100, "cb 59 00 01 00 02 00");
  rig.command("nr1/cmd", hex("01 00 02 00"));
  rig.command("nr1/run", hex("01"));
  rig.events.clear();
  rig.mesh.on_names(RobotNames({{"nr1", 0x0100, {}}}, Bans({"nr1"})), rig.now);
  rig.run_for(100ms);
  EXPECT_EQ(presence_of(rig), (std::vector<std::string>{"nr1 offline"}));
  ASSERT_EQ(rig.all<CommandOutcome>().size(), 2u);
  EXPECT_EQ(rig.all<CommandOutcome>()[0].result, CommandResult::timeout) << "it was sent";
  EXPECT_EQ(rig.all<CommandOutcome>()[1].result, CommandResult::refused) << "it waited";
  for (const CommandOutcome& outcome : rig.all<CommandOutcome>())
    EXPECT_NE(outcome.why.find("banned"), std::string::npos);
  const std::size_t sent = rig.sent_to(0x0100).size();
  rig.hear(0x0100, "cb 59 00 01 00 02 00");
  rig.run_for(30s);
  EXPECT_EQ(rig.sent_to(0x0100).size(), sent) << "no message to the robot";
  EXPECT_TRUE(rig.all<Report>().empty());
  rename(rig, {{"nr1", 0x0100, {}}});
  rig.hear(0x0100, "cb 59 00 01 00 02 00");
  EXPECT_EQ(presence_of(rig), (std::vector<std::string>{"nr1 online"}));
}

TEST(Names, SendsOwedAcknowledgementAfterRename) {
  MeshRig rig;
  rig.start();
  rig.hear(0x0100, acknowledged_update);
  ASSERT_EQ(rig.all<Report>().size(), 1u);
  const std::uint64_t receipt = rig.all<Report>().back().receipt.id;
  ASSERT_NE(receipt, 0u);
  rename(rig, {{"nr2", 0x0100, {}}});
  EXPECT_TRUE(rig.sent_to(0x0100).empty());
  rig.receipt(receipt);
  rig.run_for(100ms);
  EXPECT_EQ(rig.sent_to(0x0100).size(), 1u);
}

TEST(Names, CommandUnderOldNameEndsWithReason) {
  MeshRig rig;
  rig.start();
  rig.hear(0x0100, "cb 59 00 01 00 02 00");
  rig.command("nr1/cmd", hex("01 00 02 00"));
  rename(rig, {});
  ASSERT_EQ(rig.all<CommandOutcome>().size(), 1u);
  EXPECT_EQ(rig.all<CommandOutcome>()[0].robot, "nr1");
  EXPECT_EQ(rig.all<CommandOutcome>()[0].result, CommandResult::timeout) << "it was sent";
  EXPECT_EQ(rig.all<CommandOutcome>()[0].why, "the robot was renamed");
  EXPECT_EQ(presence_of(rig).back(), "ble-0100 online");
}

/// A device with the mesh's keys can send from any address. Its name follows from that and from the
/// configuration, never from its payload.
TEST(Names, SourceAddressAloneDeterminesName) {
  MeshRig rig({}, test_database(), RobotNames({{"nr1", 0x0100, {}}, {"lego", 0x0200, {}}}));
  rig.start();
  const std::map<std::uint16_t, std::string> names{
      {0x0100, "nr1"}, {0x0200, "lego"}, {0x0201, "ble-0201"}, {0x7fff, "ble-7fff"}};
  for (const auto& [address, name] : names) {
    rig.events.clear();
    rig.hear(address, "cb 59 00 6e 72 31 00");  // "nr1" in its payload
    const auto reports = rig.all<Report>();
    ASSERT_EQ(reports.size(), 1u);
    EXPECT_EQ(reports[0].robot, name);
    EXPECT_EQ(reports[0].topic, "ntnu-slam/robot/" + name + "/update");
  }
  rig.events.clear();
  for (const std::uint16_t invalid :
       std::initializer_list<std::uint16_t>{0, 0x8001, 0xc003, 0xffff})
    rig.hear(invalid, "cb 59 00 01 00 02 00");
  EXPECT_TRUE(rig.all<Report>().empty()) << "no device has such an address";
}

TEST(Names, TwoRobotsCanExchangeNames) {
  MeshRig rig({}, test_database(), RobotNames({{"a", 0x0100, {}}, {"b", 0x0101, {}}}));
  rig.start();
  rig.hear(0x0100, "cb 59 00 01 00 02 00");
  rig.hear(0x0101, "cb 59 00 01 00 02 00");
  rename(rig, {{"b", 0x0100, {}}, {"a", 0x0101, {}}});
  EXPECT_EQ(presence_of(rig),
            (std::vector<std::string>{"a offline", "b offline", "b online", "a online"}));
}

TEST(Names, ForgetsRobotThatWasNamedAndNeverHeard) {
  MeshRig rig;
  rig.start();
  for (std::uint16_t address = 0x0200; address < 0x0600; ++address)
    rename(rig, {{"nr" + std::to_string(address), address, {}}});
  EXPECT_EQ(rig.all<UnsubscribeRequest>().size(), 1u);
  EXPECT_EQ(rig.all<SubscribeRequest>().size(), 1u);
  EXPECT_TRUE(rig.all<PresenceChange>().empty());
  rename(rig, {});
  EXPECT_EQ(rig.all<UnsubscribeRequest>().size(), 1u)
      << "the last one; the earlier ones are forgotten";
}

TEST(Names, ConfiguredNameAppliesToNodeAndLeavesMeshUnchanged) {
  ProvisioningRig rig;
  rig.add(1);
  rig.start();
  ASSERT_TRUE(rig.all_configured(20s));
  const std::size_t stored = rig.stored.size();
  rename(rig, {{"lego-1", 0x0100, {}}});
  rig.order(NodesOrder{});
  EXPECT_EQ(rig.answer()[0]["robot"], "lego-1") << rig.answer();
  EXPECT_EQ(rig.answer()[0]["state"], "configured");
  EXPECT_EQ(rig.stored.size(), stored) << "the mesh is the same";
  rig.hear(0x0100, "cb 59 00 01 00 02 00");
  EXPECT_EQ(rig.all<Report>().back().robot, "lego-1");
}

/// Joined nodes at 0x0100 and 0x0101, with these names from an operator.
NodeDatabase database_of(const std::string& first, const std::string& second) {
  NodeDatabase database = test_database();
  for (const auto& [address, name] :
       std::map<std::uint16_t, std::string>{{0x0100, first}, {0x0101, second}}) {
    Node node;
    node.uuid.fill(static_cast<std::uint8_t>(address));
    node.address = address;
    node.device_key = Key{};
    node.state = NodeState::configured;
    node.name = name;
    database.nodes.push_back(node);
  }
  return database;
}

/// Returns the names of the robots that send from 0x0100 and 0x0101.
std::vector<std::string> speakers(MeshRig& rig) {
  std::vector<std::string> ids;
  for (const std::uint16_t address : std::initializer_list<std::uint16_t>{0x0100, 0x0101}) {
    rig.hear(address, "cb 59 00 01 00 02 00");
    ids.push_back(rig.all<Report>().back().robot);
  }
  return ids;
}

std::size_t warnings_of_taken_names(const MeshRig& rig) {
  return static_cast<std::size_t>(
      std::ranges::count_if(rig.all<Notice>(), [](const Notice& notice) {
        return notice.severity == Severity::warning &&
               notice.text.starts_with(
                   "\"robots\" gives 0x0101 the id lego-1, which the robot at "
                   "0x0100 has: it goes by ble-0101");
      }));
}

TEST(Names, NameOfNodeIsGivenToNoOtherNodeByReloadOrAtStart) {
  const std::vector<RobotName> taken{{"lego-1", 0x0101, {}}};
  const std::vector<std::string> apart{"lego-1", "ble-0101"};
  MeshRig rig({}, database_of("lego-1", ""), RobotNames());
  rig.start();
  EXPECT_EQ(speakers(rig), apart);
  rename(rig, taken);
  EXPECT_EQ(warnings_of_taken_names(rig), 1u);
  EXPECT_EQ(speakers(rig), apart);
  rig.command("lego-1/cmd", hex("01 00 02 00"));
  rig.run_for(100ms);
  EXPECT_EQ(rig.sent_to(0x0100).size(), 1u);

  MeshRig started({}, database_of("lego-1", ""), RobotNames(taken));
  started.start();
  EXPECT_EQ(warnings_of_taken_names(started), 1u);
  EXPECT_EQ(speakers(started), apart);
}

TEST(Names, NameReleasedInSameReloadCanBeUsed) {
  MeshRig rig({}, database_of("lego-1", "lego-2"), RobotNames());
  rig.start();
  rename(rig, {{"lego-1", 0x0101, {}}, {"lego-2", 0x0100, {}}});
  EXPECT_EQ(speakers(rig), (std::vector<std::string>{"lego-2", "lego-1"})) << "exchanged";
  rename(rig, {{"lego-1", 0x0101, {}}, {"lego-3", 0x0100, {}}});
  EXPECT_EQ(speakers(rig), (std::vector<std::string>{"lego-3", "lego-1"})) << "one after the other";
  EXPECT_EQ(warnings_of_taken_names(rig), 0u);
  rename(rig, {{"lego-2", 0x0100, {}}});
  EXPECT_EQ(speakers(rig), (std::vector<std::string>{"lego-1", "lego-2"})) << "0x0101 has lego-2";
}

TEST(Names, RobotOfAnotherToolGetsNoNameOfNode) {
  NodeDatabase database = database_of("lego-1", "");
  database.nodes.pop_back();
  MeshRig rig({}, database, RobotNames());
  rig.start();
  speakers(rig);
  rename(rig, {{"lego-1", 0x0101, {}}});
  EXPECT_EQ(warnings_of_taken_names(rig), 1u);
  EXPECT_EQ(speakers(rig), (std::vector<std::string>{"lego-1", "ble-0101"}));
}

}  // namespace
}  // namespace slamgw::ble
