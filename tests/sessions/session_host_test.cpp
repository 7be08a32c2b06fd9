// SPDX-License-Identifier: Apache-2.0
// Gateways' sessions at a real Mosquitto.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/socket.h>

#include <algorithm>
#include <atomic>
#include <boost/asio/post.hpp>
#include <filesystem>

#include "daemon/sessions/io/session_host.hpp"
#include "daemon/sessions/session_names.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/fake_broker.hpp"
#include "tests/support/mosquitto.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::sessions {
namespace {

using test::eventually;

class Host {
 public:
  explicit Host(boost::asio::io_context& io)
      : host(
            io, SessionNames(TopicScheme("p", "g")), [](const std::string&) { return false; },
            read_clocks().mono,
            [this](SessionHost::Report report) {
              std::visit([this](auto& what) { take(what); }, report);
            }) {}

  void up(std::uint16_t port, MqttVersion version, bool is_other = false) {
    BrokerSettings settings;
    settings.port = port;
    settings.keep_alive = std::chrono::seconds{5};
    up(settings, version, is_other);
  }
  void up(const BrokerSettings& settings, MqttVersion version, bool is_other = false) {
    host.on_broker_up({settings, find_broker(settings), version}, is_other);
  }
  void hear(const std::string& robot) { host->on_heard(robot, read_clocks()); }
  void subscribe(const std::string& robot, const std::string& filter, bool is_standing = false) {
    host->subscribe(robot, filter, Qos::at_least_once, is_standing, read_clocks());
  }

  std::vector<SessionHeld> held;
  std::vector<SessionLost> lost;
  std::vector<FilterAnswered> answered;
  std::vector<TakeMessage> taken;
  std::vector<RefuseStale> stale;
  std::vector<NoteRead> notes;
  std::vector<std::string> notices;
  SessionHost host;

 private:
  void take(SessionHeld& what) { held.push_back(what); }
  void take(SessionLost& what) { lost.push_back(what); }
  void take(FilterAnswered& what) { answered.push_back(what); }
  void take(TakeMessage& what) { taken.push_back(what); }
  void take(NoteRead& what) { notes.push_back(what); }
  void take(SessionProven&) {}
  void take(SessionSorted&) {}
  void take(RefuseStale& what) { stale.push_back(what); }
  void take(SessionContested&) {}
  void take(Notice& notice) { notices.push_back(notice.text); }
};

class SessionHosts : public testing::TestWithParam<MqttVersion> {
 protected:
  /// Tests that expect a notice remove it.
  void TearDown() override {
    EXPECT_EQ(a.notices, std::vector<std::string>{});
    EXPECT_EQ(b.notices, std::vector<std::string>{});
  }
  void publish(const std::string& topic, const std::string& payload, bool is_retained = false) {
    std::vector<std::string> arguments{"-t", topic, "-m", payload, "-q", "1"};
    if (is_retained) arguments.emplace_back("-r");
    test::mosquitto_publish(broker, arguments);
  }
  void publish_octets(const std::string& topic, const Bytes& payload) {
    const test::TempDir directory;
    test::write_file(directory / "payload", as_text(payload));
    test::mosquitto_publish(broker, {"-t", topic, "-f", directory / "payload", "-q", "1"});
  }
  /// Connects the gateway and lets it take this robot's session.
  void hold(Host& gateway, const std::string& robot) {
    gateway.up(broker.port(), GetParam());
    gateway.hear(robot);
    ASSERT_TRUE(eventually(io, [&] { return gateway.host.sessions().is_held(robot); }));
  }
  /// Lets the gateway take the session of r1 with this filter.
  void serve(Host& gateway, const std::string& filter) {
    hold(gateway, "r1");
    gateway.subscribe("r1", filter);
    ASSERT_TRUE(eventually(io, [&] { return gateway.answered.size() == 1; }));
    EXPECT_TRUE(gateway.answered[0].is_granted);
  }
  bool is_v5() const { return GetParam() == MqttVersion::v5; }

