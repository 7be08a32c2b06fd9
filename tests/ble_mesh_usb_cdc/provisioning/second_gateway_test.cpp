// SPDX-License-Identifier: Apache-2.0
// Two gateways, each with its own board, in one mesh: the first exports, the second imports.
#include <gtest/gtest.h>

#include "adapters/ble_mesh_usb_cdc/provisioning/mesh_json.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"
#include "tests/ble_mesh_usb_cdc/provisioning_rig.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;

Settings at(std::uint16_t address) {
  Settings settings;
  settings.address = address;
  return settings;
}

std::string error_of(const ProvisioningRig& rig) {
  const json answer = rig.answer();
  return answer.is_string() ? answer.get<std::string>() : "no error";
}

/// The first gateway, with one robot.
struct FirstRig : ProvisioningRig {
  FirstRig() {
    add(1);
    start();
    EXPECT_TRUE(all_configured(30s));
  }
  json export_mesh() {
    order(ExportOrder{});
    return answer();
  }
};

TEST(SecondGateway, JoinsTheMeshUnderAnAddressOfItsOwn) {
  FirstRig first;
  const json exported = first.export_mesh();
  EXPECT_EQ(exported["address"], "0x0021");
  EXPECT_EQ(first.on_disk().gateways, std::vector<std::uint16_t>{0x21});
  ProvisioningRig second(at(0x21), std::nullopt);
  second.order(ImportOrder{exported["mesh"]});  // before the board is plugged in
  second.start();
  second.run_for(2s);
  EXPECT_EQ(second.answer()["nodes"], 1) << error_of(second);
  EXPECT_TRUE(second.is_up());
  EXPECT_EQ(second.board.unicast, 0x21);
  EXPECT_EQ(second.board.subnets, first.board.subnets);
  EXPECT_EQ(second.on_disk().guest_address, 0x21);
  second.hear(0x0100, "cb 59 00 0a 00 ec ff", 0xc003);
  ASSERT_EQ(second.all<Report>().size(), 1u);
  EXPECT_EQ(second.all<Report>()[0].robot, "ble-0100");
}

TEST(SecondGateway, NeitherProvisionsNorReconfiguresRobots) {
  FirstRig first;
  const json exported = first.export_mesh();
  Settings settings = at(0x21);
  settings.groups = {0xc005};
  settings.ttl = 7;
  ProvisioningRig second(settings, std::nullopt);
  second.add(9);
  second.order(ImportOrder{exported["mesh"]});
  second.start();
  second.run_for(2s);
  second.hear(0x0100, "cb 59 00 0a 00 ec ff", 0xc005);
  second.pass(60s);
  EXPECT_FALSE(second.board.devices.is_scanning);
  EXPECT_EQ(second.on_disk().nodes.size(), 1u);
  EXPECT_EQ(second.board.count(0x9c), 0u) << "no device key is used";
  for (const BleOrder& wanted :
       {BleOrder(ProvisionOrder{to_hex(Bytes(16, 9)), "r9"}), BleOrder(PermitJoinOrder{5min, {}}),
        BleOrder(RemoveOrder{"ble-0100", true}), BleOrder(ExportOrder{})}) {
    second.order(wanted);
    EXPECT_NE(error_of(second).find("gateway 'gw' provisions this mesh"), std::string::npos)
        << error_of(second);
  }
}

TEST(SecondGateway, EachExportAssignsItsOwnAddress) {
  FirstRig first;
  const json second = first.export_mesh();
  const json third = first.export_mesh();
  EXPECT_EQ(second["address"], "0x0021");
  EXPECT_EQ(third["address"], "0x0041");
  ProvisioningRig wrong(at(0x21), std::nullopt);
  wrong.answers_stores = false;
  wrong.start();
  wrong.order(ImportOrder{third["mesh"]});
  EXPECT_NE(error_of(wrong).find("ble_mesh.address is 0x0041"), std::string::npos)
      << error_of(wrong);
  first.order(ImportOrder{second["mesh"]});
  EXPECT_NE(error_of(first).find("provisions this mesh itself"), std::string::npos);
}

