// SPDX-License-Identifier: Apache-2.0
// What a gateway's table leaves out, when it comes in many messages.
#include "daemon/fleet/table_sweep.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <set>

namespace slamgw::fleet::test {
namespace {

using Names = std::vector<std::string>;

constexpr int robots = 20'000;
constexpr int in_a_message = 500;

std::string name_of(int robot) { return fmt::format("r{:05}", robot); }

class Sweep : public testing::Test {
 protected:
  void SetUp() override {
    for (int i = 0; i < robots; ++i) known.set(name_of(i), {1, "gw-1", 7}, {});
  }
  /// One of all messages of gw-1's table, without some robots.
  Table message_of(int number, const std::set<int>& without) const {
    const int first = number * in_a_message;
    const int next = first + in_a_message;
    Table message{
        number == 0 ? "" : name_of(first - 1), next < robots ? name_of(next - 1) : "", {}};
    for (int i = first; i < next; ++i)
      if (!without.contains(i)) message.rows.push_back({name_of(i), 1});
    return message;
  }
  Names unlisted(int number, const std::set<int>& without, Life life = 7) {
    const Table message = message_of(number, without);
    Names found = sweep.unlisted(known, "gw-1", life, message);
    if (message.upto.empty()) sweep.on_last_message("gw-1");
    return found;
  }
  ClaimTable known;
  TableSweep sweep;
};

TEST_F(Sweep, LooksAtAllRowsOnceForATableOfManyMessages) {
  Names found;
  for (int number = 0; number < robots / in_a_message; ++number)
    for (const std::string& robot : unlisted(number, {0, 499, 500, 7777, 19'999}))
      found.push_back(robot);
  EXPECT_EQ(found, (Names{"r00000", "r00499", "r00500", "r07777", "r19999"}));
  EXPECT_EQ(sweep.walks(), 1U);
}

TEST_F(Sweep, LooksAgainForTheNextTable) {
  EXPECT_EQ(unlisted(39, {}), Names{});
  known.set("r19500x", {1, "gw-1", 7}, {});
  EXPECT_EQ(unlisted(39, {}), Names{"r19500x"});
}

/// A message of another table, or one that is lost, changes nothing for the others.
TEST_F(Sweep, TakesMessagesInAnyOrder) {
  EXPECT_EQ(unlisted(7, {3600}), Names{"r03600"});
  EXPECT_EQ(unlisted(3, {1600}), Names{"r01600"});
  EXPECT_EQ(unlisted(7, {}), Names{});
  EXPECT_EQ(sweep.walks(), 1U);
}

TEST_F(Sweep, LeavesWhatAnotherGatewayHasClaimedMeanwhile) {
  EXPECT_EQ(unlisted(1, {}), Names{});
  known.set(name_of(1000), {2, "gw-2", 1}, {});
  EXPECT_EQ(unlisted(2, {1000, 1001}), Names{"r01001"});
}

TEST_F(Sweep, OfAnotherLifeBeginsAnew) {
  EXPECT_EQ(unlisted(1, {}), Names{});
  known.set(name_of(1000), {2, "gw-1", 8}, {});
  EXPECT_EQ(unlisted(2, {1000, 1001}, 8), Names{"r01000"});
}

TEST_F(Sweep, KeepsNoMoreNamesThanATableHasRows) {
  for (int i = robots; i < static_cast<int>(ClaimTable::max_rows); ++i)
    known.set(name_of(i), {1, "gw-2", 7}, {});
  sweep.unlisted(known, "gw-2", 7, {"a", "b", {}});
  for (const int robot : {0, 1, 2}) known.set(name_of(180'000 + robot), {2, "gw-1", 7}, {});
  sweep.unlisted(known, "gw-1", 7, {"a", "b", {}});  // more names than rows: one robot was both's
  EXPECT_EQ(sweep.walks(), 2U);
  sweep.unlisted(known, "gw-1", 7, {"a", "b", {}});
  EXPECT_EQ(sweep.walks(), 2U);
  sweep.unlisted(known, "gw-2", 7, {"a", "b", {}});
  EXPECT_EQ(sweep.walks(), 3U) << "its names had to go";
}

}  // namespace
}  // namespace slamgw::fleet::test
