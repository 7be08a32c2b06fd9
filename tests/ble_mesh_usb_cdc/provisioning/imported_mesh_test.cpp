// SPDX-License-Identifier: Apache-2.0
// Networks brought in from other tools.
#include "adapters/ble_mesh_usb_cdc/provisioning/mesh_json.hpp"

#include <gtest/gtest.h>

namespace slamgw::ble {
namespace {

/// A database of Nordic's interactive_pyaci: addresses as numbers, UUIDs without hyphens.
const char* const tool_database = R"({
  "$schema": "", "meshName": "BT Mesh", "meshUUID": "01020304050607080102030405060708",
  "ivIndex": 3, "ivUpdate": 0,
  "netKeys": [{"index": 0, "key": "18eed9c2a56add85049ffc3c59ad0e12", "minSecurity": "low",
               "name": "root", "phase": 0}],
  "appKeys": [{"index": 1, "key": "2aa2a6ded5a0798ceab5787ca3ae39fc", "boundNetKey": 0,
               "name": "locks"},
              {"index": 0, "key": "4f68ad85d9f48ac8589df665b6b49b8a", "boundNetKey": 0,
               "name": "lights"}],
  "nodes": [
    {"UUID": "00000000000000000000000000000001", "deviceKey": "d1d1d1d1d1d1d1d1d1d1d1d1d1d1d1d1",
     "unicastAddress": 16, "elements": [{"index": 0}, {"index": 1}], "appKeys": [0],
     "configComplete": false, "name": "robot-a", "netKeys": [0], "security": "low"},
    {"UUID": "00000000-0000-0000-0000-000000000002",
     "deviceKey": "D2D2D2D2D2D2D2D2D2D2D2D2D2D2D2D2", "unicastAddress": "0012",
     "configComplete": false, "name": "robot-a"}]})";

NodeDatabase imported() {
  auto database = decode_imported_mesh(tool_database);
  if (!database.has_value()) ADD_FAILURE() << database.error().why;
  return database.has_value() ? *database : NodeDatabase{};
}

TEST(ImportedMesh, ReadsTheDatabaseOfNordicsTool) {
  const NodeDatabase database = imported();
  EXPECT_EQ(to_hex(database.keys.net_key), "18eed9c2a56add85049ffc3c59ad0e12");
  EXPECT_EQ(to_hex(database.keys.app_key), "4f68ad85d9f48ac8589df665b6b49b8a");
  EXPECT_EQ(database.iv_index, 3u);
  ASSERT_EQ(database.nodes.size(), 2u);
  EXPECT_EQ(database.nodes[0].address, 0x0010);
  EXPECT_EQ(database.nodes[0].elements, 2);
  EXPECT_EQ(database.nodes[0].state, NodeState::configured);
  EXPECT_EQ(database.nodes[0].name, "robot-a");
  EXPECT_EQ(database.nodes[1].address, 0x0012);
  EXPECT_EQ(database.nodes[1].state, NodeState::provisioned) << "it has no application key";
  EXPECT_EQ(database.nodes[1].device_key->at(0), 0xd2);
  EXPECT_EQ(database.nodes[1].name, "") << "two robots can't have one name";
}

TEST(ImportedMesh, ReadsAnotherGatewaysFile) {
  EXPECT_EQ(decode_imported_mesh(encode_node_database(imported()))->nodes.size(), 2u);
}

TEST(ImportedMesh, ReportsErrorsWithoutShowingKeys) {
  for (const std::string_view text :
       {"", "[]", "{}", R"({"netKeys": 1})", R"({"netKeys": [], "appKeys": []})",
        R"({"netKeys": [{"index": 0, "key": "18eed9c2a56add85049ffc3c59ad0e12"}],
            "appKeys": [{"index": 0, "key": "4f68ad85d9f48ac8589df665b6b49b8a"}],
            "nodes": [{"UUID": "00000000000000000000000000000001"}]})"}) {
    const auto database = decode_imported_mesh(text);
    ASSERT_FALSE(database.has_value()) << text;
    EXPECT_NE(database.error().why, "");
    EXPECT_EQ(database.error().why.find("4f68"), std::string::npos);
  }
}

TEST(ImportedMesh, AssignsAddressesAfterThoseOfItsNodes) {
  NodeDatabase database = imported();
  database.nodes[1].address = 0x0150;
  EXPECT_EQ(merge_imported_mesh({}, database, 1)->next_address, 0x0151);
  EXPECT_EQ(merge_imported_mesh({}, imported(), 1)->next_address, 0x0100);
}

TEST(ImportedMesh, IsAddedToTheSameNetworkOnly) {
  NodeDatabase own = imported();
  own.nodes.pop_back();
  own.nodes[0].name = "mine";
  own.iv_index = 7;
  const auto merged = merge_imported_mesh(own, imported(), 1);
  ASSERT_TRUE(merged.has_value());
  EXPECT_EQ(merged->nodes.size(), 2u);
  EXPECT_EQ(merged->nodes[0].name, "mine");
  EXPECT_EQ(merged->iv_index, 7u);
  own.keys.net_key[0] ^= 1;
  EXPECT_FALSE(merge_imported_mesh(own, imported(), 1).has_value());
}

TEST(ImportedMesh, IsRefusedWhenAddressesOverlap) {
  EXPECT_FALSE(merge_imported_mesh({}, imported(), 0x0011).has_value()) << "the gateway's";
  NodeDatabase own = imported();
  own.nodes[0].uuid[0] = 0xee;
  EXPECT_FALSE(merge_imported_mesh(own, imported(), 1).has_value()) << "another node's";
}

TEST(ImportedMesh, IsRefusedWhenNodesNewAddressOverlaps) {
  NodeDatabase database = imported();
  database.nodes[0].new_address = 0x0200;
  database.nodes[0].new_elements = 2;
  EXPECT_EQ(merge_imported_mesh({}, database, 1)->next_address, 0x0202);
  NodeDatabase own = imported();
  own.nodes.erase(own.nodes.begin());
  own.nodes[0].address = 0x0201;
  EXPECT_FALSE(merge_imported_mesh(own, database, 1).has_value());
}

}  // namespace
}  // namespace slamgw::ble
