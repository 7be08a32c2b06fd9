// SPDX-License-Identifier: Apache-2.0
// The built slam-gatewayctl against a control server: what it prints and how it ends.
#include <fcntl.h>
#include <signal.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <boost/asio/ip/udp.hpp>
#include <cstdlib>
#include <fstream>
#include <sstream>

#include "daemon/observability/audit_notice.hpp"
#include "tests/control/control_program_fixture.hpp"

namespace slamgw::test {
namespace {

using namespace std::chrono_literals;

TEST_F(ControlProgramIo, ShowsTheStatus) {
  start();
  handler.status_answer = json::parse(R"({"version": "1.2.3", "gateway": "g1", "uptime_s": 90000,
      "broker": {"state": "down", "uri": "mqtt://h:1", "since": "T", "why": "refused"},
      "meshes": {"ble": {"state": "disabled"}, "thread": {"state": "up", "detail": "[::]:47193",
                     "counters": {"connects_refused": 3, "unconnected_refused": 17},
                     "places": {"max": 100, "taken": 90, "unproven": 80,
                                "most": {"address": "fd00::/64", "clients": 90},
                                "most_unproven": {"address": "fd00::9", "clients": 70}}}},
      "robots": {"online": 5, "asleep": 1, "offline": 2, "known": 8},
      "messages": {"up": 10, "down": 2, "dropped": 3, "stored": 4, "rejected": 5},
      "store": {"depth": 6, "bytes": 2048, "max_bytes": 1048576,
                "filled_by": {"robot": "r1", "bytes": 1024}, "dead_letters": 2,
                "dead_letter_bytes": 512, "dead_letters_nearly_full": true},
      "retained": {"topics": 20, "max": 4096, "most": {"robot": "r2", "topics": 16}},
      "memory_rss_bytes": 3145728})");
  const Ended result = run({"status"});
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(
      result.out,
      "slam-gatewayd 1.2.3, gateway g1, up 1 d 1 h, 3.0 MiB memory\n"
      "Broker    down     mqtt://h:1 since T\n"
      "                   refused\n"
      "BLE       disabled\n"
      "Thread    up       [::]:47193\n"
      "          90 of 100 places taken (90 of them at fd00::/64), 80 by clients that have not "
      "answered yet (70 of them at fd00::9)\n"
      "          refused: 3 connections, 17 messages of QoS -1\n"
      "Robots    5 online, 1 asleep, 2 offline (8 known)\n"
      "Messages  10 in, 2 out, 3 dropped, 4 stored, 5 rejected\n"
      "Store     6 messages, 2.0 KiB of 1.0 MiB\n"
      "          nearly full: r1 has stored 1.0 KiB\n"
      "          2 dead letters, 512 B, nearly no room for more: see slam-gatewayctl store list\n"
      "Retained  20 of 4096 topics, most by r2: 16\n");
}

TEST_F(ControlProgramIo, MentionsUnprovenClientsOnlyWhenTheyAreMany) {
  start();
  json& places = handler.status_answer["meshes"]["thread"]["places"];
  places = json::parse(R"({"max": 1000, "taken": 3, "unproven": 3})");
  EXPECT_EQ(run({"status"}).out.find("not answered"), std::string::npos);
  places["unproven"] = 100;
  EXPECT_NE(run({"status"}).out.find("not answered"), std::string::npos) << "many clients";
}

TEST_F(ControlProgramIo, IdentifiesItsUserToTheDaemon) {
  start();
  run({"reload"});
  run({"forget", "r1"});
  EXPECT_EQ(handler.who, std::vector<std::string>(2, user_words(getuid())));
}

/// Replaces programs of the host by scripts.
class HostPrograms : public ControlProgramIo {
 protected:
  void SetUp() override { setenv("PATH", (directory.path() + ":" + path_before).c_str(), 1); }
  void TearDown() override { setenv("PATH", path_before.c_str(), 1); }
  void make_program(const char* name, const std::string& script) {
    const std::string file = directory / name;
    std::ofstream(file) << "#!/bin/sh\n" << script;
    chmod(file.c_str(), 0755);
  }

