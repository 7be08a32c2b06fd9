// SPDX-License-Identifier: Apache-2.0
// Problems of invalid configurations: a table of snippets with the whole place and a part of the
// text. Nothing crashes the parser, no problem is left out, and no secret is shown.
#include <gtest/gtest.h>

#include <random>

#include "daemon/config/parse.hpp"
#include "tests/config/fake_files.hpp"

namespace slamgw::test {
namespace {

using namespace std::string_view_literals;

Problems problems_of(std::string_view text) {
  FakeFiles files;
  files.files["open"] = {R"({"username": "u", "password": "hush"})", 0644};
  files.files["broken"] = {"{\n\"username\": \"u\",\n\"password\": \"hush\n}", 0600};
  files.files["odd"] = {"{\"username\": \"\",\n\"pasword\": \"hush\"}", 0600};
  files.files["list"] = {"[]", 0600};
  files.files["empty"] = {"\n", 0600};
  files.files["cert"] = {"certificate 1", 0644};
  files.files["keys"] = {R"({"r1": "00112233445566778899aabbccddeeff"})", 0600};
  files.files["group-keys"] = {R"({"r1": "00112233445566778899aabbccddeeff"})", 0640};
  files.files["short-keys"] = {"{\n\"r1\": \"0011hush\"}", 0600};
  files.files["exchanged-keys"] = {R"({"00112233445566778899aabbccddeeff": "hush"})", 0600};
  files.files["level-keys"] = {R"({"a/b": "00112233445566778899aabbccddeeff"})", 0600};
  files.files["key"] = {"key 2", 0600};
  files.errors["secret"] = {false, true, "Permission denied"};
  return parse_config({{"g.json", std::string(text)}}, {"pi", ""}, files).problems;
}

struct Case {
  std::string_view text;
  std::string_view place;     ///< how the line begins
  std::string_view fragment;  ///< stands after the place
};

void PrintTo(const Case& c, std::ostream* out) { *out << c.text; }

class ConfigProblem : public testing::TestWithParam<Case> {};

TEST_P(ConfigProblem, NamesFileLineKeyAndWhatIsAllowed) {
  const Problems problems = problems_of(GetParam().text);
  ASSERT_EQ(problems.size(), 1U) << (problems.size() > 1 ? to_string(problems[1]) : "none");
  const std::string line = to_string(problems[0]);
  EXPECT_EQ(line.substr(0, GetParam().place.size()), GetParam().place) << line;
  EXPECT_NE(line.find(GetParam().fragment, GetParam().place.size()), line.npos) << line;
  EXPECT_EQ(line.find("hush"), line.npos) << line;
  EXPECT_EQ(line.find('\n'), line.npos) << line;
  EXPECT_EQ(line.find("json.exception"), line.npos) << line;
}

INSTANTIATE_TEST_SUITE_P(
    Syntax, ConfigProblem,
    testing::Values(
        Case{"", "g.json:1: syntax: ", "an empty configuration is {}"},
        Case{"[]", "g.json:1: syntax: ", "write { ... } around it"},
        Case{"null", "g.json:1: syntax: ", "write { ... } around it"},
        Case{"{\n\"log\": {}\n", "g.json:2: syntax: ", "the file ends too early; close every {"},
        Case{"{\"log\": {},\n}", "g.json:2: syntax: ", "a comma before }; remove"},
        Case{"{\"robots\": [1,\n]}", "g.json:2: syntax: ", "remove the comma before it"},
        Case{"{\"log\": {}\n\"store\": {}}", "g.json:2: syntax: ", "a comma is missing"},
        Case{"{\"a\": [1 2]}", "g.json:1: syntax: ", "a comma is missing"},
        Case{"{\"log\" {}}", "g.json:1: syntax: ", "no colon after a key"},
        Case{"{\"log\": {}}\n}", "g.json:2: syntax: ", "a } after the end of the configuration"},
        Case{"{log: {}}", "g.json:1: syntax: ", "write it in double quotes"},
        Case{"{\"log\": info}", "g.json:1: syntax: ", "this is not a JSON value"},
        Case{"{\"log\": }", "g.json:1: syntax: ", "write a value after the colon"},
        Case{"{}\n{}", "g.json:2: syntax: ", "text after the end"},
        Case{"// ours\n\"log\": {}", "g.json:2: syntax: ", "write { ... } around everything"},
        Case{"{\"log\": \"hush\n\"}", "g.json:1: syntax: ", "does not end on its line"},
        Case{"{\"log\": \"hush", "g.json:1: syntax: ", "close it with a double quote"},
        Case{"{\"log\": \"\\q\"}", "g.json:1: syntax: ", "unknown backslash sequence"},
        Case{"{\"log\": \"\xff\"}", "g.json:1: syntax: ", "not UTF-8"},
        Case{"{\n/* }", "g.json:2: syntax: ", "a broken comment"},
        Case{"{\"log\": -}", "g.json:1: syntax: ", "a broken number"},
        Case{"{\"log\": 1e999}", "g.json:1: syntax: ", "too large"},
        Case{"{,}", "g.json:1: syntax: ", "a comma too many"},
        Case{"{\"log\": {}}\n\0{\"zz\": 1}"sv, "g.json:2: syntax: ", "a null character"},
        Case{"\0\0\0"sv, "g.json:1: syntax: ", "a null character"},
        Case{"# old\n{}", "g.json:1: syntax: ", "this is not a JSON value"},
        Case{"{\"a\":[[[[[[[[[[[[[[[[[[[[[[[[1]]]]]]]]]]]]]]]]]]]]]]]]}",
             "g.json:1: syntax: ", "nested too deeply"},
        Case{"{\"log\": {\"level\": \"info\",\n\"level\": \"debug\"}}",
             "g.json:2: log.level: ", "already set in line 1"},
        Case{"{\"robots\": [{\"id\": \"a\", \"ble_address\": 5,\n\"id\": \"b\"}]}",
             "g.json:2: robots[0].id: ", "already set in line 1"}));

INSTANTIATE_TEST_SUITE_P(
    UnknownKey, ConfigProblem,
    testing::Values(
        Case{"{\n\"mqtt_sn\": {}}", "g.json:2: mqtt_sn: ", "unknown key; did you mean mqttsn?"},
        Case{R"({"ble_mesh": {"adress": 1}})",
             "g.json:1: ble_mesh.adress: ", "did you mean ble_mesh.address?"},
        Case{R"({"ble_mesh": {"Enabled": true}})",
             "g.json:1: ble_mesh.Enabled: ", "did you mean ble_mesh.enabled?"},
        Case{R"({"broker": {"keepalive": 1}})",
             "g.json:1: broker.keepalive: ", "did you mean broker.keep_alive_s?"},
        Case{R"({"mqttsn": {"retry": 1}})",
             "g.json:1: mqttsn.retry: ", "did you mean mqttsn.retry_count?"},
        Case{R"({"web": {"token": "x"}})", "g.json:1: web.token: ", "did you mean web.token_file?"},
        Case{R"({"ble_mesh": {"group": 1}})",
             "g.json:1: ble_mesh.group: ", "did you mean ble_mesh.groups?"},
        Case{R"({"broker": {"client_i": 1}})",
             "g.json:1: broker.client_i: ", "did you mean broker.client_id?"},
        Case{R"({"broker": {"url": 1}})", "g.json:1: broker.url: ", "did you mean broker.uri?"},
        Case{R"({"broker": {"ca_file": "x"}})",
             "g.json:1: broker.ca_file: ", "did you mean broker.tls.ca_file?"},
        Case{R"({"broker": {"password": "hush"}})",
             "g.json:1: broker.password: ", "into credentials.json (mode 0600)"},
        Case{R"({"broker": {"pasword_file": "hush"}})", "g.json:1: broker.pasword_file: ",
             "Known in broker: client, client_id, cluster, credentials_file, keep_alive_s, "
             "max_inflight, "
             "return_to_first, tls, uri"},
        Case{R"({"mqttsn": {"listen": 5}})", "g.json:1: mqttsn.listen: ", "a list [...] of"},
        Case{R"({"uri": "x"})", "g.json:1: uri: ", "did you mean broker.uri?"},
        Case{R"({"robots": [{"id": "r", "ble_adress": 5, "mqttsn_client_id": "c"}]})",
             "g.json:1: robots[0].ble_adress: ", "did you mean robots[].ble_address?"},
        Case{R"({"robots": [{"id": "r", "ble_address": 5, "name": "x"}]})",
             "g.json:1: robots[0].name: ",
             "did you mean robots[].id? Known in robots[]: address, ble_address, id, "
             "mqttsn_client_id, origin, prefer"},
        Case{R"({"robots": [{"id": "r", "origin": {"max_clients": 5}}]})",
             "g.json:1: robots[0].origin.max_clients: ", "did you mean robots[]."},
        Case{R"({"ble": {}})", "g.json:1: ble: ", "did you mean ble_mesh?"},
        Case{R"({"robot": []})", "g.json:1: robot: ", "did you mean robots?"},
        Case{R"({"a\nb": 1})", "g.json:1: a?b: ", "unknown key"},
        Case{R"({"": 1})", "g.json:1: : ", "unknown key; did you mean "},
        Case{R"({"web": {"password": "x"}})",
             "g.json:1: web.password: ", "into web-credentials.json (mode 0600)"},
        Case{R"({"log.level": "info"})", "g.json:1: log.level: ", "a dot in a key"},
        Case{R"({"robots[]": {}})", "g.json:1: robots[]: ", "did you mean robots?"}));

INSTANTIATE_TEST_SUITE_P(
    Broker, ConfigProblem,
    testing::Values(
        Case{R"({"gateway": {"id": "a b"}})", "g.json:1: gateway.id: ", "1-32 letters, digits"},
        Case{R"({"gateway": {"id": ""}})", "g.json:1: gateway.id: ", "an empty text"},
        Case{R"({"gateway": "g"})", "g.json:1: gateway: ", "allowed: a group of keys"},
        Case{R"({"broker": {"uri": "tcp://h"}})", "g.json:1: broker.uri: ", "mqtt://HOST[:PORT]"},
        Case{R"({"broker": {"uri": "mqtt://u:hush@h"}})",
             "g.json:1: broker.uri: ", "broker.credentials_file"},
        Case{R"({"broker": {"uri": "mqtt://h:0"}})", "g.json:1: broker.uri: ", "mqtts://HOST"},
        Case{R"({"broker": {"uri": "mqtt://h:65536"}})", "g.json:1: broker.uri: ", "mqtts://HOST"},
        Case{R"({"broker": {"uri": "mqtt://::1"}})", "g.json:1: broker.uri: ", "IPv6 in [ ]"},
        Case{R"({"broker": {"uri": "mqtt://[::1"}})", "g.json:1: broker.uri: ", "IPv6 in [ ]"},
        Case{R"({"broker": {"uri": "mqtt://1.2.3"}})", "g.json:1: broker.uri: ", "mqtts://HOST"},
        Case{R"({"broker": {"uri": "mqtt://h/x"}})", "g.json:1: broker.uri: ", "mqtts://HOST"},
        Case{R"({"broker": {"uri": 5}})", "g.json:1: broker.uri: ", "this number is not allowed"},
        Case{R"({"broker": {"uri": []}})",
             "g.json:1: broker.uri: ", "an empty list is not allowed"},
        Case{R"({"mqttsn": {"interface": ["wpan0"]}})",
             "g.json:1: mqttsn.interface: ", "a list is not allowed"},
        Case{R"({"robots": [{"id": "r", "client_id": "c", "ble_address": 256}]})",
             "g.json:1: robots[0].client_id: ", "did you mean robots[].mqttsn_client_id?"},
        Case{"{\"broker\": {\xe2\x80\x9curi\xe2\x80\x9d: 5}}",
             "g.json:1: syntax: ", "straight quotes"},
        Case{R"({"broker": {"keep_alive_s": 0}})",
             "g.json:1: broker.keep_alive_s: ", "a whole number from 1 to 65535"},
        Case{R"({"broker": {"keep_alive_s": "30"}})",
             "g.json:1: broker.keep_alive_s: ", "this text is not allowed"},
        Case{"{\"broker\": {\"keep_alive_s\": 1.5\n}}",
             "g.json:1: broker.keep_alive_s: ", "1.5 is not allowed"},
        Case{R"({"broker": {"max_inflight": 1001}})",
             "g.json:1: broker.max_inflight: ", "from 1 to 1000"},
        Case{R"({"broker": {"max_inflight": -1}})",
             "g.json:1: broker.max_inflight: ", "-1 is not allowed"},
        Case{R"({"broker": {"credentials_file": "gone"}})",
             "g.json:1: broker.credentials_file: ", "gone cannot be read: No such file"},
        Case{R"({"broker": {"keep_alive_s": "hush"}})",
             "g.json:1: broker.keep_alive_s: ", "this text is not allowed"},
        Case{R"({"mqttsn": {"dtls": {"keys_file": "{\"r1\": \"hush\"}"}}})",
             "g.json:1: mqttsn.dtls.keys_file: ", "this text is not allowed; allowed: the path"},
        Case{R"({"broker": {"credentials_file": "u\nhush"}})",
             "g.json:1: broker.credentials_file: ", "this text is not allowed; allowed: the path"},
        Case{R"({"broker": {"credentials_file": "secret"}})",
             "g.json:1: broker.credentials_file: ", "Permission denied"},
        Case{R"({"broker": {"credentials_file": "open"}})",
             "g.json:1: broker.credentials_file: ", "(mode 0644); type: sudo chmod o= open"},
        Case{R"({"broker": {"credentials_file": "broken"}})",
             "broken:3: syntax: ", "does not end on its line"},
        Case{R"({"broker": {"credentials_file": "empty"}})",
             "empty:1: syntax: ", R"(the file is empty; allowed: {"username": "...")"},
        Case{R"({"broker": {"credentials_file": "list"}})", "list:1: syntax: ", "\"username\""},
        Case{R"({"broker": {"tls": {"ca_file": "cert"}}})",
             "g.json:1: broker.tls.ca_file: ", "mqtts:// is needed"},
        Case{R"({"broker": {"uri": "mqtts://h", "tls": {"ca_file": "key"}}})",
             "g.json:1: broker.tls.ca_file: ", "key holds no certificate; a certificate as PEM"},
        Case{R"({"broker": {"uri": "mqtts://h", "tls": {"key_file": "key"}}})",
             "g.json:1: broker.tls.key_file: ", "only together"},
        Case{R"({"broker": {"uri": "mqtts://h", "tls": {"certificate_file": "cert"}}})",
             "g.json:1: broker.tls.certificate_file: ", "only together"},
        Case{R"({"broker": {"uri": "mqtts://h", "tls": {"certificate_file": "cert",
               "key_file": "key"}}})",
             "g.json:2: broker.tls.key_file: ", "does not belong to certificate_file"}));

INSTANTIATE_TEST_SUITE_P(
    Dtls, ConfigProblem,
    testing::Values(
        Case{R"({"mqttsn": {"dtls": {"keys_file": "gone"}}})",
             "g.json:1: mqttsn.dtls.keys_file: ", "sudo slam-gatewayctl key add ROBOT"},
        Case{R"({"mqttsn": {"dtls": {"keys_file": "group-keys"}}})",
             "g.json:1: mqttsn.dtls.keys_file: ", "(mode 0640); type: sudo chmod 600 group-keys"},
        Case{R"({"mqttsn": {"dtls": {"keys_file": "short-keys"}}})",
             "short-keys:2: r1: ", "(not shown: it is secret); allowed: 32 to 128 hex digits"},
        Case{R"({"mqttsn": {"dtls": {"keys_file": "exchanged-keys"}}})",
             "exchanged-keys:1: (not shown): ", "is not a key"},
        Case{R"({"mqttsn": {"dtls": {"keys_file": "level-keys"}}})",
             "level-keys:1: a/b: ", "allowed: one topic level"},
        Case{R"({"mqttsn": {"dtls": {"keys_file": "list"}}})", "list:1: syntax: ", "HEX DIGITS"},
        Case{R"({"mqttsn": {"dtls": {"keys_file": "keys", "listen": []}}})",
             "g.json:1: mqttsn.dtls.listen: ", "at least one address"},
        Case{"{\"mqttsn\": {\"listen\": [\"127.0.0.1:5\"],\n\"dtls\": {\"keys_file\": \"keys\",\n"
             "\"listen\": [\"127.0.0.1:5\"]}}}",
             "g.json:3: mqttsn.dtls.listen: ",
             "127.0.0.1:5 takes the port of 127.0.0.1:5 in mqttsn.listen"},
        Case{R"({"mqttsn": {"listen": ["0.0.0.0:47194"], "dtls": {"keys_file": "keys"}}})",
             "g.json:1: mqttsn.listen: ", "in mqttsn.dtls.listen, because [::] stands for"},
        Case{R"({"mqttsn": {"dtls": {"listen": ["47194"]}}})",
             "g.json:1: mqttsn.dtls.listen[0]: ", "[IPv6]:PORT"},
        Case{R"({"mqttsn": {"require_identity": "yes", "dtls": {"keys_file": "keys"}}})",
             "g.json:1: mqttsn.require_identity: ", R"(allowed: false, true, "all")"},
        Case{R"({"mqttsn": {"require_identity": true}})",
             "g.json:1: mqttsn.require_identity: ", "mqttsn.dtls.keys_file is needed"},
        Case{R"({"mqttsn": {"require_identity": "all"}})",
             "g.json:1: mqttsn.require_identity: ", "mqttsn.dtls.keys_file is needed"}));

INSTANTIATE_TEST_SUITE_P(
    Topics, ConfigProblem,
    testing::Values(
        Case{R"({"topics": {"prefix": "/a"}})", "g.json:1: topics.prefix: ", "without wildcards"},
        Case{R"({"topics": {"prefix": "a/"}})", "g.json:1: topics.prefix: ", "no / at either end"},
        Case{R"({"topics": {"prefix": "a//b"}})", "g.json:1: topics.prefix: ", "not empty"},
        Case{R"({"topics": {"prefix": "a\u0085"}})", "g.json:1: topics.prefix: ", "levels"},
        Case{R"({"topics": {"extra_publish": ["a/\ufffe"]}})",
             "g.json:1: topics.extra_publish[0]: ", "no control characters"},
        Case{R"({"robots": [{"id": "ble-0100", "mqttsn_client_id": "c"}]})",
             "g.json:1: robots[0].id: ", "the BLE robot at 0x0100"},
        Case{R"({"robots": [{"id": "ble-0100", "ble_address": "0x0101"}]})",
             "g.json:1: robots[0].id: ", "the BLE robot at 0x0100"},
        Case{R"({"robots": [{"id": "a\u009f", "ble_address": "0x0100"}]})",
             "g.json:1: robots[0].id: ", "without + # /"},
        Case{R"({"robots": [{"id": "a", "mqttsn_client_id": "a\ufdd0"}]})",
             "g.json:1: robots[0].mqttsn_client_id: ", "control characters"},
        Case{R"({"mqttsn": {"predefined_topics": [{"id": 1, "name": "a", "client_id": "x/y"}]}})",
             "g.json:1: mqttsn.predefined_topics[0].client_id: ", "1-64 bytes without + # /"},
        Case{R"({"broker": {"client_id": "a\u0080"}})",
             "g.json:1: broker.client_id: ", "control characters"},
        Case{R"({"mqttsn": {"predefined_topics": [{"id": 1, "name": "a\u0080"}]}})",
             "g.json:1: mqttsn.predefined_topics[0].name: ", "control characters"},
        Case{R"({"topics": {"prefix": "a/+"}})", "g.json:1: topics.prefix: ", "without wildcards"},
        Case{R"({"topics": {"prefix": "$SYS"}})", "g.json:1: topics.prefix: ", "no $ in front"},
        Case{R"({"topics": {"extra_publish": "a"}})",
             "g.json:1: topics.extra_publish: ", "a list [...] of an MQTT filter"},
        Case{"{\"topics\": {\"extra_publish\": [\"a\",\n\"a/#/b\"]}}",
             "g.json:2: topics.extra_publish[1]: ", "an MQTT filter"},
        Case{R"({"topics": {"extra_subscribe": ["a", "a"]}})",
             "g.json:1: topics.extra_subscribe[1]: ", "in this list already"},
        Case{R"({"topics": {"retain": ["map", "a/b"]}})",
             "g.json:1: topics.retain[1]: ", "the last level of a topic"},
        Case{R"({"payload": {"update": "xml"}})",
             "g.json:1: payload.update: ", R"(allowed: "positions", "json", "raw")"},
        Case{R"({"presence": {"offline_after_s": 0}})",
             "g.json:1: presence.offline_after_s: ", "from 1 to 86400"},
        Case{R"({"robots": {}})", "g.json:1: robots: ", "a list [...] of groups"},
        Case{R"({"robots": ["r"]})", "g.json:1: robots[0]: ", "a group of keys"},
        Case{R"({"robots": [{"ble_address": 5}]})", "g.json:1: robots[0].id: ", "is missing"},
        Case{R"({"robots": [{"id": "r"}]})", "g.json:1: robots[0]: ", "has no address"},
        Case{R"({"robots": [{"id": "r", "ble_address": null}]})",
             "g.json:1: robots[0]: ", "has no address"},
        Case{R"({"robots": [{"id": "r", "address": "fd00::/129"}]})",
             "g.json:1: robots[0].address: ", "a network such as fd00::/64"},
        Case{R"({"robots": [{"id": "r", "ble_address": "0x0100", "address": "fd00::1"}]})",
             "g.json:1: robots[0].address: ", "\"mqttsn_client_id\" is needed too"},
        Case{R"({"robots": [{"id": "r", "origin": 5}]})",
             "g.json:1: robots[0].origin: ", "a group of keys"},
        Case{R"({"robots": [{"id": "r", "origin": {"heading_deg": 400}}]})",
             "g.json:1: robots[0].origin.heading_deg: ", "360"},
        Case{R"({"web": {"listen": "8321"}})", "g.json:1: web.listen: ", "IPv4:PORT"},
        Case{R"({"web": {"hosts": ["a host"]}})", "g.json:1: web.hosts[0]: ", "host names"},
        Case{R"({"robots": [{"id": "a/b", "ble_address": 5}]})",
             "g.json:1: robots[0].id: ", "1-64 bytes without + # /"},
        Case{"{\"robots\": [{\"id\": \"r\", \"ble_address\": 5},\n"
             "{\"id\": \"r\", \"ble_address\": 6}]}",
             "g.json:2: robots[1].id: ", "is the id of robots[0].id already"},
        Case{R"({"robots": [{"id": "a", "ble_address": 5}, {"id": "b", "ble_address": "0x0005"}]})",
             "g.json:1: robots[1].ble_address: ", "is the address of robots[0].ble_address"},
        Case{R"({"robots": [{"id": "a", "mqttsn_client_id": "c"},
                            {"id": "b", "mqttsn_client_id": "c"}]})",
             "g.json:2: robots[1].mqttsn_client_id: ", "is the client id of robots[0]"},
        Case{R"({"robots": [{"id": "a", "ble_address": "0x8000"}]})",
             "g.json:1: robots[0].ble_address: ", R"(from "0x0001" to "0x7fff")"}));