TEST(SecondGateway, ItsAddressIsStoredBeforeExportAndGivenToNoRobot) {
  FirstRig first;
  first.answers_stores = false;
  first.order(ExportOrder{});
  first.run_for(1s);
  EXPECT_TRUE(first.answer().is_null()) << "the disk has not answered yet";
  first.mesh.on_stored({}, first.now);
  first.run_for(1ms);
  EXPECT_EQ(first.answer()["address"], "0x0021");
  first.answers_stores = true;
  const Uuid uuid{};
  EXPECT_FALSE(is_address_free(first.on_disk(), 0x21, 1, {0x21}, uuid));
  ProvisioningRig named({}, first.on_disk(), RobotNames({{"r2", 0x0022, {}}}));
  named.board = first.board;
  named.start();
  named.add(2);
  named.pass(20s);
  EXPECT_EQ(named.on_disk().find_address(0x22), nullptr);
}

TEST(SecondGateway, FailedExportReservesNoAddress) {
  FirstRig first;
  first.store_problem = "no space";
  first.order(ExportOrder{});
  EXPECT_EQ(error_of(first), "no space");
  first.store_problem.clear();
  first.run_for(6s);
  EXPECT_TRUE(first.on_disk().gateways.empty());
  first.order(RefreshKeysOrder{});
  EXPECT_EQ(first.answer()["step"], "distributing") << error_of(first);
}

TEST(SecondGateway, KnowsAllRobotsAfterAnotherImport) {
  FirstRig first;
  const json exported = first.export_mesh();
  ProvisioningRig second(at(0x21), std::nullopt);
  second.order(ImportOrder{exported["mesh"]});  // before the board is plugged in
  second.start();
  second.run_for(2s);
  first.add(2);
  ASSERT_TRUE(first.all_configured(30s));
  second.hear(0x0101, "cb 59 00 0a 00 ec ff", 0xc003);
  EXPECT_TRUE(second.all<Report>().empty()) << "this gateway does not know the robot yet";
  first.order(ExportOrder{0x21});
  second.order(ImportOrder{first.answer()["mesh"]});
  EXPECT_EQ(second.answer()["nodes"], 2) << error_of(second);
  EXPECT_EQ(second.on_disk().guest_address, 0x21);
  EXPECT_EQ(first.on_disk().gateways, std::vector<std::uint16_t>{0x21});
  second.hear(0x0101, "cb 59 00 0a 00 ec ff", 0xc003);
  EXPECT_EQ(second.all<Report>().size(), 1u);
  first.order(ExportOrder{0x22});
  EXPECT_NE(error_of(first).find("no gateway of this mesh was given the address 0x0022"),
            std::string::npos);
}

TEST(SecondGateway, ItsRoleSurvivesRestart) {
  NodeDatabase database = test_database();
  database.guest_address = 0x21;
  database.guest_addresses = 32;
  database.host = "room-a";
  database.gateways = {3, 4};
  const auto read = decode_node_database(encode_node_database(database));
  ASSERT_TRUE(read.has_value());
  EXPECT_EQ(read->guest_address, 0x21);
  EXPECT_EQ(read->guest_addresses, 32);
  EXPECT_EQ(read->host, "room-a");
  EXPECT_EQ(read->gateways, (std::vector<std::uint16_t>{3, 4}));
  EXPECT_FALSE(
      decode_node_database(R"({"version":2,"net_key":"00000000000000000000000000000000",)"
                           R"("app_key":"00000000000000000000000000000000","iv_index":0,)"
                           R"("next_address":"0x0100","nodes":[],"removed":[],"guest":"0xc000"})")
          .has_value());
}

}  // namespace
}  // namespace slamgw::ble
