// SPDX-License-Identifier: Apache-2.0
// The published state of a Thread border router, and its times.
#include "adapters/thread_border_router/border_router_watch.hpp"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

namespace slamgw::border_router {
namespace {

using nlohmann::json;
using std::chrono::seconds;

class BorderRouterWatchTest : public ::testing::Test {
 protected:
  /// The actions since the last call, a line each.
  std::vector<std::string> done() {
    std::vector<std::string> lines;
    while (auto action = watch.next_action()) {
      if (std::holds_alternative<ReadNode>(*action)) lines.emplace_back("read");
      if (const auto* notice = std::get_if<Notice>(&*action)) lines.push_back(notice->text);
      if (const auto* document = std::get_if<PublishDocument>(&*action)) {
        lines.emplace_back(document->json.empty() ? "take back" : "publish");
        published = document->json;
      }
    }
    return lines;
  }
  void read(const NodeFacts& facts) { watch.on_read(facts, now.mono); }
  void pass(seconds time) {
    now.mono += time;
    watch.on_deadline(now);
  }
  using Lines = std::vector<std::string>;

  static NodeFacts leader() {
    NodeFacts facts;
    facts.role = "leader";
    facts.network_name = "SLAM";
    facts.channel = 15;
    facts.rloc16 = 0x4400;
    facts.extended_address = 0x00e15a0c0b0a0908;
    facts.partition_id = 0x1a2b3c4d;
    facts.leader_router_id = 17;
    facts.neighbours = std::vector<Neighbour>{
        Neighbour{0x1122334455667788, 0x4401, 3, -60, -61, 655, false, true}};
    return facts;
  }

  BorderRouterWatch watch;
  Now now{TimePoint(seconds(100)), {}};
  std::string published;
};

TEST_F(BorderRouterWatchTest, PublishesStateOfBorderRouter) {
  watch.on_broker_link(true);
  watch.on_came(now.mono);
  pass(seconds(0));
  EXPECT_EQ(done(), Lines{"read"});
  read(leader());
  EXPECT_EQ(done(), (Lines{"Thread's border router (otbr-agent) is here: leader", "publish"}));
  EXPECT_EQ(json::parse(published), json::parse(R"({
    "role": "leader", "network_name": "SLAM", "channel": 15, "rloc16": "0x4400",
    "extended_address": "00e15a0c0b0a0908", "partition_id": 439041101, "leader_router_id": 17,
    "neighbours": [{"extended_address": "1122334455667788", "rloc16": "0x4401", "child": true,
      "sleepy": true, "link_quality": 3, "rssi_average_dbm": -60, "rssi_last_dbm": -61,
      "frame_error_rate": 0.01}],
    "left_out": 0})"));
  EXPECT_EQ(watch.role(), "leader");
}

TEST_F(BorderRouterWatchTest, PublishesNullForUnknownValues) {
  watch.on_broker_link(true);
  watch.on_came(now.mono);
  NodeFacts facts;
  facts.role = "king";
  facts.network_name = "more than sixteen";
  facts.channel = 300;
  facts.rloc16 = 0xfffe;
  read(facts);
  EXPECT_EQ(done(), Lines{"publish"});
  EXPECT_EQ(json::parse(published),
            json::parse(R"({"role": null, "network_name": null, "channel": null, "rloc16": null,
    "extended_address": null, "partition_id": null, "leader_router_id": null, "neighbours": null,
    "left_out": 0})"));
  EXPECT_EQ(watch.role(), "");
  facts.neighbours = std::vector<Neighbour>(1);
  read(facts);
  done();
  const json neighbour = json::parse(published)["neighbours"][0];
  EXPECT_TRUE(neighbour["rssi_average_dbm"].is_null()) << neighbour;
  EXPECT_TRUE(neighbour["rssi_last_dbm"].is_null()) << neighbour;
}

TEST_F(BorderRouterWatchTest, PublishesChangesAndEverythingAtEachConnection) {
  watch.on_came(now.mono);
  read(leader());
  done();
  watch.on_broker_link(true);
  EXPECT_EQ(done(), Lines{"publish"});
  read(leader());
  EXPECT_EQ(done(), Lines{});
  NodeFacts changed = leader();
  changed.neighbours->front().link_quality = 1;
  read(changed);
  EXPECT_EQ(done(), Lines{"publish"});
  watch.on_broker_link(false);
  read(leader());
  EXPECT_EQ(done(), Lines{});
  watch.on_broker_link(true);
  EXPECT_EQ(done(), Lines{"publish"});
}

TEST_F(BorderRouterWatchTest, ClearsStateWhenThereIsNoBorderRouter) {
  watch.on_broker_link(true);
  EXPECT_EQ(done(), Lines{}) << "the state is not known yet";
  watch.on_gone();
  EXPECT_EQ(done(), Lines{"take back"}) << "an earlier run may have left it";
  watch.on_gone();
  EXPECT_EQ(done(), Lines{});
  watch.on_came(now.mono);
  read(leader());
  done();
  watch.on_gone();
  EXPECT_EQ(done(), (Lines{"Thread's border router (otbr-agent) is gone", "take back"}));
  EXPECT_EQ(watch.role(), "");
  EXPECT_FALSE(watch.deadline());
}

TEST_F(BorderRouterWatchTest, ReadsRegularlyAndSoonerAfterAChange) {
  watch.on_came(now.mono);
  pass(seconds(0));
  EXPECT_EQ(done(), Lines{"read"});
  EXPECT_FALSE(watch.deadline()) << "one reading at a time";
  read(NodeFacts());
  EXPECT_EQ(watch.deadline(), now.mono + seconds(10));
  const TimePoint reported = now.mono;
  for (int i = 0; i < 100; ++i) watch.on_changed(now.mono += std::chrono::milliseconds(1));
  EXPECT_LE(watch.deadline(), reported + seconds(2)) << "more changes do not delay it further";
  pass(seconds(1));
  EXPECT_EQ(done(), Lines{"read"});
}

TEST_F(BorderRouterWatchTest, WarnsOfAProblemOnce) {
  watch.on_came(now.mono);
  NodeFacts facts;
  facts.problem = "its NeighborTable is strange";
  read(facts);
  EXPECT_EQ(done(), Lines{"otbr-agent: its NeighborTable is strange"});
  read(facts);
  EXPECT_EQ(done(), Lines{});
}

TEST_F(BorderRouterWatchTest, StaysBelow64KibWithMostNeighbours) {
  watch.on_broker_link(true);
  watch.on_came(now.mono);
  NodeFacts facts = leader();
  facts.left_out = UINT64_MAX;
  facts.neighbours->assign(NodeFacts::max_neighbours,
                           {UINT64_MAX, 0x4401, 255, -128, -128, 0x1234, true, false});
  read(facts);
  done();
  EXPECT_EQ(json::parse(published)["neighbours"].size(), NodeFacts::max_neighbours);
  EXPECT_LT(published.size(), 64 * 1024u);
}

}  // namespace
}  // namespace slamgw::border_router