INSTANTIATE_TEST_SUITE_P(
    BleMesh, ConfigProblem,
    testing::Values(
        Case{R"({"ble_mesh": {"enabled": 1}})", "g.json:1: ble_mesh.enabled: ", "true or false"},
        Case{R"({"ble_mesh": {"device": ""}})", "g.json:1: ble_mesh.device: ", "or \"auto\""},
        Case{R"({"ble_mesh": {"protocol": "nordic_serial"}})",
             "g.json:1: ble_mesh.protocol: ", R"(allowed: "nordic-serial", "cobs")"},
        Case{R"({"ble_mesh": {"radio": "usb"}})",
             "g.json:1: ble_mesh.radio: ", R"(allowed: "nordic", "bluez")"},
        Case{R"({"ble_mesh": {"controller": "/dev/ttyACM0"}})",
             "g.json:1: ble_mesh.controller: ", R"("hci0")"},
        Case{R"({"ble_mesh": {"radio": "bluez", "protocol": "cobs", "robot_id": "r"}})",
             "g.json:1: ble_mesh.protocol: ", "is for a serial board"},
        Case{R"({"ble_mesh": {"protocol": "cobs"}})",
             "g.json:1: ble_mesh.robot_id: ", "is missing"},
        Case{R"({"ble_mesh": {"cobs_content": "x"}})",
             "g.json:1: ble_mesh.cobs_content: ", "\"lien\""},
        Case{R"({"ble_mesh": {"baud_rate": 300}})", "g.json:1: ble_mesh.baud_rate: ", "from 1200"},
        Case{R"({"ble_mesh": {"flow_control": true}})",
             "g.json:1: ble_mesh.flow_control: ", R"("auto", "none", "rts_cts")"},
        Case{R"({"ble_mesh": {"address": 0}})", "g.json:1: ble_mesh.address: ", "0x7fff"},
        Case{R"({"ble_mesh": {"address": "0100"}})", "g.json:1: ble_mesh.address: ", "0x0001"},
        Case{R"({"ble_mesh": {"address": "0x1g"}})", "g.json:1: ble_mesh.address: ", "0x0001"},
        Case{R"({"ble_mesh": {"ttl": 1}})", "g.json:1: ble_mesh.ttl: ", "from 2 to 127"},
        Case{R"({"ble_mesh": {"ttl": 128}})", "g.json:1: ble_mesh.ttl: ", "from 2 to 127"},
        Case{R"({"ble_mesh": {"groups": ["0xc000", "0xbfff"]}})",
             "g.json:1: ble_mesh.groups[1]: ", R"(from "0xc000" to "0xfeff")"},
        Case{R"({"ble_mesh": {"groups": ["0xc000", 49152]}})",
             "g.json:1: ble_mesh.groups[1]: ", "already"},
        Case{R"({"ble_mesh": {"gateway_group": "0x0001"}})",
             "g.json:1: ble_mesh.gateway_group: ", R"(from "0xc000" to "0xfeff")"},
        Case{R"({"ble_mesh": {"gateway_group": "0xc003"}})",
             "g.json:1: ble_mesh.gateway_group: ", "any other group"},
        Case{R"({"ble_mesh": {"relay": ["robot/+/adv"]}})",
             "g.json:1: ble_mesh.relay[0]: ", "BLE robots hear updates only"},
        Case{R"({"ble_mesh": {"relay": ["robot/#"]}})",
             "g.json:1: ble_mesh.relay[0]: ", "\"robot/+/update\""},
        Case{R"({"ble_mesh": {"relay": ["robot/a/b/update"]}})",
             "g.json:1: ble_mesh.relay[0]: ", "\"robot/+/update\""},
        Case{R"({"ble_mesh": {"relay": ["robot//update"]}})",
             "g.json:1: ble_mesh.relay[0]: ", "\"robot/+/update\""},
        Case{R"({"ble_mesh": {"relay": ["robot/update"]}})",
             "g.json:1: ble_mesh.relay[0]: ", "\"robot/+/update\""},
        Case{R"({"ble_mesh": {"relay": ["robot/a/update", "robot/+/update"]}})",
             "g.json:1: ble_mesh.relay: ", "that filter alone"},
        Case{R"({"ble_mesh": {"relay": ["robot/+/update"]}, "payload": {"update": "json"}})",
             "g.json:1: ble_mesh.relay: ", "payload.update"},
        Case{R"({"ble_mesh": {"relay": ["robot/+/update"], "protocol": "cobs", "robot_id": "a"}})",
             "g.json:1: ble_mesh.relay: ", "nordic-serial"},
        Case{R"({"ble_mesh": {"relay_group": "0x0001"}})",
             "g.json:1: ble_mesh.relay_group: ", R"(from "0xc000" to "0xfeff")"},
        Case{R"({"ble_mesh": {"relay": ["robot/a/update"], "relay_group": "0xc003"}})",
             "g.json:1: ble_mesh.relay_group: ", "any other group"},
        Case{R"({"ble_mesh": {"relay": ["robot/a/update"], "gateway_group": "0xc100"}})",
             "g.json:1: ble_mesh.relay_group: ", "any other group"},
        Case{R"({"ble_mesh": {"types": {"min_com": "a/b"}}})",
             "g.json:1: ble_mesh.types.min_com: ", "without + # /"},
        Case{R"({"ble_mesh": {"types": {"pos_cmd": "run"}}})",
             "g.json:1: ble_mesh.types.pos_cmd: ", "any other type"},
        Case{"{\"ble_mesh\": {\"types\": {\n\"min_com\": \"a\",\n\"sensor_update\": \"a\"}}}",
             "g.json:3: ble_mesh.types.sensor_update: ",
             "is the type of ble_mesh.types.min_com already"},
        Case{R"({"ble_mesh": {"types": {"min_com": "cmd"}}})",
             "g.json:1: ble_mesh.types.min_com: ", "is the type of ble_mesh.types.pos_cmd already"},
        Case{R"({"ble_mesh": {"on_off_model": null}})",
             "g.json:1: ble_mesh.on_off_model: ", "null is not allowed; allowed: \"generic\""},
        Case{R"({"ble_mesh": {"provisioning": false}})",
             "g.json:1: ble_mesh.provisioning: ", "a group of keys"},
        Case{R"({"ble_mesh": {"provisioning": {"uuid_prefixes": ["xy"]}}})",
             "g.json:1: ble_mesh.provisioning.uuid_prefixes[0]: ", "1-32 hex digits"},
        Case{R"({"ble_mesh": {"provisioning": {"static_oob": "hush"}}})",
             "g.json:1: ble_mesh.provisioning.static_oob: ", "32 hex digits"},
        Case{"{\"ble_mesh\": {\n\"will\": {\"topic\": \"t\"}}}",
             "g.json:2: ble_mesh.will.message: ", "is missing"},
        Case{R"({"ble_mesh": {"will": {"topic": "t/#", "message": "m"}}})",
             "g.json:1: ble_mesh.will.topic: ", "without wildcards"}));

