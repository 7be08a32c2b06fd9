// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/fleet_message.hpp"

#include <gtest/gtest.h>

namespace slamgw::fleet {
namespace {

std::optional<FleetMessage> read(const std::string& text) { return decode("gw-1", as_bytes(text)); }

TEST(FleetMessage, ComesBackAsItWas) {
  const auto beat = read(encode(0x1234, Beat{-5, 500, 3, 0xfedcba9876543210}));
  ASSERT_TRUE(beat);
  EXPECT_EQ(beat->sender, "gw-1");
  EXPECT_EQ(beat->life, 0x1234U);
  EXPECT_EQ(std::get<Beat>(beat->body).sent_ms, -5);
  EXPECT_EQ(std::get<Beat>(beat->body).digest, 0xfedcba9876543210U);
  const auto release = read(encode(1, Release{"r.1 *", {7, "gw-2", 9}, {0, 255, 16}}));
  ASSERT_TRUE(release);
  EXPECT_EQ(std::get<Release>(release->body).to, (Claim{7, "gw-2", 9}));
  EXPECT_EQ(std::get<Release>(release->body).session, (Bytes{0, 255, 16}));
  EXPECT_EQ(std::get<Release>(release->body).sent_ms, 0) << "a gateway of before may not say it";
  const auto taken = read(encode(1, Taken{1, 2, "r", "cmd", 3, false, true, -4, 5}));
  ASSERT_TRUE(taken);
  EXPECT_TRUE(std::get<Taken>(taken->body).is_ended);
  EXPECT_EQ(std::get<Taken>(taken->body).sent_ms, -4);
  EXPECT_EQ(std::get<Taken>(taken->body).kept_ms, 5U);
  const auto table = read(encode(1, Table{"a", "c", {{"b", 4}, {"c", 5}}}));
  ASSERT_TRUE(table);
  EXPECT_EQ(std::get<Table>(table->body).rows.size(), 2U);
  const auto hears = read(encode(1, Hears{true, {{"r.1 *", -61, 120}, {"s", -1000, 0}}}));
  ASSERT_TRUE(hears);
  EXPECT_TRUE(std::get<Hears>(hears->body).is_board_up);
  EXPECT_EQ(std::get<Hears>(hears->body).rows.at(0).robot, "r.1 *");
  EXPECT_EQ(std::get<Hears>(hears->body).rows.at(0).level_db, -61);
  EXPECT_EQ(std::get<Hears>(hears->body).rows.at(0).age_ms, 120U);
}

TEST(FleetMessage, IsNothingWhenAnythingIsWrong) {
  for (
      const char* text : {
          "",
          "null",
          "[]",
          "{}",
          R"({"v":1})",
          R"({"v":2,"b":"1","k":"ask"})",
          R"({"v":1,"b":1,"k":"ask"})",
          R"({"v":1,"b":"","k":"ask"})",
          R"({"v":1,"b":"1","k":"unheard"})",
          R"({"v":1,"b":"1","k":"claim","robot":"a/b","epoch":1,"from":""})",
          R"({"v":1,"b":"1","k":"claim","robot":"","epoch":1,"from":""})",
          R"({"v":1,"b":"1","k":"claim","robot":"a","epoch":-1,"from":""})",
          R"({"v":1,"b":"1","k":"claim","robot":"a","epoch":1.5,"from":""})",
          R"({"v":1,"b":"1","k":"claim","robot":"a","epoch":18446744073709551615,"from":""})",
          R"({"v":1,"b":"1","k":"claim","robot":"a","epoch":1,"from":"+"})",
          R"({"v":1,"b":"1","k":"beat","sent":1,"period":0,"count":0,"digest":"0"})",
          R"({"v":1,"b":"1","k":"beat","sent":1,"period":999999,"count":0,"digest":"0"})",
          R"({"v":1,"b":"1","k":"release","robot":"a","epoch":1,"to":"b","life":"1","session":"0"})",
          R"({"v":1,"b":"1","k":"table","after":"b","upto":"","rows":[["a",1]]})",
          R"({"v":1,"b":"1","k":"table","after":"","upto":"","rows":[["a"]]})",
          R"({"v":1,"b":"1","k":"table","after":"","upto":"","rows":[["b",1],["a",1]]})",
          R"({"v":1,"b":"1","k":"table","after":"","upto":"","rows":[["a",1],["a",1]]})",
          R"({"v":1,"b":"1","k":"hears","rows":[]})",
          R"({"v":1,"b":"1","k":"hears","up":1,"rows":[]})",
          R"({"v":1,"b":"1","k":"hears","up":true,"rows":{}})",
          R"({"v":1,"b":"1","k":"hears","up":true,"rows":[["a",-60]]})",
          R"({"v":1,"b":"1","k":"hears","up":true,"rows":[["a",-60.5,0]]})",
          R"({"v":1,"b":"1","k":"hears","up":true,"rows":[["a",101,0]]})",
          R"({"v":1,"b":"1","k":"hears","up":true,"rows":[["a",-60,-1]]})",
          R"({"v":1,"b":"1","k":"hears","up":true,"rows":[["a/b",-60,1]]})",
      }) {
    EXPECT_FALSE(read(text)) << text;
  }
  EXPECT_FALSE(read(std::string(1'000'000, '[')));
  EXPECT_FALSE(decode("a/b", as_bytes(encode(1, AskTable{}))));
  EXPECT_TRUE(read(encode(1, AskTable{})));
}

}  // namespace
}  // namespace slamgw::fleet
