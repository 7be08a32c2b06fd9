// SPDX-License-Identifier: Apache-2.0
// What pages receive of an MQTT message, read by an independent JSON parser.
#include "web/server/mirror.hpp"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "web/server/last_known.hpp"

namespace slamgw::web::test {
namespace {

using nlohmann::json;
using namespace std::string_literals;

json mirrored(const std::string& topic, const std::string& payload) {
  const Topics topics("ntnu-slam");
  const auto text =
      to_page({topic, payload, 1700000000123, false, {}, {}, {}}, topics.kind_of(topic));
  return text ? json::parse(*text) : json();
}

TEST(WebTopics, AreClassifiedAndOnlyCommandsMayBePublished) {
  const Topics topics("a/b");
  EXPECT_EQ(topics.kind_of("a/b/robot/r/update"), TopicKind::robot);
  EXPECT_EQ(topics.kind_of("a/b/server/r/cmd"), TopicKind::command);
  for (const char* rest :
       {"state", "stats", "numbers", "thread", "robots/r", "response/permit_join"})
    EXPECT_EQ(topics.kind_of("a/b/gateway/g/"s + rest), TopicKind::state) << rest;
  for (const char* rest : {"commands/r", "request/permit_join"})
    EXPECT_EQ(topics.kind_of("a/b/gateway/g/"s + rest), TopicKind::event) << rest;
  for (const char* topic : {"a", "a/b", "a/b/robot", "a/b/robot/", "a/bc/robot/r/x", "x", ""})
    EXPECT_EQ(topics.kind_of(topic), TopicKind::foreign) << topic;
  EXPECT_TRUE(topics.may_publish("a/b/server/r/cmd"));
  EXPECT_TRUE(topics.may_publish("a/b/gateway/g/request/permit_join"));
  for (const char* topic :
       {"a/b/server/r", "a/b/server/r/x/y", "a/b/server//x", "a/b/robot/r/cmd",
        "a/b/gateway/g/state", "a/b/gateway/+/request/permit_join", "a/b/gateway/g/request/x",
        "a/b/gateway//request/permit_join", "a/b/server/+/cmd", "a/b/server/r/#"})
    EXPECT_FALSE(topics.may_publish(topic)) << topic;
}

TEST(WebMirror, PassesGatewayDocumentsAsJson) {
  const json message = mirrored("ntnu-slam/gateway/g/state", R"({"state":"online"})");
  EXPECT_EQ(message["payload"]["state"], "online");
  EXPECT_EQ(message["encoding"], "json");
  EXPECT_EQ(message["at"], 1700000000123);
  EXPECT_EQ(mirrored("ntnu-slam/gateway/g/state", "{broken")["encoding"], "text");
}

TEST(WebMirror, LeavesOutMembersOfWrongType) {
  struct Case {
    const char* topic;
    const char* said;
    const char* kept;
  };
  const Case cases[] = {
      {"stats", R"({"broker":{"state":{"toString":1}}})", R"({"broker":{}})"},
      {"stats", R"({"broker":7,"version":[],"uptime_s":3})", R"({"uptime_s":3})"},
      {"stats", R"({"meshes":{"ble":{"state":1,"detail":null}}})",
       R"({"meshes":{"ble":{"detail":null}}})"},
      {"stats", R"({"broker":{"missing_rights":{"slice":1}}})", R"({"broker":{}})"},
      {"stats", R"({"broker":{"missing_rights":[{"what":[]}]}})",
       R"({"broker":{"missing_rights":[{}]}})"},
      {"stats", R"({"store":{"dead_letters":{"valueOf":1}}})", R"({"store":{"dead_letters":{}}})"},
      {"robots/r", R"({"state":["online"],"mesh":{},"last_seen":1})", "{}"},
      {"numbers", R"({"robots":{"r":{"up":{"toString":1},"last_heard":{}}}})",
       R"({"robots":{"r":{"up":{}}}})"},
      {"numbers", R"({"robots":{"state":{"up":1},"toString":{"up":2,"mesh":3}}})",
       R"({"robots":{"state":{"up":1},"toString":{"up":2}}})"},
      {"thread", R"({"role":1,"neighbours":{"length":9},"channel":15})", R"({"channel":15})"},
      {"thread", R"({"neighbours":[{"extended_address":7,"rloc16":[],"link_quality":1}]})",
       R"({"neighbours":[{"link_quality":1}]})"},
      {"state", R"({"state":"online","more":{"a":[1]}})", R"({"state":"online","more":{"a":[1]}})"},
  };
  for (const Case& each : cases) {
    const json message = mirrored(std::string("ntnu-slam/gateway/g/") + each.topic, each.said);
    EXPECT_EQ(message["payload"], json::parse(each.kept)) << each.said;
  }
}

TEST(WebMirror, BoundsListedRobotsOfGateway) {
  json robots = json::object();
  for (int i = 0; i < 30'000; ++i) robots["r" + std::to_string(i)] = {{"up", 1}};
  const std::string topic = "ntnu-slam/gateway/g/numbers";
  json payload = mirrored(topic, json{{"robots", robots}}.dump())["payload"];
  EXPECT_EQ(payload["robots"].size(), 1000u);
  EXPECT_EQ(payload["left_out"], 29'000);
  payload = mirrored(topic, json{{"robots", robots}, {"left_out", 5}}.dump())["payload"];
  EXPECT_EQ(payload["left_out"], 29'005);
}

TEST(WebLastKnown, KeepsOwnGatewayWhenTopicsFill) {
  const auto text = std::make_shared<const std::string>("{}");
  LastKnown known("p/gateway/own/");
  for (std::size_t i = 0; i < LastKnown::max_topics; ++i)
    ASSERT_TRUE(known.keep("p/gateway/x" + std::to_string(i) + "/state", text));
  EXPECT_FALSE(known.keep("p/gateway/other/state", text));
  EXPECT_TRUE(known.keep("p/gateway/own/state", text));
}

/// Our parser stops at a NUL and skips a byte order mark; a browser's does neither. A browser
/// closes the connection for invalid UTF-8.
TEST(WebMirror, PassesInvalidJsonAsTextOrHex) {
  for (const std::string& payload :
       {"{\"state\":\"online\"}\0\xff{{{"s, "1\0"s, "\xef\xbb\xbf{}"s, "\"\xc3\x28\""s}) {
    const auto text =
        to_page({"ntnu-slam/gateway/g/state", payload, 0, false, {}, {}, {}}, TopicKind::state);
    ASSERT_TRUE(text);
    EXPECT_EQ(text->find('\0'), text->npos);
    EXPECT_EQ(text->find("\"payload\":\xef"), text->npos);
    EXPECT_EQ(text->find('\xff'), text->npos);
    EXPECT_NE(json::parse(*text)["encoding"], "json");
  }
}

TEST(WebMirror, PassesDeepJsonAsText) {
  const auto nested = [](std::size_t depth) {
    return R"({"[[\"{{":)" + std::string(depth, '[') + std::string(depth, ']') + "}";
  };
  EXPECT_EQ(mirrored("ntnu-slam/gateway/g/state", nested(20))["encoding"], "json");
  EXPECT_EQ(mirrored("ntnu-slam/gateway/g/state", nested(20'000))["encoding"], "text");
}

TEST(WebMirror, PassesBinaryOfRobotsAsHexAndTextAsText) {
  EXPECT_EQ(mirrored("ntnu-slam/robot/r/update", "\x0a\0\xec\xff"s)["payload"], "0a00ecff");
  EXPECT_EQ(mirrored("ntnu-slam/robot/r/update", "    ")["encoding"], "hex")
      << "positions are octets even if they look like text";
  EXPECT_EQ(mirrored("ntnu-slam/robot/r/update", R"({"x":1,"y":2})")["encoding"], "text");
  EXPECT_EQ(mirrored("ntnu-slam/robot/r/adv", "h\"i\\")["payload"], "h\"i\\");
  EXPECT_EQ(mirrored("ntnu-slam/robot/r/adv", "\xff\xfe")["payload"], "fffe");
  EXPECT_EQ(mirrored("ntnu-slam/robot/r/adv", "")["encoding"], "hex");
}

TEST(WebMirror, PassesJsonOfRobotsAsText) {
  EXPECT_TRUE(mirrored("ntnu-slam/robot/r/adv", R"({"__proto__":1})")["payload"].is_string());
}

TEST(WebMirror, EscapesMarkupAndControlCharactersInTopics) {
  const std::string topic = "ntnu-slam/robot/<img src=x onerror=alert(1)>\"\\\n/adv";
  EXPECT_EQ(mirrored(topic, "x")["topic"], topic);
  EXPECT_TRUE(mirrored("ntnu-slam/robot/\xff/adv", "x").is_null()) << "not UTF-8";
}

/// One WebSocket message carries several messages, separated by line feeds.
TEST(WebMirror, WritesMessageOnOneLine) {
  const std::string pretty = "{\n  \"state\": \"on\\nline\",\r\n\t\"since\": [\n]\n}";
  const auto text =
      to_page({"ntnu-slam/gateway/g/state", pretty, 0, false, {}, {}, {}}, TopicKind::state);
  ASSERT_TRUE(text);
  EXPECT_EQ(text->find('\n'), text->npos);
  EXPECT_EQ(json::parse(*text)["payload"], json::parse(pretty));
  for (const char* payload : {"two\nlines", "\n"})
    EXPECT_EQ(
        to_page({"ntnu-slam/robot/r\n/adv", payload, 0, false, "\n", "\n", "\n"}, TopicKind::robot)
            ->find('\n'),
        text->npos);
}

/// Ids have 64 octets at most; a broker takes topics of 64 KiB, and a page keeps thousands.
TEST(WebMirror, DropsTooLongTopics) {
  const std::string head = "ntnu-slam/robot/r/";
  EXPECT_FALSE(mirrored(head + std::string(max_topic - head.size(), 'a'), "x").is_null());
  EXPECT_TRUE(mirrored(head + std::string(max_topic, 'a'), "x").is_null());
}

TEST(WebMirror, ReplacesLongPayloadByItsSize) {
  const json message = mirrored("ntnu-slam/robot/r/adv", std::string(max_robot_payload + 1, 'a'));
  EXPECT_EQ(message["payload"], "");
  EXPECT_EQ(message["bytes"], max_robot_payload + 1);
}

TEST(WebMirror, PassesLongPayloadOfNumbersOnly) {
  const std::string value = "\"" + std::string(100'000, 'a') + "\"";
  EXPECT_EQ(mirrored("ntnu-slam/gateway/g/numbers", value)["encoding"], "json");
  for (const char* rest : {"state", "stats", "robots/r", "commands/r", "rejected/r/update"})
    EXPECT_EQ(mirrored("ntnu-slam/gateway/g/"s + rest, value)["bytes"], value.size()) << rest;
}

TEST(WebLastKnown, IsBoundedAndForgetsOnRequest) {
  LastKnown known;
  const auto text = std::make_shared<const std::string>(std::string(1 << 20, 'x'));
  int kept = 0;
  for (int i = 0; i < 100; ++i) kept += known.keep(std::to_string(i), text) ? 1 : 0;
  EXPECT_LT(kept, 17);
  EXPECT_TRUE(known.keep("0", text)) << "a newer value replaces the older one";
  const auto longer = std::make_shared<const std::string>(std::string(17 << 20, 'x'));
  EXPECT_FALSE(known.keep("0", longer));
  EXPECT_EQ(known.topics().at("0"), text) << "until the caller withdraws it";
  known.forget("0");
  EXPECT_FALSE(known.topics().contains("0"));
}

}  // namespace
}  // namespace slamgw::web::test