INSTANTIATE_TEST_SUITE_P(
    MqttSn, ConfigProblem,
    testing::Values(
        Case{R"({"mqttsn": {"listen": []}})", "g.json:1: mqttsn.listen: ", "at least one"},
        Case{R"({"mqttsn": {"listen": ["::1:5"]}})", "g.json:1: mqttsn.listen[0]: ", "[IPv6]:PORT"},
        Case{R"({"mqttsn": {"listen": ["[::]"]}})", "g.json:1: mqttsn.listen[0]: ", "[IPv6]:PORT"},
        Case{R"({"mqttsn": {"listen": ["h:5"]}})", "g.json:1: mqttsn.listen[0]: ", "IPv4:PORT"},
        Case{R"({"mqttsn": {"listen": ["1.2.3.4:65536"]}})",
             "g.json:1: mqttsn.listen[0]: ", "IPv4:PORT"},
        Case{"{\"mqttsn\": {\n\"listen\": [\"[::]:5\",\n\"0.0.0.0:5\"]}}",
             "g.json:2: mqttsn.listen: ", "[::] stands for all IPv6 and IPv4 addresses"},
        Case{R"({"mqttsn": {"listen": ["127.0.0.1:5", "0.0.0.0:5"]}})",
             "g.json:1: mqttsn.listen: ", "0.0.0.0 stands for all IPv4 addresses; another port"},
        Case{R"({"mqttsn": {"listen": ["[::1]:5", "[0::1]:05"]}})",
             "g.json:1: mqttsn.listen: ", "another port, or one of the two, is allowed"},
        Case{R"({"mqttsn": {"listen": ["[::]:5", "0.0.0.0:x"]}})",
             "g.json:1: mqttsn.listen[1]: ", "IPv4:PORT"},
        Case{R"({"mqttsn": {"announce": true}})",
             "g.json:1: mqttsn.announce: ", "the name of the LAN's interface is needed"},
        Case{R"({"mqttsn": {"announce": true, "interface": "lo"}})",
             "g.json:1: mqttsn.announce: ", "the name of the LAN's interface is needed"},
        Case{R"({"mqttsn": {"announce": true, "interface": "wpan0"}})",
             "g.json:1: mqttsn.announce: ", "mqttsn.interface \"wpan0\" may not serve"},
        Case{R"({"mqttsn": {"announce": {"enabled": false}}})", "g.json:1: mqttsn.announce",
             "allowed: true or false"},
        Case{R"({"mqttsn": {"announce": true, "interface": "*", "require_identity": "all",)"
             R"( "dtls": {"keys_file": "keys"}}})",
             "g.json:1: mqttsn.announce: ", "announces the port of plain MQTT-SN"},
        Case{R"({"mqttsn": {"announce": true, "interface": "*", "listen": ["127.0.0.1:1"]}})",
             "g.json:1: mqttsn.announce: ", "needs an address such as [::]:47193"},
        Case{R"({"mqttsn": {"interface": "a/b"}})",
             "g.json:1: mqttsn.interface: ", "\"auto\", \"*\", or the name of a network interface"},
        Case{R"({"mqttsn": {"multicast_group": "fd00::1"}})",
             "g.json:1: mqttsn.multicast_group: ", "multicast address"},
        Case{R"({"mqttsn": {"multicast_group": "223.1.1.1"}})",
             "g.json:1: mqttsn.multicast_group: ", "multicast address"},
        Case{R"({"mqttsn": {"gateway_id": 256}})", "g.json:1: mqttsn.gateway_id: ", "1 to 255"},
        Case{R"({"mqttsn": {"advertise_interval_s": 65536}})",
             "g.json:1: mqttsn.advertise_interval_s: ", "1 to 65535"},
        Case{R"({"mqttsn": {"predefined_topics": [{"id": 65535, "name": "a"}]}})",
             "g.json:1: mqttsn.predefined_topics[0].id: ", "1 to 65534"},
        Case{R"({"mqttsn": {"predefined_topics": [{"id": 1}]}})",
             "g.json:1: mqttsn.predefined_topics[0].name: ", "is missing"},
        Case{
            R"({"mqttsn": {"predefined_topics": [{"id": 1, "name": "a"}, {"id": 1, "name": "b"}]}})",
            "g.json:1: mqttsn.predefined_topics[1].id: ", "already"},
        Case{R"({"mqttsn": {"keep_alive_tolerance": 0.9}})",
             "g.json:1: mqttsn.keep_alive_tolerance: ", "a number from 1 to 100"},
        Case{R"({"mqttsn": {"when_full": "drop"}})", "g.json:1: mqttsn.when_full: ", "\"reject\""},
        Case{R"({"mqttsn": {"max_clients": 99999999999999999999}})",
             "g.json:1: mqttsn.max_clients: ", "1 to 1000000"},
        Case{R"({"store": {"max_bytes": 0}})", "g.json:1: store.max_bytes: ", "from 1 to"},
        Case{R"({"log": {"level": "trace"}})",
             "g.json:1: log.level: ", R"("trace" is not allowed; allowed: "debug", "info")"},
        Case{R"({"log": {"traffic": "none"}})", "g.json:1: log.traffic: ", "\"sampled\""}));

