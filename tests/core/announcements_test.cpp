// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/announcements.hpp"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

namespace slamgw {
namespace {

TEST(Announcements, OutcomeIsValidJsonForAnyCommandType) {
  for (const std::string type : {"target", R"(a"b\c)", "\xc3\xa6", "tab\there"}) {
    const CommandOutcome outcome{Mesh::thread,
                                 CommandId{1},
                                 "r1",
                                 type,
                                 CommandResult::refused,
                                 std::chrono::milliseconds{7},
                                 "it said \"no\""};
    const auto json = nlohmann::ordered_json::parse(outcome_json(outcome));
    const nlohmann::ordered_json expected{
        {"type", type}, {"outcome", "refused"}, {"after_ms", 7}, {"why", "it said \"no\""}};
    EXPECT_EQ(json.dump(), expected.dump());
  }
}

TEST(Announcements, TextThatIsNotUtf8BecomesValidJson) {
  EXPECT_EQ(json_string("a\xff\xfe z"), "\"a\xef\xbf\xbd\xef\xbf\xbd z\"");
}

}  // namespace
}  // namespace slamgw
