// SPDX-License-Identifier: Apache-2.0
// The pure parts of the control socket: its protocol, and the texts of slam-gatewayctl.
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <sstream>

#include "ctl/command_line.hpp"
#include "ctl/host/audit.hpp"
#include "ctl/show.hpp"
#include "daemon/control/wire.hpp"
#include "daemon/core/utf8.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

const auto noon = std::chrono::system_clock::from_time_t(43200);  // 1970-01-01T12:00:00Z

TEST(ControlWire, NamesFaultOfRequest) {
  const auto error = [](std::string_view line) {
    const auto request = control::parse_request(line);
    return request ? std::string("none") : request.error();
  };
  EXPECT_EQ(error(R"({"command": "status"})"), "none");
  EXPECT_EQ(error(R"({"command": "send", "robot": "r", "type": "t", "payload_hex": "0aFF"})"),
            "none");
  for (const std::string_view line : {"", "[]", "{}", "{\"command\": 5}", "\xff", "[[[[[["})
    EXPECT_EQ(error(line), "a request is a line like {\"command\": \"status\"}") << line;
  for (const std::string_view name : {"stop", "ble dance", "store lost"})
    EXPECT_EQ(error(R"({"command": ")" + std::string(name) + "\"}"),
              "unknown command '" + std::string(name) + "'; slam-gatewayctl --help lists all");
  EXPECT_EQ(error(R"({"command": "ble scan"})"), "none");
  for (const std::string_view command : {"provision", "remove", "import"})
    EXPECT_NE(error(R"({"command": "ble )" + std::string(command) + R"(", "uuid": 5})"), "none");
  for (const std::string_view hex : {"0", "0g", "0 ", "5x"})
    EXPECT_NE(error(R"({"command": "send", "robot": "r", "type": "t", "payload_hex": ")" +
                    std::string(hex) + "\"}"),
              "none");
}

TEST(ControlWire, ReplacesInvalidUtf8) {
  EXPECT_EQ(json::parse(control::error_line("a\xff")), json({{"error", "a\ufffd"}}));
}

TEST(ControlWire, RecognizesPrintableText) {
  EXPECT_TRUE(is_printable("Grüße 🤖"));
  EXPECT_TRUE(is_printable(""));
  for (const std::string_view text : {"a\n", "\x1b[2J", "\x7f", "\xc2\x9b", "\xff", "\xc2"})
    EXPECT_FALSE(is_printable(text));
}

TEST(CtlPayload, NamesAllowedPayload) {
  EXPECT_EQ(*ctl::parse_payload("cmd", "+1,-1", false), (Bytes{1, 0, 0xff, 0xff}));
  EXPECT_EQ(*ctl::parse_payload("other", "1,2", false), to_bytes("1,2"));
  for (const std::string_view text : {"", ",", "1,", "1;2", "1, 2", "32768,0", "--1,0", "0x1,0"})
    EXPECT_NE(ctl::parse_payload("cmd", text, false).error().find("X,Y"), std::string::npos);
  EXPECT_NE(ctl::parse_payload("cmd", "1,2", true).error().find("hex"), std::string::npos);
}

TEST(CtlText, CutsAndPadsByCharacters) {
  EXPECT_EQ(ctl::columns("äöü"), 3U);
  EXPECT_EQ(ctl::cut_end("äöüx", 3), "äö~");
  EXPECT_EQ(ctl::cut_start("xäöü", 3), "~öü");
  EXPECT_EQ(ctl::cut_end("äöü", 3), "äöü");
  EXPECT_EQ(ctl::pad("ä", 3), "ä  ");
  EXPECT_EQ(ctl::pad_left("ä", 3), "  ä");
}

TEST(CtlText, ComputesColumnsOnTerminal) {
  EXPECT_EQ(ctl::columns("ロボ1"), 5U);
  EXPECT_EQ(ctl::columns("🤖"), 2U);
  EXPECT_EQ(ctl::columns("e\u0301"), 1U) << "a combining accent";
  EXPECT_EQ(ctl::cut_end("ロボット", 4), "ロ~");
  EXPECT_EQ(ctl::cut_start("ロボット", 4), "~ト");
  EXPECT_EQ(ctl::columns("\xe3\x83"), 1U) << "an incomplete character";
}