  boost::asio::io_context io{1};
  test::Mosquitto broker;
  Host a{io};
  Host b{io};
};

TEST_P(SessionHosts, GatewayThatHoldsTheRobotsSessionGetsItsCommands) {
  serve(a, "p/server/r1/+");
  publish("p/server/r1/run", "1");
  ASSERT_TRUE(eventually(io, [&] { return a.taken.size() == 1; }));
  EXPECT_EQ(as_text(a.taken[0].message.payload), "1");
  EXPECT_FALSE(a.taken[0].is_unasked);

  b.up(broker.port(), GetParam());
  b.hear("r1");
  ASSERT_TRUE(eventually(io, [&] { return b.held.size() == 1 && a.lost.size() == 1; }));
  EXPECT_TRUE(b.held[0].was_present);
  EXPECT_EQ(a.lost[0].why, LossReason::taken);
  publish("p/server/r1/run", "0");
  ASSERT_TRUE(eventually(io, [&] { return b.taken.size() == 1; }));
  EXPECT_EQ(a.taken.size(), 1U);
  EXPECT_EQ(b.host.sessions().held(), 1U);
}

TEST_P(SessionHosts, CommandsWaitAtTheBrokerWhileNoGatewayHoldsTheSession) {
  serve(a, "p/server/r1/+");
  a.host.stop();
  publish("p/server/r1/run", "1");
  b.up(broker.port(), GetParam());
  b.hear("r1");
  ASSERT_TRUE(eventually(io, [&] { return b.taken.size() == 1; }));
  EXPECT_EQ(as_text(b.taken[0].message.payload), "1");
}

/// Mosquitto 2.0 sends more messages of QoS 2 at once than the client allows.
TEST_P(SessionHosts, ReceiveHundredsOfQos2CommandsEvenAfterTheyWaited) {
  const auto publish_many = [&] {
    test::mosquitto_publish(broker,
                            {"-t", "p/server/r1/run", "-m", "1", "-q", "2", "--repeat", "300"});
  };
  hold(a, "r1");
  a.host->subscribe("r1", "p/server/r1/+", Qos::exactly_once, /*is_standing=*/false, read_clocks());
  ASSERT_TRUE(eventually(io, [&] { return a.answered.size() == 1; }));
  publish_many();
  EXPECT_TRUE(eventually(io, [&] { return a.taken.size() == 300; })) << a.taken.size();
  a.host.stop();
  publish_many();
  b.up(broker.port(), GetParam());
  b.hear("r1");
  EXPECT_TRUE(eventually(io, [&] { return b.taken.size() == 300; })) << b.taken.size();
  EXPECT_TRUE(a.lost.empty() && b.lost.empty());
}

TEST_P(SessionHosts, RefuseWaitingCommandsWhereTheFormerProcessUsedAnotherBroker) {
  serve(a, "p/server/r1/+");
  a.host.stop();
  publish("p/server/r1/run", "1");
  Host next(io);
  next.up(broker.port(), GetParam(), /*is_other=*/true);
  next.hear("r1");
  ASSERT_TRUE(eventually(io, [&] { return next.stale.size() == 1; }));
  EXPECT_TRUE(next.taken.empty());
}

/// A proxy in front of a broker that is away can make the gateway try MQTT 3.1.1.
TEST_P(SessionHosts, TakeWaitingCommandsWhenOnlyTheVersionOfMqttIsAnother) {
  serve(a, "p/server/r1/+");
  a.host.on_broker_down();
  publish("p/server/r1/run", "1");
  a.up(broker.port(), GetParam() == MqttVersion::v5 ? MqttVersion::v3_1_1 : MqttVersion::v5);
  a.hear("r1");
  ASSERT_TRUE(eventually(io, [&] { return a.taken.size() + a.stale.size() == 1; }));
  EXPECT_TRUE(a.stale.empty());
}

TEST_P(SessionHosts, ReopenAllSessionsWhenTheBrokerIsBack) {
  a.up(broker.port(), GetParam());
  for (int i = 0; i < 20; ++i) a.hear("r" + std::to_string(i));
  ASSERT_TRUE(eventually(io, [&] { return a.held.size() == 20; }));
  broker.kill();
  a.host.on_broker_down();
  EXPECT_EQ(a.lost.size(), 20U);
  for (int i = 0; i < 20; ++i) a.hear("r" + std::to_string(i));
  broker.start();
  a.up(broker.port(), GetParam());
  ASSERT_TRUE(eventually(io, [&] { return a.held.size() == 40; }));
}

TEST_P(SessionHosts, TakeOneCopyForOverlappingFiltersAndMarkUnaskedCommands) {
  serve(a, "p/server/r1/run");
  a.subscribe("r1", "p/server/+/run");
  ASSERT_TRUE(eventually(io, [&] { return a.answered.size() == 2; }));
  publish("p/server/r1/run", "1");
  publish("p/server/r1/other", "2");
  publish("p/server/r1/run", "3");
  const std::size_t expected = is_v5() ? 3 : 2;
  ASSERT_TRUE(eventually(io, [&] { return a.taken.size() >= expected; }));
  std::vector<std::pair<std::string, bool>> taken;
  for (const auto& each : a.taken)
    taken.emplace_back(as_text(each.message.payload), each.is_unasked);
  if (is_v5())
    EXPECT_EQ(taken,
              (std::vector<std::pair<std::string, bool>>{{"1", false}, {"2", true}, {"3", false}}));
  else
    EXPECT_EQ(taken, (std::vector<std::pair<std::string, bool>>{{"1", false}, {"3", false}}));
}

TEST_P(SessionHosts, DeliverRetainedMessagesAtEachSubscribeOfTheRobot) {
  publish("p/server/r1/mode", "auto", /*is_retained=*/true);
  serve(a, "p/server/r1/+");
  ASSERT_TRUE(eventually(io, [&] { return a.taken.size() == 1; }));
  EXPECT_TRUE(a.taken[0].message.retain);
  a.subscribe("r1", "p/server/r1/+");
  ASSERT_TRUE(eventually(io, [&] { return a.taken.size() == 2; }));
  b.up(broker.port(), GetParam());
  b.subscribe("r1", "p/server/r1/+", /*is_standing=*/true);
  b.hear("r1");
  ASSERT_TRUE(eventually(io, [&] { return b.held.size() == 1; }));
  publish("p/server/r1/run", "1");
  ASSERT_TRUE(eventually(io, [&] { return !b.taken.empty(); }));
  EXPECT_FALSE(b.taken[0].message.retain) << "the robot has not asked there";
}

TEST_P(SessionHosts, Rule9_ReadTheNoteWithTheSession) {
  publish("p/fleet/robots/r1", "a note", /*is_retained=*/true);
  serve(a, "p/server/r1/+");
  hold(b, "another");
  b.host->read_note(std::string("r1"), read_clocks());
  ASSERT_TRUE(eventually(io, [&] { return b.notes.size() == 1; }));
  EXPECT_EQ(b.notes[0].note, to_bytes("a note"));
  EXPECT_TRUE(b.host.sessions().is_held("r1"));
  test::mosquitto_publish(broker, {"-t", "p/fleet/robots/r1", "-n", "-r", "-q", "1"});
  b.host->read_note(std::string("r1"), read_clocks());
  ASSERT_TRUE(eventually(io, [&] { return b.notes.size() == 2; }));
  EXPECT_EQ(b.notes[1].note, Bytes{});
}

TEST_P(SessionHosts, Rule4_HolderOfTheSessionGetsMessagesOfTheMailbox) {
  serve(a, "p/server/r1/+");
  WaitingMessage waiting{{"p/server/r1/run", to_bytes("1"), Qos::at_least_once, false}};
  waiting.message.waited = Waited{3000};
  publish_octets("p/fleet/robots/r1/waiting", encode_waiting(waiting));
  ASSERT_TRUE(eventually(io, [&] { return a.taken.size() == 1; }));
  EXPECT_EQ(a.taken[0].message.topic, "p/server/r1/run");
  EXPECT_GE(a.taken[0].message.waited, Waited{3000});
}

TEST_P(SessionHosts, EndTheSessionOfAForgottenRobotThatIsHeldOrNot) {
  serve(a, "p/server/r1/+");
  a.host->forget(std::string("r1"));
  // The end of the session may reach the broker after another gateway's CONNECT.
  const auto finds_none = [&](Host& gateway) {
    return eventually(io, [&] {
      gateway.hear("r1");
      return std::ranges::any_of(gateway.held, [](const SessionHeld& each) {
        return each.robot == "r1" && !each.was_present;
      });
    });
  };
  b.up(broker.port(), GetParam());
  ASSERT_TRUE(finds_none(b));
  b.host.stop();
  // On MQTT 5 a client that connects between clean start and end finds the new, empty session.
  if (is_v5()) return;
  a.host->forget(std::string("r1"));
  Host c{io};
  c.up(broker.port(), GetParam());
  EXPECT_TRUE(finds_none(c));
}

TEST_P(SessionHosts, KeepQuietSessionsAliveByPings) {
  const test::TempDir directory;
  test::Mosquitto talkative("log_type all\nlog_dest file " + directory / "log" + "\n");
  BrokerSettings settings;
  settings.port = talkative.port();
  settings.keep_alive = std::chrono::seconds{8};  // not every link ticks each second
  a.up(settings, GetParam());
  const std::vector<std::string> robots{"r1", "r2", "r3"};
  for (const std::string& robot : robots) a.hear(robot);
  const auto has_two_pings = [&](const std::string& robot) {
    const std::string log = test::read_file(directory / "log");
    const std::string ping = "Received PINGREQ from p-robot-" + robot;
    const auto first = log.find(ping);
    return first != std::string::npos && log.find(ping, first + 1) != std::string::npos;
  };
  ASSERT_TRUE(eventually(
      io, [&] { return std::ranges::all_of(robots, has_two_pings); }, std::chrono::minutes{1}));
  EXPECT_EQ(a.host.sessions().held(), 3U);
  EXPECT_TRUE(a.lost.empty());
}

TEST_P(SessionHosts, BrokerThatStandsStillDoesNotBlockTheLoop) {
  serve(a, "p/server/r1/+");
  broker.pause();
  for (int i = 0; i < 50; ++i) a.subscribe("n" + std::to_string(i), "p/server/x/+");
  a.subscribe("r1", "p/robot/+/update");
  bool has_passed = false;
  boost::asio::post(io, [&] { has_passed = true; });
  ASSERT_TRUE(eventually(io, [&] { return has_passed; }));
  a.host->on_silence(true);
  EXPECT_EQ(a.answered.size(), 52U) << "the gateway answers for the silent broker";
  broker.resume();
  ASSERT_TRUE(eventually(io, [&] { return a.host.sessions().held() == 51; }));
}

INSTANTIATE_TEST_SUITE_P(Over, SessionHosts, testing::Values(MqttVersion::v5, MqttVersion::v3_1_1),
                         [](const auto& version) {
                           return version.param == MqttVersion::v5 ? "Mqtt5" : "Mqtt311";
                         });

// --- Notices for operators, and cost -------------------------------------------------------------

class OneSessionHost : public testing::Test {
 protected:
  boost::asio::io_context io{1};
  Host a{io};
};

TEST_F(OneSessionHost, NamesTheClientIdsThatTheBrokerRefuses) {
  test::Mosquitto broker({}, "operator", "secret");
  a.up(broker.port(), MqttVersion::v5);
  for (int i = 0; i < 20; ++i) a.hear("r" + std::to_string(i));
  ASSERT_TRUE(eventually(io, [&] { return !a.notices.empty(); }));
  EXPECT_NE(a.notices[0].find("client ids p-robot-*"), std::string::npos) << a.notices[0];
  EXPECT_EQ(a.notices.size(), 1U);
}

TEST_F(OneSessionHost, LeavesDescriptorsToTheRestOfTheDaemon) {
  test::Mosquitto broker;
  a.up(broker.port(), MqttVersion::v5);
  rlimit before{};
  getrlimit(RLIMIT_NOFILE, &before);
  const auto open = std::distance(std::filesystem::directory_iterator("/proc/self/fd"), {});
  const rlimit few{static_cast<rlim_t>(open) + 340, before.rlim_max};
  setrlimit(RLIMIT_NOFILE, &few);
  for (int robot = 0; robot < 100; ++robot) a.hear("r" + std::to_string(robot));
  const auto left = [] {
    std::vector<int> free;
    for (int one = dup(0); one >= 0; one = dup(0)) free.push_back(one);
    for (const int one : free) close(one);
    return free.size();
  };
  const bool is_noticed = eventually(io, [&] { return !a.notices.empty(); });
  // Connections that begin or end need more for a moment.
  const bool is_left = eventually(io, [&] { return left() >= 30; });
  setrlimit(RLIMIT_NOFILE, &before);
  EXPECT_TRUE(is_noticed);
  EXPECT_TRUE(is_left);
}

TEST_F(OneSessionHost, NamesTheLimitOfOpenFiles) {
  test::Mosquitto broker;
  a.up(broker.port(), MqttVersion::v5);
  a.hear("r1");
  ASSERT_TRUE(eventually(io, [&] { return a.held.size() == 1; }));
  rlimit before{};
  getrlimit(RLIMIT_NOFILE, &before);
  const auto open = std::distance(std::filesystem::directory_iterator("/proc/self/fd"), {});
  const rlimit few{static_cast<rlim_t>(open), before.rlim_max};
  setrlimit(RLIMIT_NOFILE, &few);
  a.hear("r2");
  const bool is_noticed = eventually(io, [&] { return !a.notices.empty(); });
  setrlimit(RLIMIT_NOFILE, &before);
  ASSERT_TRUE(is_noticed);
  EXPECT_NE(a.notices[0].find("RLIMIT_NOFILE"), std::string::npos) << a.notices[0];
  EXPECT_TRUE(eventually(io, [&] { return a.held.size() == 2; }));
}

TEST_F(OneSessionHost, LeavesNoDescriptorOpenAcrossExecAndNoLargeBuffer) {
  const auto descriptors = [] {
    std::vector<int> all;
    for (const auto& each : std::filesystem::directory_iterator("/proc/self/fd"))
      all.push_back(std::stoi(each.path().filename()));
    std::erase_if(all, [](int each) { return fcntl(each, F_GETFD) < 0; });  // of the listing
    std::ranges::sort(all);
    return all;
  };
  test::Mosquitto broker;
  a.up(broker.port(), MqttVersion::v5);
  bool is_ready = false;
  ASSERT_TRUE(eventually(io, [&] {
    if (!is_ready) a.hear("r0");
    is_ready = a.host.sessions().held() == 1;
    return is_ready;
  }));
  const std::vector<int> before = descriptors();
  for (int i = 1; i <= 10; ++i) a.hear("r" + std::to_string(i));
  ASSERT_TRUE(eventually(io, [&] { return a.host.sessions().held() == 11; }));
  std::vector<int> added;
  std::ranges::set_difference(descriptors(), before, std::back_inserter(added));
  int pairs = 0;
  for (const int each : added) {
    EXPECT_NE(fcntl(each, F_GETFD) & FD_CLOEXEC, 0) << each;
    int domain = 0;
    int room = 0;
    socklen_t size = sizeof domain;
    getsockopt(each, SOL_SOCKET, SO_DOMAIN, &domain, &size);
    getsockopt(each, SOL_SOCKET, SO_SNDBUF, &room, &size);
    if (domain != AF_UNIX) continue;
    ++pairs;
    EXPECT_LT(room, 10'000) << "each octet in it costs the kernel 768";
  }
  EXPECT_EQ(pairs, 20);
}

/// A broker may send one copy of a message with the identifiers of all subscriptions (MQTT 5
/// section 3.3.4). libmosquitto ends the connection then.
TEST_F(OneSessionHost, UsesMqtt311WhereAMessageHasSeveralSubscriptionIdentifiers) {
  test::FakeBroker broker;
  broker.misbehave([](test::FakeBroker::Connection& connection, const auto& packet) {
    if (packet.type() != test::FakeBroker::subscribe || !packet.contains("p/server/r1/+"))
      return false;
    std::vector<std::uint8_t> command{0, 15};
    for (const char each : std::string("p/server/r1/run")) command.push_back(each);
    command.insert(command.end(), {0, 9});
    if (connection.is_v5()) command.insert(command.end(), {4, 0x0b, 1, 0x0b, 3});
    command.push_back('1');
    connection.send(0x32, command);
    return false;
  });
  a.up(broker.port(), MqttVersion::v5);
  a.hear("r1");
  ASSERT_TRUE(eventually(io, [&] { return a.held.size() == 1; }));
  a.subscribe("r1", "p/server/r1/+");
  ASSERT_TRUE(eventually(io, [&] { return !a.taken.empty(); }));
  EXPECT_EQ(as_text(a.taken[0].message.payload), "1");
  ASSERT_EQ(a.notices.size(), 1U);
  EXPECT_NE(a.notices[0].find("MQTT 3.1.1"), std::string::npos) << a.notices[0];
}

TEST_F(OneSessionHost, KeepsToTheBrokersLimitsOfSubscriptions) {
  constexpr std::uint8_t no_wildcards = 0x28, no_identifiers = 0x29;
  for (const std::uint8_t limit : {no_wildcards, no_identifiers}) {
    test::FakeBroker broker;
    std::atomic<bool> is_v3{false};
    broker.misbehave([&](test::FakeBroker::Connection& connection, const auto& packet) {
      if (packet.type() != test::FakeBroker::connect) return false;
      is_v3 = !connection.is_v5();
      if (is_v3) return false;
      connection.send(0x20, {0, 0, 2, limit, 0});
      return true;
    });
    a.notices.clear();
    a.up(broker.port(), MqttVersion::v5, /*is_other=*/true);
    a.hear("r1");
    ASSERT_TRUE(eventually(io, [&] { return !a.notices.empty(); }));
    if (limit == no_wildcards) {
      EXPECT_NE(a.notices[0].find("wildcards"), std::string::npos) << a.notices[0];
      EXPECT_FALSE(a.host.sessions().is_held("r1"));
    } else {
      EXPECT_TRUE(eventually(io, [&] { return a.host.sessions().is_held("r1"); }));
      EXPECT_TRUE(is_v3);
    }
    a.host.on_broker_down();
  }
}

/// The marker, which tells old commands from new ones, goes to the broker as a PUBLISH.
TEST_F(OneSessionHost, HoldsASessionThatItFindsAtABrokerWithoutQos1) {
  test::Mosquitto broker("max_qos 0");
  a.up(broker.port(), MqttVersion::v5);
  a.hear("r1");
  a.subscribe("r1", "p/server/r1/+");
  ASSERT_TRUE(eventually(io, [&] { return a.answered.size() == 1; }));
  a.host.stop();
  Host next(io);
  next.up(broker.port(), MqttVersion::v5, /*is_other=*/true);
  next.host->begin_clean(std::string("r1"), read_clocks());
  next.subscribe("r1", "p/server/r1/run");
  ASSERT_TRUE(eventually(io, [&] { return !next.held.empty(); }));
  ASSERT_TRUE(eventually(io, [&] { return next.answered.size() == 1; }));
  EXPECT_TRUE(next.answered[0].is_granted);
  test::mosquitto_publish(broker, {"-t", "p/server/r1/run", "-m", "1"});
  ASSERT_TRUE(eventually(io, [&] { return !next.taken.empty(); }));
  EXPECT_TRUE(next.lost.empty());
}

TEST_F(OneSessionHost, RefusesAFilterThatExceedsTheBrokersLargestPacket) {
  test::Mosquitto broker("max_packet_size 200");
  a.up(broker.port(), MqttVersion::v5);
  a.hear("r1");
  ASSERT_TRUE(eventually(io, [&] { return a.held.size() == 1; }));
  a.subscribe("r1", "p/server/r1/" + std::string(200, 'x'));
  a.subscribe("r1", "p/server/r1/+");
  ASSERT_TRUE(eventually(io, [&] { return a.answered.size() == 2; }));
  for (const FilterAnswered& each : a.answered)
    EXPECT_EQ(each.is_granted, each.filter == "p/server/r1/+") << each.filter;
  ASSERT_FALSE(a.notices.empty());
  EXPECT_NE(a.notices[0].find("largest packet"), std::string::npos) << a.notices[0];
  a.host->unsubscribe(std::string("r1"), "p/server/r1/" + std::string(200, 'x'));
  test::mosquitto_publish(broker, {"-t", "p/server/r1/run", "-m", "1", "-q", "1"});
  ASSERT_TRUE(eventually(io, [&] { return !a.taken.empty(); }));
  EXPECT_TRUE(a.lost.empty());
}

TEST_F(OneSessionHost, FollowsABrokerToItsNewAddress) {
  test::Mosquitto broker;
  BrokerSettings settings;
  settings.port = broker.port();
  a.host.on_broker_up({settings, {.addresses = {"127.0.0.2"}}}, /*is_other=*/false);
  a.hear("r1");
  ASSERT_TRUE(eventually(io, [&] { return !a.notices.empty(); })) << "no broker listens there";
  EXPECT_FALSE(a.host.sessions().is_refused("r1"));
  a.host.on_broker_down();
  a.up(settings, MqttVersion::v5);
  EXPECT_TRUE(eventually(io, [&] { return a.host.sessions().is_held("r1"); }));
}

}  // namespace
}  // namespace slamgw::sessions
