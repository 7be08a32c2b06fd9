// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/subscription_table.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

class SubscriptionTableTest : public testing::Test {
 protected:
  SubscriptionId subscribe(const std::string& filter) {
    const SubscriptionId id = table.add(Mesh::thread, filter, Qos::at_least_once).id;
    table.on_answer(filter, true);
    return id;
  }
  bool takes(const std::string& topic, std::vector<SubscriptionId> ids) {
    return table.is_copy_to_take({topic, to_bytes("hi"), Qos::at_least_once, false}, ids);
  }

  SubscriptionTable table;
};

TEST_F(SubscriptionTableTest, KeepsOneIdForTheLifeOfAFilter) {
  const SubscriptionId first = table.add(Mesh::ble, "f", Qos::at_most_once).id;
  EXPECT_NE(first, 0u);
  EXPECT_EQ(table.add(Mesh::thread, "f", Qos::at_least_once).id, first);
  EXPECT_EQ(table.wanted().at("f").qos, Qos::at_least_once);
  EXPECT_NE(table.add(Mesh::thread, "g", Qos::at_most_once).id, first);
}

TEST_F(SubscriptionTableTest, R103_TakesOneOfTheCopiesForOverlappingFilters) {
  const SubscriptionId any = subscribe("server/a/+");
  const SubscriptionId exact = subscribe("server/a/cmd");
  EXPECT_NE(takes("server/a/cmd", {any}), takes("server/a/cmd", {exact}));
  EXPECT_TRUE(takes("server/a/cmd", {exact, any})) << "a broker may send one copy for both";
  EXPECT_TRUE(takes("server/a/run", {any}));
}

TEST_F(SubscriptionTableTest, TakesTheCopyOfTheHighestQos) {
  const SubscriptionId exact = subscribe("server/a/cmd");
  for (const std::string filter : {"server/a/+", "server/#", "#"}) {
    const SubscriptionId fleeting = table.add(Mesh::thread, filter, Qos::at_most_once).id;
    table.on_answer(filter, true);
    EXPECT_FALSE(takes("server/a/cmd", {fleeting})) << filter;
  }
  EXPECT_TRUE(takes("server/a/cmd", {exact}));
}

TEST_F(SubscriptionTableTest, GivesAFilterTheSameIdAfterARestart) {
  const SubscriptionId id = subscribe("server/a/cmd");
  SubscriptionTable restarted;
  restarted.add(Mesh::thread, "server/b/cmd", Qos::at_least_once);
  EXPECT_EQ(restarted.add(Mesh::thread, "server/a/cmd", Qos::at_least_once).id, id);
}

TEST_F(SubscriptionTableTest, TakesTheOtherCopyWhileASubscriptionDoesNotStandYet) {
  const SubscriptionId asked = table.add(Mesh::ble, "server/a/+", Qos::at_least_once).id;
  const SubscriptionId standing = subscribe("server/a/cmd");
  EXPECT_TRUE(takes("server/a/cmd", {standing})) << "the broker does not send the other copy yet";
  table.on_answer("server/a/+", true);
  EXPECT_NE(takes("server/a/cmd", {standing}), takes("server/a/cmd", {asked}));
}

TEST_F(SubscriptionTableTest, TakesOneCopyOfWhatTheBrokerKeptWhileNothingStands) {
  const SubscriptionId any = subscribe("server/+/+");
  const SubscriptionId exact = subscribe("server/a/cmd");
  table.on_connection_changed(/*is_session_kept=*/true);
  EXPECT_TRUE(takes("server/a/cmd", {any}));
  EXPECT_FALSE(takes("server/a/cmd", {exact}));
  EXPECT_TRUE(takes("server/a/cmd", {any})) << "the same once more";
  table.on_answer("server/a/cmd", true);
  EXPECT_FALSE(takes("server/a/cmd", {exact})) << "its other copy, after the answer";
  EXPECT_TRUE(takes("server/a/cmd", {exact}));
}

TEST_F(SubscriptionTableTest, R103_CountsCopiesOfABrokerThatNamesNoSubscription) {
  subscribe("server/a/+");
  EXPECT_TRUE(takes("server/a/cmd", {}));
  EXPECT_TRUE(takes("server/a/cmd", {})) << "one subscription: the same again is another message";
  subscribe("server/a/cmd");
  subscribe("server/#");
  for (int message = 0; message < 2; ++message) {
    EXPECT_TRUE(takes("server/a/cmd", {})) << message;
    EXPECT_FALSE(takes("server/a/cmd", {})) << message;
    EXPECT_FALSE(takes("server/a/cmd", {})) << message;
  }
  EXPECT_TRUE(takes("server/a/cmd", {}));
  EXPECT_TRUE(takes("server/a/run", {})) << "another message ends the row";
  EXPECT_FALSE(takes("server/a/run", {}));
  EXPECT_TRUE(takes("server/a/cmd", {}));
}

TEST_F(SubscriptionTableTest, TakesEveryMessageOfABrokerThatSendsNoCopies) {
  subscribe("server/+/+");
  subscribe("server/a/+");
  table.set_sends_copies(false);
  EXPECT_TRUE(takes("server/a/cmd", {}));
  EXPECT_TRUE(takes("server/a/cmd", {})) << "the same command again";
  table.on_connection_changed(/*is_session_kept=*/true);
  subscribe("server/+/+");
  subscribe("server/a/+");
  EXPECT_TRUE(takes("server/a/cmd", {}));
  EXPECT_FALSE(takes("server/a/cmd", {})) << "another broker perhaps: nothing is known of it yet";
}

TEST_F(SubscriptionTableTest, KnowsWhatOneFilterAloneBrings) {
  EXPECT_FALSE(table.is_only_of("server/+/+", "server/a/cmd")) << "nobody wants it";
  subscribe("server/+/+");
  EXPECT_TRUE(table.is_only_of("server/+/+", "server/a/cmd"));
  subscribe("server/a/+");
  EXPECT_FALSE(table.is_only_of("server/+/+", "server/a/cmd"));
  EXPECT_TRUE(table.is_only_of("server/+/+", "server/b/cmd"));
}

TEST_F(SubscriptionTableTest, LetsTheOthersStandInForAFilterThatHasGone) {
  subscribe("server/a/+");
  const SubscriptionId exact = subscribe("server/a/cmd");
  table.remove(Mesh::thread, "server/a/+");
  EXPECT_TRUE(takes("server/a/cmd", {exact}));
}

TEST_F(SubscriptionTableTest, ForgetsWhatStoodAtABrokerThatHasGone) {
  subscribe("server/a/+");
  const SubscriptionId exact = subscribe("server/a/cmd");
  table.await(Mesh::ble, "server/a/+");
  table.on_connection_changed(/*is_session_kept=*/true);
  const auto waiting = table.take_all_waiting();
  ASSERT_EQ(waiting.size(), 1u);
  EXPECT_EQ(waiting[0].filter, "server/a/+");
  table.on_answer("server/a/cmd", true);
  EXPECT_TRUE(takes("server/a/cmd", {exact})) << "the other is not subscribed again yet";
}

TEST_F(SubscriptionTableTest, ForgetsAFilterThatTheBrokerRefuses) {
  table.add(Mesh::ble, "f", Qos::at_least_once);
  table.await(Mesh::ble, "f");
  EXPECT_EQ(table.on_answer("f", false), std::vector<Mesh>{Mesh::ble});
  EXPECT_TRUE(table.wanted().empty());
}

}  // namespace
}  // namespace slamgw