TEST(CtlShow, FitsTablesInto80Columns) {
  const std::string shared = "ロボットの名前は六十四オクテットまで";
  json rows = json::array();
  for (const std::string& id :
       {std::string(64, 'x'), shared,
        std::string("🤖🤖🤖🤖🤖🤖🤖🤖🤖🤖🤖🤖🤖🤖🤖🤖")})
    rows.push_back({{"id", id},
                    {"robot", id},
                    {"mesh", "thread"},
                    {"address", "[fd11:2233:4455:6677:8899:aabb:ccdd:eeff]:47193"},
                    {"uuid", std::string(32, 'f')},
                    {"state", "provisioned"},
                    {"last_seen", "1970-01-01T11:59:30Z"},
                    {"messages", 123456789},
                    {"rate_hz", 1000.0},
                    {"rssi_dbm", -101},
                    {"heard_s_ago", 10},
                    {"queue", 64}});
  json nodes = rows;
  for (json& node : nodes) node["address"] = "0x7fff";
  json devices = rows;
  for (json& device : devices) device["state"] = "removed";
  const ctl::Screen screen{false, noon};
  for (const std::string& text : {ctl::show::robots(rows, screen), ctl::show::nodes(nodes, screen),
                                  ctl::show::devices(devices, screen)}) {
    std::istringstream lines(text);
    int count = 0;
    for (std::string line; std::getline(lines, line); ++count)
      EXPECT_LE(ctl::columns(line), 80U) << line;
    EXPECT_EQ(count, 4) << text;
  }
}

TEST(CtlText, BreaksLongLinesAtSpaces) {
  EXPECT_EQ(ctl::wrap("BLE       up       a b c d\n", 20),
            "BLE       up       a\n          b c d\n");
  EXPECT_EQ(ctl::wrap("one two three\nfour", 8), "one two\n  three\nfour");
  EXPECT_EQ(ctl::wrap("\033[32mup\033[0m and on\n", 9), "\033[32mup\033[0m and on\n")
      << "colours take no column";
  const std::string unbroken(30, 'x');
  EXPECT_EQ(ctl::wrap(unbroken + "\n", 8), unbroken + "\n") << "a name can be copied whole";
  EXPECT_EQ(ctl::wrap("   \n\n", 2), "   \n\n");
}

TEST(CtlShow, ShowsRowForEachMeshOfRobot) {
  const json robots = {{{"id", "both"},
                        {"mesh", "thread"},
                        {"address", "10.0.0.1:47193"},
                        {"state", "online"},
                        {"messages", 12},
                        {"meshes",
                         {{"ble", {{"address", "0x0100"}, {"state", "offline"}, {"messages", 5}}},
                          {"thread", {{"address", "10.0.0.1:47193"}, {"messages", 7}}}}}}};
  const std::string shown = ctl::show::robots(robots, {false, noon});
  EXPECT_NE(shown.find("MSG/s P99ms dBm QUEUE\n"), std::string::npos) << shown;
  EXPECT_NE(shown.find("both  thread 10.0.0.1:47193 online"), std::string::npos) << shown;
  EXPECT_NE(shown.find("\n      ble    0x0100         offline       5"), std::string::npos)
      << shown;
  EXPECT_EQ(shown.find("12"), std::string::npos) << "each mesh has its own count: " << shown;
}

TEST(CtlShow, NamesHeardRobotsThatAreNotNodes) {
  const json robots = {{{"id", "a"}, {"mesh", "ble"}, {"state", "online"}},
                       {{"id", "b"}, {"mesh", "ble"}, {"state", "online"}},
                       {{"id", "c"}, {"mesh", "ble"}, {"state", "offline"}},
                       {{"id", "d"}, {"mesh", "thread"}, {"state", "online"}}};
  EXPECT_EQ(ctl::show::foreign_robots(robots, json::array()),
            "2 robots are heard that this gateway did not provision: a, b\n");
  EXPECT_EQ(ctl::show::foreign_robots(robots, {{{"robot", "a"}}}),
            "1 robot is heard that this gateway did not provision: b\n");
  EXPECT_EQ(ctl::show::foreign_robots(robots, {{{"robot", "a"}}, {{"robot", "b"}}}), "");
}

