// SPDX-License-Identifier: Apache-2.0
// Settings that valid configurations give.
#include "daemon/config/parse.hpp"

#include <gtest/gtest.h>

#include "tests/config/fake_files.hpp"

namespace slamgw::test {
namespace {

struct Parsed : ParseResult {
  explicit Parsed(std::string_view text, Environment environment = {"pi", ""}, FakeFiles files = {},
                  const std::string& file = "/etc/slam-gateway/gateway.json")
      : ParseResult(parse_config({{file, std::string(text)}}, environment, files)) {
    for (const Problem& problem : problems) lines_of_problems += to_string(problem) + "\n";
  }
  std::string lines_of_problems;
};

TEST(ParseConfig, NamesTheGatewayAfterItsHost) {
  EXPECT_EQ(Parsed("{}", {"pi", ""}).config.gateway_id, "pi");
  EXPECT_EQ(Parsed("{}", {"pi 4.örtlich", ""}).config.gateway_id, "pi-4---rtlich");
  EXPECT_EQ(Parsed("{}", {std::string(40, 'a'), ""}).config.gateway_id, std::string(32, 'a'));
  EXPECT_EQ(Parsed("{}", {"", ""}).config.gateway_id, "gateway");
  EXPECT_EQ(Parsed(R"({"gateway": {"id": "g1"}})").config.broker.client_id, "slam-gateway-g1");
}

TEST(ParseConfig, ReadsTheBrokersUri) {
  const auto broker = [](const std::string& uri) {
    const Parsed parsed(R"({"broker": {"uri": ")" + uri + "\"}}");
    EXPECT_EQ(parsed.lines_of_problems, "");
    return parsed.config.broker.host + " " + std::to_string(parsed.config.broker.port) +
           (parsed.config.broker.tls ? " tls" : "");
  };
  EXPECT_EQ(broker("mqtt://broker.lab"), "broker.lab 1883");
  EXPECT_EQ(broker("mqtts://broker.lab"), "broker.lab 8883 tls");
  EXPECT_EQ(broker("mqtt://10.0.0.1:1"), "10.0.0.1 1");
  EXPECT_EQ(broker("mqtt://[::1]"), "::1 1883");
  EXPECT_EQ(broker("mqtts://[fd00::1]:65535"), "fd00::1 65535 tls");
}

TEST(ParseConfig, ReadsAListOfBrokers) {
  const Parsed parsed(R"({"broker": {"uri": ["mqtt://a", "mqtts://b", "mqtt://c:1"]}})");
  EXPECT_EQ(parsed.lines_of_problems, "");
  EXPECT_EQ(parsed.config.broker.host, "a");
  EXPECT_EQ(parsed.config.broker.others,
            (std::vector<BrokerAddress>{{"b", 8883, true}, {"c", 1, false}}));
  for (const char* const bad : {"[]", R"(["mqtt://a", "mqtt://a"])", R"(["x"])"})
    EXPECT_NE(Parsed(std::string(R"({"broker": {"uri": )") + bad + "}}").lines_of_problems, "");
}

TEST(ParseConfig, ReadsRobotKeysAndRequiredIdentity) {
  FakeFiles files;
  files.files["/etc/slam-gateway/keys"] = {
      R"({"r1": "00112233445566778899aabbccddeeff", "r2": "A0A1A2A3A4A5A6A7A8A9AAABACADAEAF"})",
      0600};
  const auto parsed = [&](const std::string& required) {
    return Parsed(
        R"({"mqttsn": {"require_identity": )" + required + R"(, "dtls": {"keys_file": "keys"}}})",
        {"pi", ""}, files);
  };
  EXPECT_EQ(parsed("true").lines_of_problems, "");
  EXPECT_TRUE(parsed("true").warnings.empty());
  const Parsed renamed(R"({"robots": [{"id": "r1", "mqttsn_client_id": "c1"}, {"id": "r2"}],
                           "mqttsn": {"dtls": {"keys_file": "keys"}}})",
                       {"pi", ""}, files);
  ASSERT_EQ(renamed.warnings.size(), 1U);
  EXPECT_NE(to_string(renamed.warnings[0]).find("a key for r1, which no client uses"),
            std::string::npos);
  const RobotKeys keys = parsed("true").config.robot_keys;
  EXPECT_EQ(identities_of(keys), (Identities{"r1", "r2"}));
  EXPECT_EQ(to_hex(keys.at("r2")), "a0a1a2a3a4a5a6a7a8a9aaabacadaeaf");
  using mqttsn::RequireIdentity;
  EXPECT_EQ(parsed("false").config.mqttsn.require_identity, RequireIdentity::none);
  EXPECT_EQ(parsed("true").config.mqttsn.require_identity, RequireIdentity::with_key);
  EXPECT_EQ(parsed("\"all\"").config.mqttsn.require_identity, RequireIdentity::all);
}

TEST(ParseConfig, ReadsAddressesAsTextOrNumbers) {
  const Parsed parsed(R"({"ble_mesh": {"address": "0x7FFF", "groups": [49152, "0xfeff"],
          "relay": ["robot/a/update", "robot/b/update"], "relay_group": 49409},
      "robots": [{"id": "a", "ble_address": 256}, {"id": "b", "ble_address": "0x101"}]})");
  EXPECT_EQ(parsed.lines_of_problems, "");
  EXPECT_EQ(parsed.config.ble_mesh.address, 0x7fff);
  EXPECT_EQ(parsed.config.ble_mesh.groups, (std::vector<std::uint16_t>{0xc000, 0xfeff}));
  EXPECT_EQ(parsed.config.ble_mesh.relayed_to(), 0xc101);
  EXPECT_EQ(parsed.config.robots.at(0).ble_address, 0x0100);
  EXPECT_EQ(parsed.config.robots.at(1).ble_address, 0x0101);
}