TEST(ConfigProblems, AreAllReportedInOneRunByLine) {
  const Problems problems = problems_of(
      "{\"log\": {\"level\": 1,\n\"trafic\": 2},\n\"robots\": [{}],\n\"broker\":\n"
      "{\"credentials_file\": \"odd\", \"uri\": \"\"}}");
  std::vector<std::string> places;
  for (const Problem& problem : problems)
    places.push_back(problem.file + ":" + std::to_string(problem.line) + ": " + problem.key);
  EXPECT_EQ(places, (std::vector<std::string>{"g.json:1: log.level", "g.json:2: log.trafic",
                                              "g.json:3: robots[0].id", "g.json:3: robots[0]",
                                              "g.json:5: broker.uri", "odd:1: username",
                                              "odd:1: password", "odd:2: pasword"}));
}

TEST(ConfigProblems, IncludeTooLongSocketPath) {
  const std::string path(200, 'x');
  const Problems problems = problems_of(R"({"control": {"socket": "/)" + path + "\"}}");
  ASSERT_EQ(problems.size(), 1U);
  EXPECT_NE(problems[0].text.find("107 bytes"), std::string::npos);
}

// Has every kind of JSON value.
constexpr std::string_view sample = R"(// comment
{"broker": {"uri": "mqtt://[::1]:1", "keep_alive_s": 5}, /* another */
 "robots": [{"id": "r\u00e9", "ble_address": "0x0100"}, {"id": "s", "ble_address": 7}],
 "mqttsn": {"keep_alive_tolerance": 1.5e0, "enabled": false, "multicast_group": null}})";

TEST(ConfigProblems, EveryTruncationIsOneProblem) {
  ASSERT_TRUE(problems_of(sample).empty());
  for (std::size_t size = 0; size < sample.size(); ++size)
    ASSERT_EQ(problems_of(sample.substr(0, size)).size(), 1U) << size;
}

TEST(ConfigProblems, GarbageNeverCrashesTheParser) {
  std::mt19937 random(7);
  const auto below = [&random](std::size_t bound) {
    return std::uniform_int_distribution<std::size_t>(0, bound - 1)(random);
  };
  constexpr std::string_view alphabet = "{}[]\",:/*\\ \n0123456789.eE+-truefalsn\xff\x80";
  std::size_t bad = 0;
  for (int round = 0; round < 1000; ++round) {
    std::string text(sample);
    for (int change = 0; change < 3; ++change)
      text[below(text.size())] = alphabet[below(alphabet.size())];
    bad += problems_of(text).empty() ? 0 : 1;
  }
  EXPECT_GT(bad, 0U);
}

}  // namespace
}  // namespace slamgw::test