TEST(CtlShow, MarksNamesThatLookLikeOthers) {
  const json rows = {{{"id", "robot-1"}}, {{"id", "r\u043ebot-1"}}, {{"id", "robot\u200b-1"}}};
  const std::string shown = ctl::show::robots(rows, {false, noon});
  EXPECT_NE(shown.find("\nr\\u043ebot-1 "), std::string::npos) << shown;
  EXPECT_NE(shown.find("\n2 names are made to look like another (\\u: escaped characters): "
                       "r\\u043ebot-1, robot\\u200b-1\n"),
            std::string::npos)
      << shown;
}

TEST(CtlText, ShowsUnitsThatPeopleRead) {
  EXPECT_EQ(ctl::show_bytes(1023), "1023 B");
  EXPECT_EQ(ctl::show_bytes(1536), "1.5 KiB");
  EXPECT_EQ(ctl::show_bytes(268435456), "256.0 MiB");
  EXPECT_EQ(ctl::show_seconds(59), "59 s");
  EXPECT_EQ(ctl::show_seconds(3599), "59 min 59 s");
  EXPECT_EQ(ctl::show_seconds(7260), "2 h 1 min");
  EXPECT_EQ(ctl::show_age("1970-01-01T11:59:30Z", noon), "30s");
  EXPECT_EQ(ctl::show_age("1970-01-01T11:00:00Z", noon), "1h");
  EXPECT_EQ(ctl::show_age("1970-01-01T13:00:00Z", noon), "0s");  // a clock that was set back
  EXPECT_EQ(ctl::show_age("never", noon), "");
}

TEST(CtlShow, ColoursOnlyWhereAskedFor) {
  const json outcome = {{"outcome", "delivered"}, {"after_ms", 1}};
  EXPECT_EQ(ctl::show::outcome(outcome, {false, noon}), "delivered after 1 ms\n");
  EXPECT_EQ(ctl::show::outcome(outcome, {true, noon}), "\033[32mdelivered\033[0m after 1 ms\n");
}

TEST(CtlShow, ShowsGatewaysAndRobotsOfFleet) {
  const json fleet = {{"gateway", "room-a"},
                      {"gateways",
                       {{{"gateway", "room-a"},
                         {"state", "member"},
                         {"robots", 2},
                         {"version", "1.2.3"},
                         {"since", "1970-01-01T11:00:00Z"}},
                        {{"gateway", "room-bb"}, {"state", "gone"}, {"robots", 1}}}},
                      {"robots",
                       {{{"robot", "lego-1"},
                         {"gateway", "room-a"},
                         {"since", "1970-01-01T11:59:30Z"},
                         {"served", true},
                         {"contested", true}},
                        {{"robot", "lego-2"},
                         {"gateway", "room-a"},
                         {"since", "1970-01-01T11:59:30Z"},
                         {"served", false}},
                        {{"robot", "r\033[2J"},
                         {"gateway", "room-bb"},
                         {"since", "1970-01-01T11:30:00Z"},
                         {"served", false}}}}};
  EXPECT_EQ(ctl::show::fleet(fleet, {false, noon}),
            "GATEWAY STATE   ROBOTS UP   VERSION\n"
            "room-a  member       2 1h   1.2.3\n"
            "room-bb gone         1\n"
            "\n"
            "ROBOT    GATEWAY SINCE\n"
            "lego-1   room-a  30s (contested: another client uses its name)\n"
            "lego-2   room-a  30s (no session at the broker)\n"
            "r\\x1b[2J room-bb 30m (that gateway is gone)\n");
  EXPECT_NE(ctl::show::fleet(fleet, {true, noon}).find(" 30s (no session at the broker)\n"),
            std::string::npos)
      << "no fault, so without colour";
}