TEST(ParseConfig, ReadsKeysWithoutDefault) {
  const Parsed parsed(R"({"mqttsn": {"multicast_group": null, "interface": "wpan0",
        "listen": ["0.0.0.0:0", "[fe80::1%wpan0]:47193"],
        "predefined_topics": [{"id": 7, "name": "a/b"}, {"id": 7, "name": "c", "client_id": "x"}]},
      "ble_mesh": {"will": {"topic": "lost/{id}", "message": "m"}, "robot_id": "r",
        "protocol": "cobs", "provisioning": {"static_oob": "00112233445566778899aabbccddeeff"}},
      "topics": {"extra_publish": ["lab/%c/#"], "prefix": "a/b", "retain": ["map"]}})");
  EXPECT_EQ(parsed.lines_of_problems, "");
  EXPECT_EQ(parsed.config.mqttsn.multicast_group, std::nullopt);
  EXPECT_EQ(parsed.config.mqttsn.interface, "wpan0");
  EXPECT_EQ(parsed.config.mqttsn.listen.size(), 2U);
  EXPECT_EQ(parsed.config.topics.retain, std::vector<std::string>{"map"});
  EXPECT_EQ(parsed.config.mqttsn.predefined_topics.at(1).client_id, "x");
  EXPECT_EQ(parsed.config.ble_mesh.will->topic, "lost/{id}");
  EXPECT_EQ(parsed.config.ble_mesh.provisioning.static_oob, "00112233445566778899aabbccddeeff");
  EXPECT_EQ(parsed.config.topics.prefix, "a/b");
}

TEST(ParseConfig, AcceptsNullForUnsetValue) {
  const Parsed parsed(R"({"broker": {"credentials_file": null, "tls": {"ca_file": null}},
      "ble_mesh": {"will": null, "robot_id": null}, "mqttsn": {"interface": null},
      "robots": [{"id": "a", "ble_address": null, "mqttsn_client_id": "c", "address": null},
                 {"id": "b", "address": "192.0.2.7"}]})");
  EXPECT_EQ(parsed.lines_of_problems, "");
  EXPECT_EQ(parsed.config.mqttsn.interface, "auto");
  EXPECT_FALSE(parsed.config.robots.at(0).address);
  EXPECT_EQ(parsed.config.robots.at(1).address, "192.0.2.7");
  EXPECT_FALSE(parsed.config.ble_mesh.will);
  EXPECT_FALSE(parsed.config.robots.at(0).ble_address);
}

