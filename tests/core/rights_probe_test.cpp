// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/rights_probe.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

using namespace std::chrono_literals;

class RightsProbeTest : public testing::Test {
 protected:
  Now after(Duration time) const { return {TimePoint{} + 1h + time, WallTime{} + 1h}; }
  void connect() {
    probe_.on_broker_link(true);
    for (const std::string& filter : probe_.filters())
      if (auto message = probe_.on_subscribe_result(filter, true, after(0s)))
        sent_.push_back(*message);
  }

  RightsProbe probe_{TopicScheme("lab", "gw1")};
  std::vector<BrokerMessage> sent_;
};

TEST_F(RightsProbeTest, FindsNothingMissingWhereBothMessagesComeBack) {
  connect();
  ASSERT_EQ(sent_.size(), 2U);
  EXPECT_EQ(sent_[0].topic, "lab/gateway/gw1/probe");
  EXPECT_EQ(sent_[1].topic, "lab/server/gw1/probe");
  for (const BrokerMessage& message : sent_) EXPECT_TRUE(probe_.take(message));
  EXPECT_TRUE(probe_.on_tick(after(1h)).empty());
  EXPECT_TRUE(probe_.missing().empty());
  EXPECT_FALSE(probe_.next_notice());
}

TEST_F(RightsProbeTest, NamesTheLineThatGrantsWhatIsMissing) {
  connect();
  probe_.take(sent_[0]);
  EXPECT_TRUE(probe_.on_tick(after(9s)).empty());
  EXPECT_TRUE(probe_.missing().empty()) << "not before its time";
  probe_.on_tick(after(10s));
  ASSERT_EQ(probe_.missing().size(), 1U);
  EXPECT_NE(probe_.missing()[0].grant.find("topic read lab/server/#"), std::string::npos);
  const auto notice = probe_.next_notice();
  ASSERT_TRUE(notice);
  EXPECT_EQ(notice->severity, Severity::warning);
  EXPECT_FALSE(probe_.next_notice()) << "once";
}

TEST_F(RightsProbeTest, SeesWhenTheListWasCorrected) {
  connect();
  probe_.take(sent_[0]);
  probe_.on_tick(after(10s));
  EXPECT_TRUE(probe_.next_notice());
  const auto again = probe_.on_tick(after(60s));
  ASSERT_EQ(again.size(), 1U);
  EXPECT_EQ(again[0].topic, "lab/server/gw1/probe");
  EXPECT_EQ(probe_.missing().size(), 1U) << "until it is heard";
  probe_.take(again[0]);
  EXPECT_TRUE(probe_.missing().empty());
  const auto notice = probe_.next_notice();
  ASSERT_TRUE(notice);
  EXPECT_EQ(notice->severity, Severity::notice);
}

TEST_F(RightsProbeTest, TakesARefusedSubscriptionAtItsWord) {
  probe_.on_broker_link(true);
  EXPECT_FALSE(probe_.on_subscribe_result("lab/server/gw1/probe", false, after(0s)));
  EXPECT_EQ(probe_.missing().size(), 1U);
  EXPECT_FALSE(probe_.on_subscribe_result("lab/server/other/#", false, after(0s)));
}

TEST_F(RightsProbeTest, KnowsItsOwnMessagesOnly) {
  connect();
  BrokerMessage old = sent_[1];
  old.payload.push_back('x');
  EXPECT_TRUE(probe_.take(old)) << "nobody else's business all the same";
  probe_.on_tick(after(10s));
  EXPECT_EQ(probe_.missing().size(), 2U);
  EXPECT_FALSE(probe_.take({"lab/server/gw1/cmd", {}, Qos::at_most_once, false}));
}

TEST_F(RightsProbeTest, WaitsForNothingWhileTheBrokerIsAway) {
  connect();
  probe_.on_broker_link(false);
  EXPECT_TRUE(probe_.on_tick(after(1h)).empty());
  EXPECT_TRUE(probe_.missing().empty());
}

}  // namespace
}  // namespace slamgw