TEST(CtlShow, MarksRobotsThatAreDeafOrContested) {
  const json robots = {
      {{"id", "r1"}, {"mesh", "ble"}, {"state", "online"}, {"deaf", true}, {"why", "it is deaf"}},
      {{"id", "r2"}, {"mesh", "ble"}, {"state", "online"}, {"deaf", false}, {"why", ""}}};
  const std::string shown = ctl::show::robots(robots, {false, noon});
  EXPECT_NE(shown.find("deaf"), std::string::npos) << shown;
  EXPECT_NE(shown.find("online"), std::string::npos) << shown;
  EXPECT_TRUE(shown.ends_with("r1: it is deaf\n")) << shown;
  const json contested = {{{"id", "r3"}, {"state", "online"}, {"contested", true}, {"why", ""}}};
  EXPECT_TRUE(ctl::show::robots(contested, {false, noon})
                  .ends_with("r3: contested: another client uses its name\n"));
  EXPECT_NE(
      ctl::show::status({{"robots", {{"online", 3}, {"deaf", 2}, {"contested", 1}}}}, {false, noon})
          .find("3 online (2 deaf, 1 contested)"),
      std::string::npos);
  const json status = {{"robots", {{"online", 3}, {"deaf", 2}}},
                       {"meshes", {{"ble", {{"counters", {{"mostly_deaf", 1}}}}}}}};
  const std::string text = ctl::show::status(status, {false, noon});
  EXPECT_NE(text.find("3 online (2 deaf)"), std::string::npos) << text;
  EXPECT_NE(text.find("most robots do not hear the gateway"), std::string::npos) << text;
}

TEST(CtlShow, NamesEachTopicThatTheBrokerRefuses) {
  const json list{{{"topic", "p/robot/r1/adv"}, {"why", "not authorised"}, {"waiting", 1}},
                  {{"topic", "p/robot/r1/update"}, {"why", "not authorised"}, {"waiting", 5}}};
  const json broker{{"state", "refusing"},
                    {"why", "the first one"},
                    {"refused", {{"topics", 3}, {"list", list}}}};
  const std::string text = ctl::show::status({{"broker", broker}}, {false, noon});
  EXPECT_NE(text.find("refused: p/robot/r1/adv: not authorised (1 message waits)\n"),
            std::string::npos)
      << text;
  EXPECT_NE(text.find("refused: p/robot/r1/update: not authorised (5 messages wait)\n"),
            std::string::npos);
  EXPECT_NE(text.find("and 1 more topic\n"), std::string::npos);
  EXPECT_EQ(text.find("the first one"), std::string::npos) << "the list says more";
}

TEST(CtlShow, ReportsMissingThreadNetwork) {
  const auto shown = [](const char* role) {
    return ctl::show::status({{"meshes", {{"thread", {{"state", "up"}, {"role", role}}}}}},
                             {false, noon});
  };
  EXPECT_NE(shown("detached").find("detached: this node has no Thread network"), std::string::npos);
  EXPECT_NE(shown("disabled").find("disabled: this node has no Thread network"), std::string::npos);
  EXPECT_EQ(shown("router").find("no Thread network"), std::string::npos);
}

TEST(CtlShow, EscapesControlCharacters) {
  const json robots = {{{"id", "r\033[2J"}, {"address", "\u009b1m"}, {"state", "x\n"}}};
  const std::string shown = ctl::show::robots(robots, {false, noon});
  EXPECT_NE(shown.find("r\\x1b[2J "), std::string::npos) << shown;
  EXPECT_EQ(shown.find('\033'), std::string::npos);
  EXPECT_EQ(shown.find("\u009b"), std::string::npos);
  EXPECT_EQ(std::count(shown.begin(), shown.end(), '\n'), 3) << "the third line warns of the name";
}

TEST(CtlShow, Clients) {
  const json row = {{"robot", "tank"},
                    {"client_id", "tank-1"},
                    {"state", "asleep"},
                    {"address", "[fd00::2]:47000"},
                    {"heard_ms_ago", 2500},
                    {"keep_alive_s", 60},
                    {"sleep_s", 300},
                    {"clean_session", false},
                    {"topics", 2},
                    {"subscriptions", 1},
                    {"waiting", 3},
                    {"in_flight", 1},
                    {"repeats", 2},
                    {"repeat_after_ms", 1500},
                    {"unacknowledged_up", 4},
                    {"will", nullptr}};
  EXPECT_EQ(ctl::show::clients(json::array({row}), {false, noon}),
            "ROBOT STATE        ADDRESS         HEARD KEEP TOPICS SUBS WAIT\n"
            "tank  asleep       [fd00::2]:47000    2s  60s      2    1    4\n");
  json one = row;
  one["topics"] = json::array({{{"id", 7}, {"name", "p/robot/tank/adv"}, {"told", false}}});
  one["subscriptions"] =
      json::array({{{"filter", "p/server/tank/+"}, {"qos", 1}, {"topic_id_type", "normal"}}});
  one["waiting"] = json::array({"p/server/tank/cmd"});
  const std::string shown = ctl::show::clients(json::array({one}), {false, noon});
  for (const char* line : {"client id          tank-1\n", "heard              2.5 s ago\n",
                           "sleeps             300 s\n", "will               -\n",
                           "subscription       p/server/tank/+ (QoS 1, normal)\n",
                           "topic id           7 p/robot/tank/adv (not registered yet)\n",
                           "waits              p/server/tank/cmd\n",
                           "in flight          1, repeated 2 times; next copy after 1.5 s\n"})
    EXPECT_NE(shown.find(line), std::string::npos) << line << shown;
  one["state"] = "disconnected";
  const std::string gone = ctl::show::clients(json::array({one}), {false, noon});
  EXPECT_EQ(gone.find("in flight"), std::string::npos) << gone;
  EXPECT_EQ(ctl::show::clients(json::array(), {false, noon}), "no MQTT-SN client is known\n");
}