TEST(ParseConfig, JoinsGroupsOfSeveralFilesAndClearsWhatALaterOneSetsToNull) {
  const std::vector<ConfigFile> files{
      {"a.json",
       R"({"ble_mesh": {"gateway_group": "0xc010", "will": {"topic": "t", "message": "m"}},
                     "mqttsn": {"predefined_topics": [{"id": 1, "name": "a"}]}})"},
      {"b.json", R"({"ble_mesh": {"gateway_group": null, "will": {"message": "n"}},
                     "mqttsn": {"predefined_topics": []}})"},
      {"c.json", R"({"ble_mesh": {"will": null}})"}};
  const ParseResult joined = parse_config({files[0], files[1]}, {"pi", ""}, FakeFiles());
  EXPECT_TRUE(joined.problems.empty());
  EXPECT_FALSE(joined.config.ble_mesh.gateway_group);
  ASSERT_TRUE(joined.config.ble_mesh.will);
  EXPECT_EQ(joined.config.ble_mesh.will->topic, "t");
  EXPECT_EQ(joined.config.ble_mesh.will->message, "n");
  EXPECT_TRUE(joined.config.mqttsn.predefined_topics.empty());
  const ParseResult cleared = parse_config(files, {"pi", ""}, FakeFiles());
  EXPECT_TRUE(cleared.problems.empty());
  EXPECT_FALSE(cleared.config.ble_mesh.will);
}

TEST(ParseConfig, AcceptsBothKindsOfComments) {
  const Parsed parsed("// a\n/* b\n*/ {\"log\": /* c */ {\"level\": \"error\"}} // d");
  EXPECT_EQ(parsed.lines_of_problems, "");
  EXPECT_EQ(parsed.config.log.level, Severity::error);
  EXPECT_EQ(parsed.places.at("log.level").line, 3);
}

TEST(ParseConfig, ResolvesRelativePathsAgainstTheFile) {
  const std::string text = R"({"store": {"directory": "store"}, "control": {"socket": "../c.sock"},
      "ble_mesh": {"device": "dev/board"}})";
  const Parsed parsed(text);
  EXPECT_EQ(parsed.config.store.directory, "/etc/slam-gateway/store");
  EXPECT_EQ(parsed.config.control_socket, "/etc/c.sock");
  EXPECT_EQ(parsed.config.ble_mesh.device, "/etc/slam-gateway/dev/board");
  EXPECT_EQ(Parsed(text, {}, {}, "g.json").config.store.directory, "store");
  EXPECT_EQ(Parsed(R"({"ble_mesh": {"device": "auto"}})").config.ble_mesh.device, "auto");
}

TEST(ParseConfig, NamesSourceFileOfServiceCredential) {
  const std::string source = "/etc/slam-gateway/credentials.json";
  FakeFiles files;
  files.files["/run/creds/broker"] = {R"({"username": "u"})", 0400};
  files.errors[source] = {false, true, "Permission denied"};
  EXPECT_EQ(Parsed("{}", {"pi", "/run/creds", source}, files).lines_of_problems,
            source +
                ":1: password: is missing; allowed: "
                R"({"username": "...", "password": "..."})"
                "\n");
  files.errors.clear();
  files.files[source] = {R"({"username": "u", "password": "p"})", 0644};
  EXPECT_EQ(Parsed("{}", {"pi", "/run/creds", source}, files).lines_of_problems,
            source +
                ":1: file: can be read or changed by others (mode 0644); type: sudo chmod o= " +
                source + "\n")
      << "the file that the operator edits";
}

TEST(ParseConfig, ChecksButDoesNotUseServiceCredential) {
  const std::string source = "/etc/slam-gateway/credentials.json";
  FakeFiles files;
  files.files[source] = {"{", 0600};
  EXPECT_TRUE(Parsed("{}", {"pi", "", source}, files).lines_of_problems.starts_with(source));
  files.files[source] = {R"({"username": "u", "password": "p"})", 0600};
  const Parsed good("{}", {"pi", "", source}, files);
  EXPECT_EQ(good.lines_of_problems, "");
  EXPECT_FALSE(good.config.broker.credentials);
  files.files.clear();
  files.errors[source] = {false, true, "Permission denied"};
  const Parsed denied("{}", {"pi", "", source}, files);
  EXPECT_EQ(denied.lines_of_problems, "");
  ASSERT_EQ(denied.warnings.size(), 1U);
  EXPECT_NE(denied.warnings[0].text.find("sudo slam-gatewayd --check-config"), std::string::npos);
}