  const std::string path_before = getenv("PATH");
};

TEST_F(HostPrograms, ShowWhetherServiceRefusedItsConfiguration) {
  make_program("systemctl", "echo 78");
  EXPECT_NE(run({"status"})
                .err.find("its configuration was refused: sudo slam-gatewayd "
                          "--check-config; then: sudo systemctl start slam-gateway"),
            std::string::npos);
  make_program("systemctl", "echo 1");
  const std::string other = run({"status"}).err;
  EXPECT_NE(other.find("start it with: sudo systemctl start slam-gateway"), std::string::npos);
  EXPECT_EQ(other.find("refused"), std::string::npos);
}

/// A script in place of `journalctl` can print its own arguments, so that a test sees them.
class AuditTrail : public HostPrograms {
 protected:
  void make_journal(const std::string& script) { make_program("journalctl", script); }
};

TEST_F(AuditTrail, IsReadBackFromTheJournal) {
  make_journal(R"sh(cat <<END
-- a line that is not an entry
{"__REALTIME_TIMESTAMP":"1764277200123456","MESSAGE":"$*","ROBOT_ID":"r1","SLAM_AUDIT_WHO":"uid 0 (root)","SLAM_AUDIT_WHAT":"forget","SLAM_AUDIT_OUTCOME":"done"}
{"__REALTIME_TIMESTAMP":"1764277201000000","MESSAGE":"m","SLAM_AUDIT_WHO":"SIGHUP","SLAM_AUDIT_WHAT":"reload","SLAM_AUDIT_OUTCOME":"failed"}
END
)sh");
  const Ended text = run({"audit"});
  EXPECT_EQ(text.status, 0) << text.err;
  EXPECT_EQ(text.out,
            "2025-11-27T21:00:00.123Z  uid 0 (root): forget r1: done\n"
            "2025-11-27T21:00:01.000Z  SIGHUP: reload: failed\n");
  const json entries = json::parse(run({"--json", "audit", "--robot", "r1"}).out);
  ASSERT_EQ(entries.size(), 2U);
  EXPECT_EQ(entries[0]["robot"], "r1");
  EXPECT_EQ(entries[0]["who"], "uid 0 (root)");
  EXPECT_FALSE(entries[1].contains("robot"));
  const std::string asked = entries[0]["text"];
  EXPECT_NE(asked.find("SLAM_AUDIT=1 _SYSTEMD_UNIT=slam-gateway.service ROBOT_ID=r1 + SLAM_AUDIT=1 "
                       "_UID=0 ROBOT_ID=r1"),
            std::string::npos)
      << asked;
}

TEST_F(AuditTrail, NamesRemedyWithoutJournal) {
  make_journal("exit 0\n");
  const Ended empty = run({"audit"});
  EXPECT_EQ(empty.status, 1);
  EXPECT_NE(empty.err.find("sudo slam-gatewayctl audit"), std::string::npos) << empty.err;
  EXPECT_NE(empty.err.find("standard error"), std::string::npos) << empty.err;
  make_journal("echo no right >&2; exit 1\n");
  const Ended closed = run({"audit"});
  EXPECT_EQ(closed.status, 1);
  EXPECT_NE(closed.err.find("cannot be read: no right"), std::string::npos) << closed.err;
  setenv("PATH", (directory / "nowhere").c_str(), 1);
  const Ended none = run({"audit"});
  EXPECT_EQ(none.status, 1);
  EXPECT_NE(none.err.find("this host has no journal"), std::string::npos) << none.err;
  setenv("PATH", (directory.path() + ":" + path_before).c_str(), 1);
  make_journal("case \"$*\" in *cat*) echo started;; esac\n");
  EXPECT_EQ(run({"audit"}).out, "no orders were found\n");
}

TEST_F(ControlProgramIo, GivesJsonBeforeAndAfterTheCommand) {
  start();
  handler.robots_answer.push_back({{"id", "r1"}});
  for (const auto& arguments :
       {std::vector<std::string>{"--json", "robots"}, {"robots", "--json"}}) {
    const Ended result = run(arguments);
    EXPECT_EQ(result.status, 0) << result.err;
    EXPECT_EQ(json::parse(result.out), handler.robots_answer);
  }
  EXPECT_EQ(json::parse(run({"status", "--json"}).out), handler.status_answer);
}

TEST_F(ControlProgramIo, ShowsRobotsIn80ColumnsWithoutColour) {
  start();
  EXPECT_EQ(run({"robots"}).out, "no robot has been heard yet\n");
  for (const std::string id : {"r1", "a-robot-with-quite-a-long-name-that-goes-on-and-on"}) {
    handler.robots_answer.push_back({{"id", id},
                                     {"mesh", "thread"},
                                     {"address", "[fd11:2233:4455:6677:8899:aabb:ccdd:eeff]:47193"},
                                     {"state", "online"},
                                     {"last_seen", "2020-01-01T00:00:00Z"},
                                     {"messages", 12345678},
                                     {"rate_hz", 5.04},
                                     {"rssi_dbm", nullptr},
                                     {"queue", 0}});
  }
  const Ended result = run({"robots"});
  EXPECT_EQ(result.status, 0) << result.err;
  std::istringstream lines(result.out);
  int count = 0;
  for (std::string line; std::getline(lines, line); ++count) EXPECT_LE(line.size(), 80U) << line;
  EXPECT_EQ(count, 3);
  EXPECT_NE(result.out.find("~f]:47193 online"), std::string::npos) << result.out;
  EXPECT_NE(result.out.find("12345678"), std::string::npos);
  EXPECT_EQ(result.out.find('\033'), std::string::npos);
}

TEST_F(ControlProgramIo, ColoursOnTerminalUnlessNoColorIsSet) {
  start();
  handler.status_answer = {{"broker", {{"state", "up"}}}};
  const int terminal = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
  ASSERT_TRUE(terminal >= 0 && grantpt(terminal) == 0 && unlockpt(terminal) == 0);
  const auto shown_with = [&](const std::string& no_color) {
    ChildProcess child({"env", no_color, SLAMGW_CTL, "--socket", path, "status"},
                       ptsname(terminal));
    EXPECT_TRUE(wait_until([&] { return !child.is_running(); }));
    char shown[4096];
    const ssize_t size = read(terminal, shown, sizeof shown);
    return std::string(shown, static_cast<std::size_t>(std::max<ssize_t>(size, 0)));
  };
  EXPECT_NE(shown_with("NO_COLOR=").find("\033[32mup"), std::string::npos);
  const std::string plain = shown_with("NO_COLOR=1");
  EXPECT_NE(plain.find("Broker"), std::string::npos);
  EXPECT_EQ(plain.find('\033'), std::string::npos) << plain;
  close(terminal);
}

TEST_F(ControlProgramIo, AnswersBesideWatcherThatDoesNotRead) {
  start({.queued_bytes = 4096});
  const auto stuck = launch({"watch"});
  ASSERT_TRUE(wait_until([&] { return server->has_watchers(); }));
  stuck->send_signal(SIGSTOP);
  TraceEvent event;
  event.robot = "r1";
  event.type = "adv";
  event.payload = to_bytes(std::string(1000, 'x'));
  for (int i = 0; i < 10000 && counter("events_lost") == 0; ++i) server->publish(event);
  EXPECT_GT(counter("events_lost"), 0U);
  const auto one = launch({"status", "--json"});
  const auto two = launch({"robots", "--json"});
  EXPECT_EQ(finish(*two).status, 0);
  EXPECT_TRUE(wait_until([&] { return !one->is_running(); }));
  EXPECT_EQ(one->wait(), 0);
}

TEST_F(ControlProgramIo, FailsWhenItsOutputIsLost) {
  start();
  const std::vector<std::string> to_full_disk{"sh", "-c", "exec \"$@\" >/dev/full", "sh"};
  const std::string why = "slam-gatewayctl: standard output: No space left on device\n";
  for (const std::vector<std::string>& arguments :
       {std::vector<std::string>{"status"}, {"robots", "--json"}, {"--version"}, {"--help"}}) {
    const Ended ended = run(arguments, to_full_disk);
    EXPECT_EQ(ended.status, 1) << arguments.front();
    EXPECT_EQ(ended.err, why) << arguments.front();
  }
  const auto watching = launch({"watch"}, to_full_disk);
  ASSERT_TRUE(wait_until([&] { return server->has_watchers(); }));
  TraceEvent event;
  event.robot = "r1";
  event.type = "adv";
  server->publish(event);
  const Ended ended = finish(*watching);
  EXPECT_EQ(ended.status, 1);
  EXPECT_EQ(ended.err, why);
}

TEST_F(ControlProgramIo, WritesNothingIntoItsSocketWithoutStandardOutputOrError) {
  start();
  const Ended closed = run({"status"}, {"sh", "-c", "exec \"$@\" >&-", "sh"});
  EXPECT_EQ(closed.status, 1);
  EXPECT_EQ(closed.err, "slam-gatewayctl: standard output: Bad file descriptor\n");
  handler.store_answers.push_back({R"({"resent": 0, "left": 0})", {}});
  const Ended mute = run({"store", "resend", "7"}, {"sh", "-c", "exec \"$@\" 2>&-", "sh"});
  EXPECT_EQ(mute.status, 1) << "there is no such dead letter";
  EXPECT_EQ(run({"status"}).status, 0);
  EXPECT_EQ(counter("bad_requests"), 0U);
}

TEST_F(ControlProgramIo, WatchesDecodedTraffic) {
  start();
  const auto child = launch({"watch", "--robot", "r1"});
  ASSERT_TRUE(wait_until([&] { return server->has_watchers(); }));
  TraceEvent event;
  event.mesh = Mesh::ble;
  event.robot = "r1";
  event.type = "update";
  event.at = WallTime{1'700'000'000s + 42137us};
  event.payload = {1};
  event.update = Update{{10, -20}, {{100, 300}, {-5, 6}}};
  event.radio = RadioFacts{-61, 2, 3};
  server->publish(event);
  event.update->obstacles.clear();
  event.radio.reset();
  event.wire = {17, true};
  server->publish(event);
  event.update.reset();
  event.payload.reset();
  event.kind = StepKind::acknowledged;
  event.latency = 1250us;
  server->publish(event);
  event.kind = StepKind::command;
  event.latency.reset();
  event.wire = {};
  event.type = "cmd";
  event.payload = {0x78, 0x00, 0xdf, 0xff};
  server->publish(event);
  event.type = "run";
  event.payload = to_bytes("start");
  server->publish(event);
  event.payload = {0xff, 0x00, 0x1b};
  server->publish(event);
  event.payload.reset();
  event.kind = StepKind::outcome;
  event.outcome = CommandResult::timeout;
  event.why = "silent";
  server->publish(event);
  event.robot = "other";
  server->publish(event);
  const auto has_seven_lines = [this] {
    const std::string out = read_file(file("out"));
    return std::count(out.begin(), out.end(), '\n') >= 7;
  };
  EXPECT_TRUE(wait_until(has_seven_lines));
  server->stop();
  const Ended result = finish(*child);
  EXPECT_EQ(
      result.out,
      "22:13:20.042 arrived      ble    r1           update  "
      "x=10 y=-20 obstacles=100,300;-5,6 -61 dBm 2 hops\n"
      "22:13:20.042 arrived      ble    r1           update  x=10 y=-20 obstacles=none #17 dup\n"
      "22:13:20.042 acknowledged ble    r1           update  #17 dup after 1.2 ms\n"
      "22:13:20.042 command      ble    r1           cmd     x=120 y=-33\n"
      "22:13:20.042 command      ble    r1           run     'start'\n"
      "22:13:20.042 command      ble    r1           run     ff001b\n"
      "22:13:20.042 outcome      ble    r1           run     timeout: silent\n");
  EXPECT_NE(result.err.find("no robot called 'r1' has been heard"), std::string::npos)
      << result.err;
  EXPECT_EQ(result.status, 1);
  EXPECT_NE(result.err.find("hung up"), std::string::npos) << result.err;
}

TEST_F(ControlProgramIo, WatchesWithOneJsonDocumentPerLine) {
  start();
  const auto child = launch({"--json", "watch", "--type", "adv"});
  ASSERT_TRUE(wait_until([&] { return server->has_watchers(); }));
  TraceEvent event;
  event.robot = "r1";
  event.type = "adv";
  event.at = WallTime{1'700'000'000s + 42137us};
  event.payload = to_bytes("hi");
  server->publish(event);
  ASSERT_TRUE(wait_until([&] { return read_file(file("out")).ends_with('\n'); }));
  const json line = json::parse(read_file(file("out")));
  EXPECT_EQ(line, json::parse(R"({"at": "2023-11-14T22:13:20.042137Z", "event": "arrived",
      "robot": "r1", "type": "adv", "direction": "up", "payload": "6869", "text": "hi"})"));
}

TEST_F(ControlProgramIo, SendsPayloadsOfAllKinds) {
  start();
  const auto payload_of = [this](std::vector<std::string> arguments) {
    const Ended result = send(std::move(arguments), delivered_);
    EXPECT_EQ(result.status, 0) << result.err;
    EXPECT_EQ(result.out, "delivered after 12 ms\n");
    return handler.sent.empty() ? std::string("nothing") : to_hex(handler.sent[0].payload);
  };
  EXPECT_EQ(payload_of({"r1", "cmd", "120,-33"}), "7800dfff");
  EXPECT_EQ(payload_of({"r1", "cmd", "-32768,32767"}), "0080ff7f");
  EXPECT_EQ(payload_of({"r1", "cmd", "--", "-1,0"}), "ffff0000");
  EXPECT_EQ(payload_of({"r1", "any", "-1"}), "2d31");
  EXPECT_EQ(payload_of({"r1", "run", "start"}), "7374617274");
  EXPECT_EQ(payload_of({"r1", "cmd", "--hex", "00FF"}), "00ff");
  EXPECT_EQ(payload_of({"--hex", "r1", "any", ""}), "");
  EXPECT_EQ(handler.sent[0].robot, "r1");
  EXPECT_EQ(handler.sent[0].type, "any");
}

TEST_F(ControlProgramIo, FailsWhenACommandWasNotDelivered) {
  start();
  const Ended result = send({"r1", "cmd", "-1,-1", "--json"},
                            {{"outcome", "timeout"}, {"after_ms", 30000}, {"why", "silent"}});
  EXPECT_EQ(result.status, 1);
  EXPECT_EQ(json::parse(result.out)["why"], "silent");
  EXPECT_EQ(
      send({"r1", "run", "1"}, {{"outcome", "refused"}, {"after_ms", 0}, {"why", "no robot 'r1'"}})
          .out,
      "refused after 0 ms: no robot 'r1'\n");
}

TEST_F(ControlProgramIo, NamesGatewayThatServesRobot) {
  start();
  handler.fleet_answer["robots"] = {{{"robot", "r1"}, {"gateway", "room-b"}},
                                    {{"robot", "r2"}, {"gateway", "room-a"}},
                                    {{"robot", "r4"}, {"gateway", "dark"}, {"served", false}}};
  const json refused = {
      {"outcome", "refused"}, {"after_ms", 0}, {"why", "another gateway serves this robot"}};
  const Ended elsewhere = send({"r1", "run", "1"}, refused);
  EXPECT_EQ(elsewhere.status, 1);
  EXPECT_EQ(elsewhere.out, "refused after 0 ms: another gateway serves this robot\n");
  EXPECT_NE(elsewhere.err.find("r1 is served by gateway room-b"), std::string::npos)
      << elsewhere.err;
  EXPECT_EQ(send({"r2", "run", "1"}, refused).err, "") << "this gateway serves it";
  EXPECT_EQ(send({"r3", "run", "1"}, refused).err, "") << "no gateway serves it";
  EXPECT_EQ(send({"r4", "run", "1"}, refused).err, "") << "that gateway is silent";
}

TEST_F(ControlProgramIo, AsksForMqttsnSessions) {
  start();
  EXPECT_EQ(json::parse(run({"mqttsn", "clients", "--json"}).out)[0]["robot"], "all");
  EXPECT_EQ(json::parse(run({"mqttsn", "clients", "r1", "--json"}).out)[0]["robot"], "r1");
  const Ended unknown = run({"mqttsn", "clients", "stranger"});
  EXPECT_EQ(unknown.status, 1);
  EXPECT_NE(unknown.err.find("stranger has no MQTT-SN session here"), std::string::npos);
}

TEST_F(ControlProgramIo, EndsWithTwoForWrongArguments) {
  const std::vector<std::vector<std::string>> wrong = {
      {},
      {"nonsense"},
      {"status", "--nonsense"},
      {"send", "r1", "cmd"},
      {"send", "r1", "cmd", "12"},
      {"send", "r1", "cmd", "1,40000"},
      {"send", "r1", "cmd", "1,2,3"},
      {"send", "--hex", "r1", "cmd", "0"},
      {"send", "--hex=false", "r1", "cmd", "00"},
      {"ble"},
      {"ble", "provision", "00"},
      {"ble", "reset-board"},
      {"ble", "import"},
      {"forget", ""},
      {"watch", "--robot", ""},
      {"watch", "--type", "adv/x"},
      {"watch", "--type", "+"},
      {"store", "list", "--topic", ""},
      {"store", "discard", "--all=false"},
      {"doctor", ""},
      {"replay", "recording", "--broker", "foo"},
      {"replay", "recording", "--speed", "nan"},
      {"replay", "recording", "--speed", "0"},
  };
  for (const auto& arguments : wrong) {
    const Ended result = run(arguments);
    EXPECT_EQ(result.status, 2) << testing::PrintToString(arguments);
    EXPECT_NE(result.err, "") << testing::PrintToString(arguments);
  }
  EXPECT_NE(run({"--socket", "x", "robot"}).err.find("'robot'; did you mean robots?"),
            std::string::npos);
  EXPECT_NE(run({"frobnicate"}).err.find("'frobnicate'; there are: status, robots"),
            std::string::npos)
      << "no command is similar";
  EXPECT_NE(run({"stat"}).err.find("did you mean status?"), std::string::npos);
  EXPECT_NE(run({"ble", "node"}).err.find("'ble node'; did you mean nodes?"), std::string::npos);
  EXPECT_NE(run({"--json", "store"}).err.find("a command is missing; there are: list, export"),
            std::string::npos);
  EXPECT_NE(run({}).err.find("a command is missing; there are: status"), std::string::npos);
  for (const auto& arguments : std::vector<std::vector<std::string>>{
           {"--nope"}, {"--nope=1", "status"}, {"store", "--nope"}})
    EXPECT_NE(run(arguments).err.find("no option '--nope"), std::string::npos)
        << testing::PrintToString(arguments);
  EXPECT_EQ(run({"--help"}).status, 0);
  EXPECT_EQ(run({"ble", "--help"}).status, 0);
  EXPECT_EQ(run({"--version"}).out, "slam-gatewayctl " SLAMGW_VERSION "\n");
}

TEST_F(ControlProgramIo, NamesReasonWhenDaemonCannotBeReached) {
  Ended result = run({"status"});
  EXPECT_EQ(result.status, 1);
  EXPECT_NE(result.err.find("is not running: there is no " + path), std::string::npos);
  {
    boost::asio::local::stream_protocol::acceptor dead(
        io, boost::asio::local::stream_protocol::endpoint(path));
  }
  result = run({"status"});
  EXPECT_EQ(result.status, 1);
  EXPECT_NE(result.err.find("no answer at " + path), std::string::npos) << result.err;
  path = directory / "file";
  write_file(path, "");
  result = run({"robots"});
  EXPECT_EQ(result.status, 1);
  EXPECT_NE(result.err.find("is not a socket"), std::string::npos) << result.err;
}

TEST_F(ControlProgramIo, NamesGroupToJoin) {
  start();
  chmod(path.c_str(), 0);
  const std::vector<std::string> as_nobody = {"setpriv", "--reuid=65534", "--regid=65534",
                                              "--clear-groups"};
  const Ended result = run({"status"}, geteuid() == 0 ? as_nobody : std::vector<std::string>{});
  if (result.status == 127 || result.err.find("setpriv") == 0) GTEST_SKIP() << result.err;
  EXPECT_EQ(result.status, 1);
  EXPECT_NE(result.err.find("join the group slam-gateway"), std::string::npos) << result.err;
}

TEST_F(ControlProgramIo, RejectsAnswerOfAnotherProgram) {
  boost::asio::local::stream_protocol::acceptor other(
      io, boost::asio::local::stream_protocol::endpoint(path));
  boost::asio::local::stream_protocol::socket peer(io);
  other.async_accept(peer, [&](boost::system::error_code) {
    peer.write_some(boost::asio::buffer(std::string("220 hello\n")));
  });
  const Ended result = run({"status"});
  EXPECT_EQ(result.status, 1);
  EXPECT_NE(result.err.find("does not answer like slam-gatewayd"), std::string::npos) << result.err;
}

/// Binds a UDP socket to a free port of the loopback address.
boost::asio::ip::udp::socket take_port(boost::asio::io_context& io, const char* address) {
  return {io, boost::asio::ip::udp::endpoint(boost::asio::ip::make_address(address), 0)};
}

TEST_F(ControlProgramIo, DoctorChecksPortAtListenAddressOnly) {
  const auto other = take_port(io, "127.0.0.2");
  const std::string port = std::to_string(other.local_endpoint().port());
  const auto doctor_for = [&](const std::string& listen) {
    write_file(directory / "gateway.json",
               R"({"mqttsn": {"listen": [")" + listen + ":" + port + R"("]}})");
    return run({"doctor", "--config", directory / "gateway.json"}).out;
  };
  const std::string finding = "thread: port: another program has UDP port " + port;
  EXPECT_EQ(doctor_for("127.0.0.1").find(finding), std::string::npos);
  EXPECT_EQ(doctor_for("[::1]").find(finding), std::string::npos);
  EXPECT_NE(doctor_for("127.0.0.2").find(finding), std::string::npos);
  EXPECT_NE(doctor_for("0.0.0.0").find(finding), std::string::npos);
}

TEST_F(ControlProgramIo, DoctorReadsConfigurationThatDaemonUses) {
  start();
  write_file(directory / "other.json", R"({"no_such_key": 1})");
  handler.status_answer["configuration"] = directory / "other.json";
  const Ended result = run({"doctor"});
  EXPECT_NE(result.out.find(directory / "other.json:1: no_such_key"), std::string::npos)
      << result.out;
  handler.status_answer.erase("configuration");
  EXPECT_NE(run({"doctor"}).err.find("name it with --config"), std::string::npos);
}

TEST_F(ControlProgramIo, DoctorChecksNoFileThatItsUserMayNotRead) {
  const std::string keys = directory / "keys.json";
  write_file(directory / "g.json",
             R"({"mqttsn": {"dtls": {"listen": ["[::1]:47194"], "keys_file": "keys.json"}}})");
  write_file(keys, "{}");
  chmod(keys.c_str(), 0);
  chmod(directory.path().c_str(), 0755);
  const std::vector<std::string> as_nobody = {"setpriv", "--reuid=65534", "--regid=65534",
                                              "--clear-groups"};
  const Ended result = run({"doctor", "--config", directory / "g.json"},
                           geteuid() == 0 ? as_nobody : std::vector<std::string>{});
  if (result.status == 127 || result.err.find("setpriv") == 0) GTEST_SKIP() << result.err;
  EXPECT_EQ(result.out.find("keys.json cannot be read"), std::string::npos) << result.out;
  EXPECT_NE(result.out.find("unknown  configuration: mqttsn.dtls.keys_file is not checked: you may "
                            "not read its file\n         -> type the command with sudo\n"),
            std::string::npos)
      << result.out;
}

TEST_F(ControlProgramIo, RestoresNothingWhileDaemonRuns) {
  const std::string configuration = directory / "g.json";
  const std::string archive = directory / "backup.tar.gz";
  write_file(configuration,
             json{{"control", {{"socket", path}}}, {"store", {{"directory", directory / "state"}}}}
                 .dump());
  ASSERT_EQ(run({"backup", archive, "--config", configuration}).status, 0);
  start();
  handler.status_answer["configuration"] = configuration;
  const Ended refused = run({"restore", "--yes", archive, "--config", configuration});
  EXPECT_EQ(refused.status, 1) << refused.out;
  EXPECT_NE(refused.err.find("stop slam-gatewayd first"), std::string::npos) << refused.err;
  handler.status_answer["configuration"] = directory / "another.json";
  const Ended restored = run({"restore", "--yes", archive, "--config", configuration});
  EXPECT_EQ(restored.status, 0) << restored.err;
  EXPECT_NE(restored.out.find("Restored; start slam-gatewayd now.\n"), std::string::npos);
  EXPECT_EQ(restored.out.find("service"), std::string::npos) << restored.out;
}

TEST_F(ControlProgramIo, FailsToForgetUnknownName) {
  start();
  EXPECT_EQ(run({"forget", "old"}).out, "old is forgotten\n");
  const Ended result = run({"forget", "odl"});
  EXPECT_EQ(result.status, 1);
  EXPECT_EQ(result.out.find("no robot called odl is known here"), 0u) << result.out;
}

TEST_F(ControlProgramIo, BreaksLinesOfATerminalBetweenWords) {
  start();
  handler.status_answer = {{"meshes", {{"ble", {{"state", "down"}, {"detail", std::string()}}}}}};
  auto& detail = handler.status_answer["meshes"]["ble"]["detail"];
  std::string words;
  for (int i = 0; i < 30; ++i) words += "word" + std::to_string(i) + " ";
  detail = words;
  const int terminal = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
  ASSERT_TRUE(terminal >= 0 && grantpt(terminal) == 0 && unlockpt(terminal) == 0);
  ChildProcess child({"env", "NO_COLOR=1", SLAMGW_CTL, "--socket", path, "status"},
                     ptsname(terminal));
  EXPECT_TRUE(wait_until([&] { return !child.is_running(); }));
  char shown[4096];
  const ssize_t size = read(terminal, shown, sizeof shown);
  std::istringstream lines(
      std::string(shown, static_cast<std::size_t>(std::max<ssize_t>(size, 0))));
  std::size_t count = 0;
  for (std::string line; std::getline(lines, line, '\r'); ++count)
    EXPECT_LE(line.size(), 81U) << line;
  EXPECT_GT(count, 6u) << "status has six lines when no line is broken";
  close(terminal);
}

TEST_F(ControlProgramIo, ReloadNamesSettingsThatNeedRestart) {
  start();
  handler.reload_answer = {R"({"in_force": "log, robots", "needs_restart": "store.*"})", {}};
  Ended result = run({"reload"});
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(result.out, "applied: log, robots\nonly a restart changes: store.*\n");
  handler.reload_answer = {{}, "g.json:2: log.level: \"loud\" is not allowed"};
  result = run({"reload"});
  EXPECT_EQ(result.status, 1);
  EXPECT_NE(result.err.find("g.json:2: log.level"), std::string::npos);
}

TEST_F(ControlProgramIo, BanRecognizesRobotsOfOtherGateways) {
  start();
  const std::string configuration = directory / "g.json";
  std::ofstream(configuration) << "{}";
  chmod(configuration.c_str(), 0644);
  handler.fleet_answer["robots"] = json::parse(R"([{"robot": "r1", "gateway": "room-b"}])");
  const auto is_unknown = [&](const std::string& robot) {
    const Ended result = run({"ban", robot, "--config", configuration});
    EXPECT_EQ(result.status, 0) << result.err;
    return result.out.find("No robot of this name is known") != std::string::npos;
  };
  EXPECT_FALSE(is_unknown("r1"));
  EXPECT_TRUE(is_unknown("r2"));
}

TEST_F(ControlProgramIo, BanSaysThatItIsWrittenWhenTheDaemonDoesNotReload) {
  start();
  const std::string configuration = directory / "g.json";
  std::ofstream(configuration) << "{}";
  chmod(configuration.c_str(), 0644);
  handler.reload_answer = {{}, "no time now"};
  const Ended result = run({"ban", "r1", "--config", configuration});
  EXPECT_EQ(result.status, 1);
  EXPECT_EQ(result.err,
            "slam-gatewayctl: the change is written, but takes effect only after slam-gatewayctl "
            "reload: no time now\n");
}

}  // namespace
}  // namespace slamgw::test
