// SPDX-License-Identifier: Apache-2.0
// The database of the mesh's nodes, its file, and the assignment of addresses.
#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"

#include <gtest/gtest.h>

#include "adapters/ble_mesh_usb_cdc/provisioning/mesh_json.hpp"

namespace slamgw::ble {
namespace {

Uuid uuid_of(std::uint8_t octet) {
  Uuid uuid;
  uuid.fill(octet);
  return uuid;
}

Node node_at(std::uint16_t address, std::uint8_t elements = 1,
             NodeState state = NodeState::configured) {
  Node node;
  node.uuid = uuid_of(static_cast<std::uint8_t>(address));
  node.address = address;
  node.elements = elements;
  node.state = state;
  node.device_key.emplace().fill(0xdd);
  return node;
}

NodeDatabase full_database() {
  NodeDatabase database;
  database.keys.net_key.fill(0xa1);
  database.keys.app_key.fill(0x0b);
  database.iv_index = 0xfffffffe;
  database.next_address = 0x0108;
  database.nodes = {node_at(0x0100), node_at(0x0102, 3, NodeState::provisioned),
                    node_at(0x0106, 1, NodeState::reserved)};
  database.nodes[0].name = "nr 1";
  database.nodes[0].ttl = 4;
  database.nodes[0].applied = AppliedSettings{0x0001, {0xc002, 0xfeff}, true};
  database.nodes[1].applied = AppliedSettings{0x7fff, {}};
  database.removed = {{uuid_of(9), 0x0107, 2}};
  return database;
}

std::string replaced(std::string text, std::string_view from, std::string_view to) {
  const auto at = text.find(from);
  if (at == std::string::npos) ADD_FAILURE() << from << " is not in " << text;
  return at == std::string::npos ? text : text.replace(at, from.size(), to);
}

TEST(NodeDatabase, IsReadAsItWasWritten) {
  const NodeDatabase database = full_database();
  const std::string text = encode_node_database(database);
  const auto again = decode_node_database(text);
  ASSERT_TRUE(again.has_value());
  EXPECT_EQ(again->keys, database.keys);
  EXPECT_EQ(again->nodes.at(0).name, "nr 1");
  EXPECT_EQ(again->nodes.at(0).ttl, 4);
  ASSERT_TRUE(again->nodes.at(0).applied && again->nodes.at(1).applied);
  EXPECT_EQ(again->nodes.at(0).applied->destination, 0x0001);
  EXPECT_EQ(again->nodes.at(0).applied->groups, (std::vector<std::uint16_t>{0xc002, 0xfeff}));
  EXPECT_TRUE(again->nodes.at(0).applied->is_changing);
  EXPECT_TRUE(again->nodes.at(1).applied->groups.empty());
  EXPECT_FALSE(again->nodes.at(1).applied->is_changing);
  EXPECT_FALSE(again->nodes.at(2).applied);
  EXPECT_EQ(again->nodes.at(0).device_key, database.nodes[0].device_key);
  EXPECT_EQ(again->nodes.at(1).elements, 3);
  EXPECT_EQ(again->nodes.at(2).state, NodeState::reserved);
  EXPECT_EQ(encode_node_database(*again), text);
}

TEST(NodeDatabase, KeepsNodeWithInvalidNameWithoutIt) {
  const std::string text = replaced(encode_node_database(full_database()), "nr 1",
                                    "nr\xc2\x85"
                                    "1");
  const auto again = decode_node_database(text);
  ASSERT_TRUE(again.has_value()) << "its keys are worth more than the name";
  EXPECT_EQ(again->nodes.at(0).name, "");
  EXPECT_EQ(again->nodes.at(0).device_key, full_database().nodes[0].device_key);
}

TEST(NodeDatabase, ReadsNodesOfWhichOnlyTheTtlIsKnown) {
  const auto old = decode_node_database(
      R"({"version": 2, "net_key": "11111111111111111111111111111111",
          "app_key": "22222222222222222222222222222222", "iv_index": 0, "next_address": "0x0101",
          "nodes": [{"uuid": "33333333333333333333333333333333", "address": "0x0100",
                     "elements": 1, "state": "configured",
                     "device_key": "44444444444444444444444444444444", "ttl": 4}],
          "removed": []})");
  ASSERT_TRUE(old.has_value());
  EXPECT_EQ(old->nodes.at(0).sent_ttl(), 4);
  EXPECT_FALSE(old->nodes.at(0).applied);
}

TEST(NodeDatabase, RejectsEveryDamage) {
  const std::string whole = encode_node_database(full_database());
  for (std::size_t size = 0; size + 2 < whole.size(); ++size)
    EXPECT_FALSE(decode_node_database(whole.substr(0, size)).has_value()) << size;
  for (const std::string_view text :
       {"[]", "null", "{}", R"({"version":2})", R"({"version":2,"net_key":1,"app_key":2})",
        R"({"version":2,"net_key":"zz","app_key":""})", R"({"version":"2"})"})
    EXPECT_FALSE(decode_node_database(text).has_value()) << text;
  const std::pair<std::string_view, std::string_view> damages[] = {
      {"\"version\": 2", "\"version\": 1"},
      {"\"version\": 2", "\"version\": 3"},
      {"a1a1", "g1a1"},
      {"\"0x0102\"", "\"0x0100\""},  // two nodes at one address
      {"\"0x0102\"", "\"0x0104\""},  // its elements overlap the next node's
      {"\"0x0102\"", "\"0x8000\""},  // not a unicast address
      {"\"elements\": 3", "\"elements\": 0"},
      {"\"provisioned\"", "\"elsewhere\""},
      {"\"reserved\"", "\"configured\""},                      // without a device key
      {"\"gateway\": \"0x0001\"", "\"gateway\": \"0x8001\""},  // virtual
      {"\"0xc002\"", "\"0x7fff\""},                            // not a group
      {"\"0xfeff\"", "\"0xff00\""},
      {"\"0xfeff\"", "1"},
      {"\"groups\": []", "\"groups\": {}"},
      {"\"nodes\": [", "\"nodes\": 1, \"x\": ["},
      {"02020202", "00000000"},  // two nodes with one UUID, once the second is replaced as well
  };
  for (const auto& [from, to] : damages) {
    std::string text = replaced(whole, from, to);
    if (from == "02020202")
      text = replaced(whole, std::string(32, '0').replace(0, 32, to_hex(uuid_of(0x02))),
                      to_hex(uuid_of(0x00)));
    EXPECT_FALSE(decode_node_database(text).has_value()) << from;
  }
}

TEST(NodeDatabase, FindsANodeByAnyOfItsAddresses) {
  const NodeDatabase database = full_database();
  EXPECT_EQ(database.find_address(0x0104), &database.nodes[1]);
  EXPECT_EQ(database.find_address(0x0105), nullptr);
  EXPECT_EQ(database.find_address(0x0101), nullptr);
}

TEST(NodeDatabase, RemembersRemovedNodesUpToItsBound) {
  NodeDatabase database = full_database();
  database.remove(uuid_of(0x02));
  EXPECT_EQ(database.find(uuid_of(0x02)), nullptr);
  EXPECT_TRUE(database.was_removed(uuid_of(0x02)));
  database.forget_removed(uuid_of(0x02));
  EXPECT_FALSE(database.was_removed(uuid_of(0x02)));
  for (int i = 0; i < 300; ++i) {
    database.nodes = {node_at(static_cast<std::uint16_t>(0x0200 + i))};
    database.nodes[0].uuid[1] = static_cast<std::uint8_t>(i / 256);
    database.remove(database.nodes[0].uuid);
  }
  EXPECT_EQ(database.removed.size(), NodeDatabase::max_removed);
}

TEST(AddressPlan, AssignsAddressesInOrder) {
  NodeDatabase database;
  EXPECT_EQ(choose_address(database, {}), 0x0100);
  database.nodes = {node_at(0x0100, 2)};
  database.next_address = 0x0102;
  EXPECT_EQ(choose_address(database, {}), 0x0102);
  EXPECT_EQ(choose_address(database, {.elements = 3, .preferred = {}, .taken = {0x0104}}), 0x0105);
}

TEST(AddressPlan, PrefersConfiguredAddresses) {
  NodeDatabase database;
  AddressWish wish{.elements = 1, .preferred = {0x0205, 0x0201}, .taken = {0x0205}};
  EXPECT_EQ(choose_address(database, wish), 0x0201);
  wish.elements = 5;
  EXPECT_EQ(choose_address(database, wish), 0x0100) << "no room at 0x0201 for five elements";
}

TEST(AddressPlan, ReusesAnAddressOnlyAfterAllOthers) {
  NodeDatabase database;
  database.next_address = 0x0102;
  database.removed = {{uuid_of(1), 0x0101, 1}, {uuid_of(2), 0x0100, 1}};
  EXPECT_EQ(choose_address(database, {}), 0x0102);
  EXPECT_EQ(choose_address(database, {.elements = 1, .preferred = {0x0100}, .taken = {}}), 0x0102);
  Node rest = node_at(0x0103, 255);
  for (std::uint32_t address = 0x0103; address <= last_unicast_address; address += 255) {
    rest.uuid[0] = static_cast<std::uint8_t>(address);
    rest.uuid[1] = static_cast<std::uint8_t>(address >> 8);
    rest.address = static_cast<std::uint16_t>(address);
    rest.elements = static_cast<std::uint8_t>(std::min(255U, 0x8000U - address));
    database.nodes.push_back(rest);
  }
  database.next_address = 0x8000;
  EXPECT_EQ(choose_address(database, {}), 0x0102) << "the address that was skipped";
  database.nodes.push_back(node_at(0x0102));
  EXPECT_EQ(choose_address(database, {}), 0x0101) << "removed longest ago";
  database.nodes.push_back(node_at(0x0101));
  database.nodes.push_back(node_at(0x0100));
  EXPECT_FALSE(choose_address(database, {})) << "all are taken";
  EXPECT_EQ(decode_node_database(encode_node_database(database))->next_address, 0x8000);
}

TEST(AddressPlan, RecognizesAddressesThatWereUsedBefore) {
  const NodeDatabase database = full_database();
  EXPECT_TRUE(was_used_before(database, 0x0108, 1));
  EXPECT_TRUE(was_used_before(database, 0x0106, 2));
  EXPECT_FALSE(was_used_before(database, 0x0106, 1));
}

}  // namespace
}  // namespace slamgw::ble