TEST(ParseConfig, WarnsOfOfflineTimeBelowHealthInterval) {
  const Parsed ten(R"({"ble_mesh": {"enabled": true}, "presence":
{"offline_after_s": 10}})");
  EXPECT_EQ(ten.lines_of_problems, "");
  ASSERT_EQ(ten.warnings.size(), 1U);
  EXPECT_TRUE(to_string(ten.warnings[0])
                  .starts_with("/etc/slam-gateway/gateway.json:2: presence.offline_after_s: "))
      << to_string(ten.warnings[0]);
  const char* const good[] = {
      R"({"ble_mesh": {"enabled": true}, "presence": {"offline_after_s": 11}})",
      R"({"presence": {"offline_after_s": 1}})",
      R"({"ble_mesh": {"enabled": true, "protocol": "cobs", "robot_id": "r"},
          "presence": {"offline_after_s": 1}})"};
  for (const char* const text : good) EXPECT_TRUE(Parsed(text).warnings.empty()) << text;
}

TEST(ParseConfig, AcceptsAnyObsoleteFleetKeyAndNamesEachOnce) {
  const Parsed parsed("{\"fleet\": {\"enabled\": 7,\n\"lease_s\": {\"x\": [1]}}}");
  EXPECT_EQ(parsed.lines_of_problems, "");
  EXPECT_TRUE(parsed.warnings.empty());
  ASSERT_EQ(parsed.notices.size(), 2U);
  EXPECT_EQ(to_string(parsed.notices[0]),
            "/etc/slam-gateway/gateway.json:1: fleet.enabled: has no meaning any more: gateways on "
            "one broker need only different values of gateway.id");
  EXPECT_EQ(parsed.notices[1].key, "fleet.lease_s");
  EXPECT_EQ(parsed.notices[1].line, 2);
  for (const char* const text :
       {R"({"fleet": "auto"})", R"({"fleet": {}})", R"({"fleet": [{}]})"}) {
    EXPECT_EQ(Parsed(text).lines_of_problems, "") << text;
    ASSERT_EQ(Parsed(text).notices.size(), 1U) << text;
    EXPECT_EQ(Parsed(text).notices[0].key, "fleet") << text;
  }
  EXPECT_TRUE(Parsed(R"({"gateway": {"id": "a"}})").notices.empty());
}

TEST(ParseConfig, ReadsCredentialsBesideTheFile) {
  FakeFiles files;
  files.files["/etc/slam-gateway/c.json"] = {R"({"username": "u", "password": ""})", 0640};
  const Parsed parsed(R"({"broker": {"credentials_file": "c.json"}})", {"pi", "/run/creds"}, files);
  EXPECT_EQ(parsed.lines_of_problems, "");
  ASSERT_TRUE(parsed.config.broker.credentials);
  EXPECT_EQ(parsed.config.broker.credentials->username, "u");
}

TEST(ParseConfig, RejectsCredentialsThatMqttCannotCarry) {
  const auto problems_of = [](const std::string& credentials) {
    FakeFiles files;
    files.files["/etc/slam-gateway/c.json"] = {credentials, 0600};
    return Parsed(R"({"broker": {"credentials_file": "c.json"}})", {"pi", ""}, files)
        .lines_of_problems;
  };
  const std::string place = "/etc/slam-gateway/c.json:1: ";
  EXPECT_TRUE(problems_of(R"({"username": "a\u0000b", "password": "p"})")
                  .starts_with(place + "username: is not a text of 1 to 65535 octets"));
  EXPECT_TRUE(problems_of(R"({"username": "u", "password": "a\u0000b"})")
                  .starts_with(place + "password: is not a text of at most 65535 octets"));
  const std::string longest(65535, 'x');
  EXPECT_EQ(problems_of(R"({"username": "u", "password": ")" + longest + "\"}"), "");
  EXPECT_TRUE(problems_of(R"({"username": "u", "password": ")" + longest + "x\"}")
                  .starts_with(place + "password: is not a text of at most 65535 octets"));
}

TEST(ParseConfig, FallsBackToTheSystemdCredential) {
  FakeFiles files;
  EXPECT_FALSE(Parsed("{}", {"pi", "/run/creds"}, files).config.broker.credentials);
  files.files["/run/creds/broker"] = {R"({"username": "u", "password": "p"})", 0444};
  const Parsed parsed("{}", {"pi", "/run/creds"}, files);
  EXPECT_EQ(parsed.lines_of_problems, "");
  ASSERT_TRUE(parsed.config.broker.credentials);
  EXPECT_EQ(parsed.config.broker.credentials->password, "p");
  EXPECT_FALSE(Parsed("{}", {"pi", ""}, files).config.broker.credentials);
}

}  // namespace
}  // namespace slamgw::test
