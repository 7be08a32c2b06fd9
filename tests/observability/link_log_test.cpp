// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/link_log.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

using namespace std::chrono_literals;

TEST(LinkLog, WarnsOfNewReasonAtOnceAndSummarizesRepeats) {
  LinkLog log("mqtt://a");
  const TimePoint start{};
  const auto first = log.on_down("no route", start);
  ASSERT_TRUE(first);
  EXPECT_EQ(first->severity, Severity::warning);
  EXPECT_EQ(first->text, "cannot reach broker mqtt://a: no route; retrying");
  EXPECT_FALSE(log.on_down("no route", start + 30s));
  const auto other = log.on_down("refused", start + 31s);
  ASSERT_TRUE(other);
  EXPECT_EQ(other->text, "cannot reach broker mqtt://a: refused; retrying");
  EXPECT_FALSE(log.on_down("refused", start + 61s));
  const auto summary = log.on_down("refused", start + 92s);
  ASSERT_TRUE(summary);
  EXPECT_EQ(summary->text, "cannot reach broker mqtt://a: refused; retrying (2 attempts)");
}

TEST(LinkLog, DoesNotWarnWhenItLeavesBrokerOnPurpose) {
  LinkLog log("mqtt://a,mqtt://b");
  log.rename("mqtt://b");
  const Notice left = log.on_left("the first broker of the list takes connections again");
  EXPECT_EQ(left.severity, Severity::info);
  EXPECT_EQ(left.text,
            "leaving broker mqtt://b: the first broker of the list takes connections again");
  EXPECT_EQ(left.occasion, Occasion::broker_link);
}

}  // namespace
}  // namespace slamgw
