// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/connect_failure.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

TEST(ConnectFailure, ExplainsEachConnackCode) {
  EXPECT_EQ(explain_connect_failure(0x87), "the broker does not authorise this user");
  EXPECT_EQ(explain_connect_failure(5), "the broker does not authorise this user");
  EXPECT_EQ(explain_connect_failure(4), "the broker refuses user name or password");
  EXPECT_EQ(explain_connect_failure(0x9f), "the broker refuses: Connection rate exceeded");
  EXPECT_EQ(explain_connect_failure(0xfe), "the broker refuses with code 0xfe");
  EXPECT_EQ(explain_connect_failure(0), "the broker refuses with code 0x00");
}

TEST(ConnectFailure, ExplainsEachRefusalOfAMessage) {
  EXPECT_EQ(explain_publish_refusal(0x87), "not authorised");
  EXPECT_EQ(explain_publish_refusal(0x90), "topic name invalid");
  EXPECT_EQ(explain_publish_refusal(0x97), "quota exceeded");
  EXPECT_EQ(explain_publish_refusal(0xfe), "no reason given");
  EXPECT_EQ(explain_publish_refusal(0), "no reason given");
}

TEST(ConnectFailure, ClassifiesTheAnswerForTheNextAttempt) {
  EXPECT_TRUE(is_version_refusal(1));
  EXPECT_TRUE(is_version_refusal(0x84));
  EXPECT_FALSE(is_version_refusal(5));
  for (const int code : {4, 5, 0x86, 0x87}) EXPECT_TRUE(is_not_authorised(code)) << code;
  EXPECT_FALSE(is_not_authorised(0x88));
}

}  // namespace
}  // namespace slamgw
