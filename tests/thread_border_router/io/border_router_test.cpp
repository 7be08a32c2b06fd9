// SPDX-License-Identifier: Apache-2.0
// The shell over a D-Bus daemon of its own, with a fake otbr-agent at the other end.
#include "adapters/thread_border_router/io/border_router.hpp"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <optional>

#include "tests/support/eventually.hpp"
#include "tests/support/private_bus.hpp"
#include "tests/support/temp_dir.hpp"
#include "tests/thread_border_router/fake_otbr_agent.hpp"

namespace slamgw::border_router {
namespace {

using nlohmann::json;

class BorderRouterTest : public ::testing::Test {
 protected:
  BorderRouterTest() {
    router.start();
    router.on_broker_link(true);
  }
  ~BorderRouterTest() override {
    router.stop();
    io.poll();
  }
  bool eventually(const std::function<bool()>& condition) {
    return test::eventually(io, [&] {
      agent.process();
      return condition();
    });
  }
  bool has_role(const std::string& role) {
    return eventually([&] { return !document.empty() && json::parse(document)["role"] == role; });
  }
  bool has_said(const std::string& words) const {
    return std::ranges::any_of(said, [&](const std::string& line) { return line == words; });
  }

  boost::asio::io_context io;
  test::TempDir directory;
  std::optional<test::PrivateBus> bus{std::in_place, directory / "bus"};
  test::FakeOtbrAgent agent{bus->address()};
  std::string document = "nothing yet";
  std::vector<std::string> said;
  BorderRouter router{io, [this](const std::string& json) { document = json; },
                      [this](Notice& notice) { said.push_back(notice.text); }, bus->address()};
};

TEST_F(BorderRouterTest, ReadsStateOfOtbrAgentAndNoKey) {
  agent.neighbours = {{0x1122334455667788, 0x4401, 2, -71, false, true},
                      {0x99aabbccddeeff00, 0x8000, 3, 127, true, false}};
  document = "{}";
  agent.come();
  ASSERT_TRUE(has_role("leader")) << document;
  const json expected = json::parse(R"({
    "role": "leader", "network_name": "SLAM", "channel": 15, "rloc16": "0x4400",
    "extended_address": "d2e15a0c0b0a0908", "partition_id": 439041101, "leader_router_id": 17,
    "neighbours": [
      {"extended_address": "1122334455667788", "rloc16": "0x4401", "child": true, "sleepy": true,
       "link_quality": 2, "rssi_average_dbm": -71, "rssi_last_dbm": -72,
       "frame_error_rate": 0.01},
      {"extended_address": "99aabbccddeeff00", "rloc16": "0x8000", "child": false, "sleepy": false,
       "link_quality": 3, "rssi_average_dbm": null, "rssi_last_dbm": 126,
       "frame_error_rate": 0.01}],
    "left_out": 0})");
  EXPECT_EQ(json::parse(document), expected);
  EXPECT_EQ(agent.asked,
            (std::set<std::string>{"Channel", "DeviceRole", "ExtendedAddress", "LeaderData",
                                   "NeighborTable", "NetworkName", "Rloc16"}));
}

TEST_F(BorderRouterTest, IgnoresTableOfAnotherType) {
  agent.table_type = test::FakeOtbrAgent::older_table;
  agent.neighbours = {{0x1122334455667788, 0x4401, 2, -71, true, true}};
  document = "{}";
  agent.come();
  ASSERT_TRUE(has_role("leader")) << document;
  EXPECT_TRUE(json::parse(document)["neighbours"].is_null()) << document;
  EXPECT_TRUE(
      has_said("otbr-agent: its NeighborTable is not of type a(tuquuyyyqqqbbbb); it is ignored"))
      << said.back();
}

TEST_F(BorderRouterTest, OnePropertyWithoutAnswerDoesNotHoldTheOthersBack) {
  constexpr std::chrono::seconds before_the_bus_gives_up{20};  // after 25 s
  agent.unanswered = "NeighborTable";
  document = "{}";
  agent.come();
  ASSERT_TRUE(test::eventually(
      io,
      [&] {
        agent.process();
        return document != "{}" && !document.empty();
      },
      before_the_bus_gives_up));
  EXPECT_EQ(json::parse(document)["role"], "leader") << document;
  EXPECT_TRUE(json::parse(document)["neighbours"].is_null()) << document;
}

TEST_F(BorderRouterTest, FollowsRoleAndReportsNoLeaderWithoutNetwork) {
  document = "{}";
  agent.come();
  ASSERT_TRUE(has_role("leader")) << document;
  agent.change_role("detached");
  ASSERT_TRUE(has_role("detached")) << document;
  EXPECT_TRUE(json::parse(document)["leader_router_id"].is_null()) << document;
  EXPECT_EQ(router.role(), "detached");
  EXPECT_EQ(said.size(), 1u) << said.back();
}

TEST_F(BorderRouterTest, ClearsStateWhenOtbrAgentOrBusGoesAway) {
  ASSERT_TRUE(eventually([&] { return document.empty(); })) << "no otbr-agent yet";
  EXPECT_TRUE(said.empty());
  agent.come();
  ASSERT_TRUE(has_role("leader")) << document;
  agent.leave();
  ASSERT_TRUE(eventually([&] { return document.empty(); }));
  EXPECT_EQ(router.role(), "");
  agent.come();
  ASSERT_TRUE(has_role("leader")) << document;
  bus.reset();
  ASSERT_TRUE(eventually([&] { return document.empty(); }));
  agent.leave();
  bus.emplace(directory / "bus");
  agent.come();
  ASSERT_TRUE(has_role("leader")) << document;
  EXPECT_TRUE(has_said("Thread's border router (otbr-agent) is gone"));
}

}  // namespace
}  // namespace slamgw::border_router
