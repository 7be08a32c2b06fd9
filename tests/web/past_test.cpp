// SPDX-License-Identifier: Apache-2.0
#include "web/server/past.hpp"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "web/server/mirror.hpp"

namespace slamgw::web::test {
namespace {

using nlohmann::json;
using namespace std::string_literals;

const std::string place = "\x01\0\x02\0"s;
constexpr std::int64_t start = 1'800'000'000'000;

json past_of(const Past& past, const std::string& topic, std::int64_t since, std::int64_t now) {
  for (const auto& [name, text] : past.texts(since, now))
    if (name == topic) return json::parse(*text)["payload"];
  return {};
}

TEST(WebPast, ReturnsUpdatesInOrderWithTheirTimes) {
  Past past;
  past.on_update("r", place, start);
  past.on_update("r", place + "\x03\0\x04\0\x7f"s, start + 200);
  past.on_update("r", R"({"x":-1,"y":2.9,"obstacles":[{"x":32768,"y":0}]})", start + 400);
  EXPECT_EQ(past_of(past, "$web/past/r", 0, start + 500)["updates"],
            (json{{start, "01000200"},
                  {start + 200, "0100020003000400"},
                  {start + 400, "ffff0200ff7f0000"}}));
  EXPECT_EQ(past_of(past, "$web/past/r", start + 200, start + 500)["updates"].size(), 1u);
  EXPECT_TRUE(past_of(past, "$web/past/r", start + 400, start + 500).is_null());
}

TEST(WebPast, RecognizesPositionThatBeginsLikeJson) {
  Past past;
  past.on_update("r", "{\0\x02\0"s, start);  // x is 123 cm
  EXPECT_EQ(past_of(past, "$web/past/r", 0, start)["updates"], (json{{start, "7b000200"}}));
}

TEST(WebPast, IgnoresUpdatesThatPageDoesNotDraw) {
  Past past;
  for (const char* update :
       {R"({"speed":3})", R"({"x":1e6,"y":60})", R"({"x":1,"y":"2"})", R"({"x":-32769,"y":0})",
        R"({"x":1,"y":2,"obstacles":null})", R"({"x":1,"y":2,"obstacles":[{"x":3}]})",
        R"({"x":1,"y":2,"obstacles":[4]})"})
    past.on_update("r", update, start);
  EXPECT_EQ(past.updates(), 0u) << past_of(past, "$web/past/r", 0, start);
  past.on_update("r",
                 R"({"x":1,"y":2,"obstacles":[{"x":3,"y":4},{"x":3,"y":4},{"x":3,"y":4},)"
                 R"({"x":3,"y":4},null]})",
                 start);
  EXPECT_EQ(past.updates(), 1u) << "four obstacles are drawn, others are ignored";
}

TEST(WebPast, ReturnsEventsUnchanged) {
  Past past;
  for (int i = 0; i < 3; ++i)
    past.on_event(std::make_shared<const std::string>(R"({"topic":"a/server/r/cmd","at":)" +
                                                      std::to_string(start + i) + "}"),
                  start + i);
  EXPECT_EQ(past_of(past, "$web/past", start, start + 9)["events"],
            (json{{{"topic", "a/server/r/cmd"}, {"at", start + 1}},
                  {{"topic", "a/server/r/cmd"}, {"at", start + 2}}}));
}

TEST(WebPast, ForgetsAfterADay) {
  Past past;
  past.on_update("r", place, start);
  past.on_event(std::make_shared<const std::string>("{}"), start);
  const std::int64_t next_day = start + Past::length_ms + 1;
  EXPECT_TRUE(past_of(past, "$web/past/r", 0, next_day).is_null()) << "also before the next update";
  past.on_update("r", place, next_day);
  past.on_event(std::make_shared<const std::string>("{}"), next_day);
  EXPECT_EQ(past.updates(), 1u);
  EXPECT_EQ(past_of(past, "$web/past", 0, next_day)["events"].size(), 1u);
}

TEST(WebPast, ThinsOldUpdatesOfBusiestRobotBeyondItsBound) {
  Past past;
  past.on_update("quiet", place, start);
  for (std::size_t i = 0; i < Past::max_updates + 1000; ++i)
    past.on_update("busy", place, start + static_cast<std::int64_t>(i));
  EXPECT_LE(past.updates(), Past::max_updates);
  EXPECT_GT(past.updates(), Past::max_updates / 2);
  EXPECT_EQ(past_of(past, "$web/past/quiet", 0, start + 1)["updates"].size(), 1u);
  const json updates = past_of(past, "$web/past/busy", 0, start + 400'000)["updates"];
  EXPECT_EQ(updates.front()[0], start) << "the first is still known";
  EXPECT_EQ(updates.back()[0], start + Past::max_updates + 999);
  EXPECT_LE(updates.size(), Past::max_told_of_one + 2);
  EXPECT_EQ(updates[updates.size() - 2][0], start + Past::max_updates + 998)
      << "the newest in full";
}

TEST(WebPast, BoundsRobotsEventsAndAnswer) {
  Past past;
  for (std::size_t i = 0; i < Past::max_robots + 10; ++i)
    for (int n = 0; n < 40; ++n) past.on_update(std::to_string(i), place, start + n);
  const auto event = std::make_shared<const std::string>("\"" + std::string(10'000, 'x') + "\"");
  for (int i = 0; i < 1000; ++i) past.on_event(event, start);
  std::size_t bytes = 0;
  const auto texts = past.texts(0, start + 100);
  for (const auto& entry : texts) bytes += entry.second->size();
  EXPECT_EQ(texts.size(), Past::max_robots + 1);
  EXPECT_LT(bytes, (6u << 20));
  EXPECT_LT(past_of(past, "$web/past", 0, start)["events"].size(), 400u);
}

TEST(WebPast, IgnoresInvalidUpdates) {
  Past past;
  for (const std::string& payload : {""s, "abc"s, "abcdef"s, std::string(24, 'x'), "{"s,
                                     "{\"x\":1"s, "{" + std::string(300, ' ') + "}", "[]"s})
    past.on_update("r", payload, start);
  past.on_update("\xff", place, start);
  past.on_update("r", R"({"obstacles":[1,{},{},{},{},{},{},{}]})", start);
  EXPECT_EQ(past.updates(), 0u);
}

}  // namespace
}  // namespace slamgw::web::test
