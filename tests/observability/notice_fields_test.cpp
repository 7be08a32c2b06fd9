// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/notice_fields.hpp"

#include <gtest/gtest.h>

#include <set>

namespace slamgw {
namespace {

TEST(NoticeFields, NameTheKindTheRobotAndTheTime) {
  const LogFields fields = notice_fields(
      {Severity::info, "text", "NRF_5", Occasion::command_outcome, std::chrono::milliseconds(12)});
  ASSERT_EQ(fields.size(), 3U);
  EXPECT_EQ(fields[0].value, message_id_of(Occasion::command_outcome));
  EXPECT_EQ(fields[1].value, "NRF_5");
  EXPECT_EQ(fields[2].value, "12000");
  EXPECT_TRUE(notice_fields({Severity::info, "text", {}}).empty());
}

TEST(NoticeFields, HaveAnIdOfTheirOwnForEachOccasion) {
  std::set<std::string_view> ids;
  for (int i = 1; i <= static_cast<int>(Occasion::broker_link); ++i) {
    const std::string_view id = message_id_of(static_cast<Occasion>(i));
    EXPECT_EQ(id.size(), 32U);
    EXPECT_TRUE(ids.insert(id).second) << i;
  }
}

}  // namespace
}  // namespace slamgw
