// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/rights_probe.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

using namespace std::chrono_literals;

/// The test plays the broker: it grants subscriptions and does not return published messages.
class RightsProbeTest : public testing::Test {
 protected:
  Now after(Duration time) const { return {TimePoint{} + 1h + time, WallTime{} + 1h}; }
  void link_is(bool is_up) {
    broker_.is_up = is_up;
    probe_.on_broker_link();
    drain(0s);
  }
  void pass(Duration until) {
    probe_.on_deadline(after(until));
    drain(until);
  }
  void drain(Duration now) {
    while (const auto action = actions_.pop()) {
      if (const auto* what = std::get_if<SubscribeAtBroker>(&*action))
        probe_.on_subscribe_result(what->filter, grants_, after(now));
      if (const auto* what = std::get_if<Upload>(&*action)) sent_.push_back(what->message);
      if (const auto* what = std::get_if<Notice>(&*action)) notices_.push_back(what->severity);
    }
  }
  /// Returns a published message to the gateway.
  void take(const BrokerMessage& message) {
    EXPECT_TRUE(probe_.take(message));
    drain(0s);
  }

  BrokerLink broker_;
  GatewayActions actions_;
  RightsProbe probe_{TopicScheme("lab", "gw1"), broker_, actions_};
  bool grants_ = true;
  std::vector<BrokerMessage> sent_;
  std::vector<Severity> notices_;
};

using Severities = std::vector<Severity>;

TEST_F(RightsProbeTest, FindsNothingMissingWhereBothMessagesComeBack) {
  link_is(true);
  ASSERT_EQ(sent_.size(), 2U);
  EXPECT_EQ(sent_[0].topic, "lab/gateway/gw1/probe");
  EXPECT_EQ(sent_[1].topic, "lab/server/gw1/probe");
  for (const BrokerMessage& message : std::vector(sent_)) take(message);
  pass(1h);
  EXPECT_EQ(sent_.size(), 2U);
  EXPECT_TRUE(probe_.missing().empty());
  EXPECT_TRUE(notices_.empty());
}

TEST_F(RightsProbeTest, NamesTheAccessListLineThatGrantsTheMissingRight) {
  link_is(true);
  take(sent_[0]);
  pass(9s);
  EXPECT_TRUE(probe_.missing().empty()) << "not before its deadline";
  pass(10s);
  ASSERT_EQ(probe_.missing().size(), 1U);
  EXPECT_NE(probe_.missing()[0].grant.find("topic read lab/server/#"), std::string::npos);
  EXPECT_EQ(notices_, Severities{Severity::warning});
  pass(11s);
  EXPECT_EQ(notices_.size(), 1U) << "once";
}

TEST_F(RightsProbeTest, ReportsWhenTheAccessListWasCorrected) {
  link_is(true);
  take(sent_[0]);
  pass(10s);
  pass(60s);
  ASSERT_EQ(sent_.size(), 3U);
  EXPECT_EQ(sent_[2].topic, "lab/server/gw1/probe");
  EXPECT_EQ(probe_.missing().size(), 1U) << "until the probe returns";
  take(sent_[2]);
  EXPECT_TRUE(probe_.missing().empty());
  EXPECT_EQ(notices_, (Severities{Severity::warning, Severity::notice}));
}

TEST_F(RightsProbeTest, ReportsMissingRightsAtOnceWhenTheBrokerRefusesASubscription) {
  grants_ = false;
  link_is(true);
  EXPECT_EQ(probe_.missing().size(), 2U);
  EXPECT_TRUE(sent_.empty());
  EXPECT_FALSE(probe_.on_subscribe_result("lab/server/other/#", false, after(0s)));
}

TEST_F(RightsProbeTest, SubscribesAgainWhereTheBrokerRefusedIt) {
  grants_ = false;
  link_is(true);
  pass(59s);
  EXPECT_EQ(probe_.deadline(), after(60s).mono);
  grants_ = true;  // the access list was corrected
  pass(60s);
  ASSERT_EQ(sent_.size(), 2U);
  for (const BrokerMessage& message : std::vector(sent_)) take(message);
  EXPECT_TRUE(probe_.missing().empty());
}

TEST_F(RightsProbeTest, AcceptsOnlyItsOwnProbeMessages) {
  link_is(true);
  BrokerMessage old = sent_[1];
  old.payload.push_back('x');
  take(old);
  pass(10s);
  EXPECT_EQ(probe_.missing().size(), 2U);
  EXPECT_FALSE(probe_.take({"lab/server/gw1/cmd", {}, Qos::at_most_once, false}));
}

TEST_F(RightsProbeTest, ReportsNothingMissingWhileTheBrokerIsAway) {
  link_is(true);
  link_is(false);
  EXPECT_FALSE(probe_.deadline());
  pass(1h);
  EXPECT_EQ(sent_.size(), 2U);
  EXPECT_TRUE(probe_.missing().empty());
}

}  // namespace
}  // namespace slamgw