TEST(CtlShow, Ping) {
  const ctl::Screen screen{false, noon};
  EXPECT_EQ(ctl::show::ping({{"robot", "tank"},
                             {"mesh", "ble"},
                             {"answered", true},
                             {"after_ms", 41.26},
                             {"copies", 2},
                             {"ttl", 3},
                             {"hops", 1},
                             {"rssi_dbm", -60}},
                            screen),
            "tank (ble) answered after 41.3 ms, asked 2 times, 1 hop, TTL left 3, -60 dBm\n");
  EXPECT_EQ(ctl::show::ping({{"robot", "tank"},
                             {"mesh", "thread"},
                             {"answered", false},
                             {"why", "it is asleep"},
                             {"last_heard_s", 12.2}},
                            screen),
            "tank (thread) no answer: it is asleep; last heard 12 s ago\n");
  EXPECT_EQ(ctl::show::pings(4, 3), "4 sent, 3 answered, 25 % lost\n");
}

TEST(CtlShow, Topology) {
  const json rows = {{{"robot", "near"},
                      {"address", "0x0100"},
                      {"hops", 0},
                      {"rssi_dbm", -56},
                      {"last_seen", "2026-11-21T11:59:58Z"},
                      {"state", "online"}},
                     {{"robot", "far"},
                      {"address", "0x0101"},
                      {"hops", 2},
                      {"rssi_dbm", -70},
                      {"last_seen", "2026-11-21T11:59:30Z"},
                      {"state", "online"}},
                     {{"robot", "gone"}, {"address", "0x0102"}, {"state", "not heard"}}};
  const std::string shown = ctl::show::topology({{"nodes", rows}}, {false, noon});
  EXPECT_TRUE(
      shown.starts_with("ROBOT ADDRESS RELAYS  DBM SEEN STATE\n"
                        "near  0x0100       0  -56 "))
      << shown;
  EXPECT_NE(shown.find("far   0x0101       2  -70*"), std::string::npos) << shown;
  EXPECT_NE(shown.find("gone  0x0102       -    - "), std::string::npos) << shown;
}

TEST(CtlShow, ShowsGroupAddressOfRelayedUpdate) {
  const json event = {{"at", "2026-11-21T12:00:00.123456Z"},
                      {"event", "sent"},
                      {"robot", "lego-1"},
                      {"mesh", "ble"},
                      {"address", "0xc100"},
                      {"type", "update"}};
  EXPECT_EQ(ctl::show::event(event, {false, noon}),
            "12:00:00.123 sent         ble    lego-1       update  to 0xc100\n");
}

TEST(CtlShow, Hearing) {
  const json hearing = json::parse(R"({"silent": ["c"], "rows": [
    {"source": "a", "listener": "lego-2", "sent": 8, "heard": 8, "heard_at_most": 8,
     "min_hops": 1, "max_hops": 1},
    {"source": "a", "listener": "c", "sent": 8, "heard": 4, "heard_at_most": 7,
     "min_hops": 2, "max_hops": 2},
    {"source": "lego-2", "listener": "a", "sent": 8, "heard": 2, "heard_at_most": 3,
     "min_hops": 1, "max_hops": 4},
    {"source": "lego-2", "listener": "c", "sent": 8, "heard": 0, "heard_at_most": 0,
     "min_hops": null, "max_hops": null}]})");
  EXPECT_EQ(ctl::show::hearing(hearing, {false, noon}),
            "a is heard by\n"
            "  lego-2   8 of 8, direct\n"
            "  c      4-7 of 8, 1 relay\n"
            "lego-2 is heard by\n"
            "  a      2-3 of 8, 0-3 relays\n"
            "  c        0 of 8\n"
            "c left questions unanswered\n");
}

