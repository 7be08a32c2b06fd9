// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/connect_failure.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

TEST(ConnectFailure, HasWordsForEveryAnswer) {
  EXPECT_EQ(explain_connect_failure(0x87), "the broker does not authorise this user");
  EXPECT_EQ(explain_connect_failure(5), "the broker does not authorise this user");
  EXPECT_EQ(explain_connect_failure(0xfe), "the broker refuses with code 0xfe");
}

TEST(ConnectFailure, TellsWhatToDoDifferentlyNextTime) {
  EXPECT_TRUE(is_version_refusal(1));
  EXPECT_TRUE(is_version_refusal(0x84));
  EXPECT_FALSE(is_version_refusal(5));
  for (const int code : {4, 5, 0x86, 0x87}) EXPECT_TRUE(is_not_authorised(code)) << code;
  EXPECT_FALSE(is_not_authorised(0x88));
}

}  // namespace
}  // namespace slamgw