TEST(CtlShow, Config) {
  const json config = {{"robot", "tank"},
                       {"address", "0x0100"},
                       {"uuid", "00112233445566778899aabbccddeeff"},
                       {"ttl", 7},
                       {"relay", {{"state", "on"}, {"sends", 3}, {"interval_ms", 20}}},
                       {"transmit", {{"sends", 1}, {"interval_ms", 10}}},
                       {"models",
                        {{{"element", "0x0100"},
                          {"name", "pos_cmd server"},
                          {"subscribed_to", {"0xc002", "0xc003"}}},
                         {{"element", "0x0101"},
                          {"name", "min_com client"},
                          {"publishes_to", "0x0001"},
                          {"publish_ttl", 7}}}},
                       {"wanted", {{"ttl", 7}}}};
  EXPECT_EQ(ctl::show::config(config, {false, noon}),
            "tank  0x0100  UUID 00112233445566778899aabbccddeeff\n"
            "  TTL       7\n"
            "  Relay     on, each packet 3 times, 20 ms apart\n"
            "  Transmit  each packet 1 time, 10 ms apart\n"
            "  0x0100 pos_cmd server        subscribed to 0xc002, 0xc003\n"
            "  0x0101 min_com client        publishes to 0x0001, TTL 7\n"
            "  Kept for this robot alone: {\"ttl\":7}\n");
}

TEST(CtlShow, SurvivesAnswersOfAnyShape) {
  for (const std::string_view text :
       {"null", "5", "[]", "[1]", "{}", R"({"broker": 5})",
        R"([{"id": 5, "rate_hz": "x", "messages": -1}])", R"({"update": {"obstacles": [5]}})"}) {
    const json answer = json::parse(text);
    const ctl::Screen screen{false, noon};
    EXPECT_TRUE(ctl::show::status(answer, screen).ends_with('\n'));
    EXPECT_TRUE(ctl::show::robots(answer, screen).ends_with('\n'));
    EXPECT_TRUE(ctl::show::fleet(answer, screen).ends_with('\n'));
    EXPECT_TRUE(ctl::show::clients(answer, screen).ends_with('\n'));
    EXPECT_TRUE(ctl::show::ping(answer, screen).ends_with('\n'));
    EXPECT_TRUE(ctl::show::config(answer, screen).ends_with('\n'));
    EXPECT_TRUE(ctl::show::topology(answer, screen).ends_with('\n'));
    EXPECT_TRUE(ctl::show::hearing(answer, screen).ends_with('\n'));
    EXPECT_TRUE(ctl::show::event(answer, screen).ends_with('\n'));
    EXPECT_TRUE(ctl::show::outcome(answer, screen).ends_with('\n'));
    EXPECT_TRUE(ctl::show::devices(answer, screen).ends_with('\n'));
    EXPECT_TRUE(ctl::show::nodes(answer, screen).ends_with('\n'));
    EXPECT_TRUE(ctl::show::done(answer, screen).ends_with('\n'));
  }
}

TEST(Audit, ReadsValuesThatJournalctlWritesAsNumbers) {
  const json entries = ctl::audit_entries(
      R"({"SLAM_AUDIT_WHO":"SIGHUP","SLAM_AUDIT_WHAT":[99,27,91,109],"MESSAGE":[120,255],)"
      R"("SLAM_AUDIT_OUTCOME":"failed","ROBOT_ID":[27,91,51,49,109,88]})");
  ASSERT_EQ(entries.size(), 1u);
  EXPECT_EQ(entries[0]["what"], "c\\x1b[m");
  EXPECT_EQ(entries[0]["robot"], "\\x1b[31mX");
  EXPECT_EQ(entries[0]["text"], "x\\xff");
  EXPECT_FALSE(entries.dump().empty()) << "what is not UTF-8 would throw";
}

}  // namespace
}  // namespace slamgw::test
