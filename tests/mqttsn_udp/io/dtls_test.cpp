// SPDX-License-Identifier: Apache-2.0
// DTLS with real UDP on loopback: identities, bad networks, attackers, and sessions that outlive
// their connections.
#include <gtest/gtest.h>
#include <malloc.h>

#include <cstdlib>
#include <fstream>
#include <list>

#include "adapters/mqttsn_udp/limits.hpp"
#include "tests/mqttsn_udp/io/dtls_client.hpp"

namespace slamgw::mqttsn {
namespace {

const Bytes key_of_r1(16, 0x11);
const Bytes key_of_r2(32, 0x22);
const RobotKeys both{{"r1", key_of_r1}, {"r2", key_of_r2}};
constexpr const char* suites[] = {"PSK-AES128-GCM-SHA256", "PSK-AES128-CCM8", "PSK-AES128-CCM",
                                  "ECDHE-PSK-CHACHA20-POLY1305", "ECDHE-PSK-AES128-CBC-SHA256"};
const std::uint16_t adv = topic_id_of("ntnu-slam/robot/r1/adv");

struct DtlsRig : UdpRig {
  explicit DtlsRig(RobotKeys keys = both, RequireIdentity required = RequireIdentity::with_key)
      : UdpRig(settings(required), AsIs{}, nullptr, std::move(keys)) {}
  static Settings settings(RequireIdentity required) {
    Settings settings;
    settings.dtls.listen = {"0.0.0.0:0"};
    settings.dtls.keys_file = "keys";
    settings.require_identity = required;
    return with(settings, {"127.0.0.1:0"});
  }
  std::uint64_t counter(std::string_view name) const {
    for (const auto& counter : adapter.counters())
      if (counter.name == name) return counter.value;
    ADD_FAILURE() << "no counter " << name;
    return 0;
  }
  void use_keys(const RobotKeys& keys) {
    adapter.reconfigure(TopicPolicy(TopicScheme("ntnu-slam", "gw"), {}, {"ab"}), RobotNames(),
                        keys);
  }
  bool has_notice(const std::string& text) const {
    return std::ranges::any_of(core.notices, [&](const Notice& notice) {
      return notice.text.find(text) != std::string::npos;
    });
  }
};

Connect connect_as(const std::string& id, bool clean = false) {
  return Connect{false, clean, protocol_id, 60, id};
}

Publish publish_of_r1(std::uint16_t msg_id, const std::string& payload = "x") {
  return {false, WireQos::one, false, TopicIdType::normal, adv, msg_id, to_bytes(payload)};
}

const std::string puback = "PUBACK id=" + std::to_string(adv);

void join(DtlsClient& robot) {
  ASSERT_TRUE(robot.has_connection());
  ASSERT_EQ(robot.insist(connect_as("r1")), "CONNACK code=0");
  const std::string answer = robot.insist(Register{0, 1, "ntnu-slam/robot/r1/adv"});
  ASSERT_TRUE(answer.starts_with("REGACK") || answer.starts_with("CONNACK")) << answer;
}

TEST(Dtls, CarriesARobotsMessageUpAndACommandDown) {
  DtlsRig rig;
  DtlsClient robot(rig, "r1", key_of_r1);
  join(robot);
  robot.send(publish_of_r1(3));
  EXPECT_EQ(robot.receive(), puback + " msg=3 code=0");
  ASSERT_EQ(rig.core.reports.size(), 1U);
  EXPECT_EQ(rig.core.reports[0].robot, "r1");
  Subscribe subscribe;
  subscribe.msg_id = 2;
  subscribe.topic_name = "ntnu-slam/server/r1/cmd";
  robot.send(subscribe);
  EXPECT_TRUE(robot.receive().starts_with("SUBACK"));
  const std::string longest(900, 'y');
  rig.adapter.on_broker_message(
      {"r1", {"ntnu-slam/server/r1/cmd", to_bytes(longest), Qos{}, false}, CommandId{1}});
  EXPECT_TRUE(robot.receive().starts_with("PUBLISH"));
  EXPECT_GT(robot.longest_received, longest.size());
  EXPECT_LE(robot.longest_received, limits::max_dtls_record_octets);
  EXPECT_EQ(rig.counter("dtls_connections"), 1U);
}

TEST(Dtls, TakesTheSuitesOfSmallDevicesAndForwardSecrecy) {
  for (const char* suite : suites) {
    DtlsRig rig;
    DtlsClient robot(rig, "r2", key_of_r2, {}, suite);
    ASSERT_TRUE(robot.has_connection()) << suite;
    EXPECT_STREQ(robot.suite(), suite);
    EXPECT_EQ(robot.insist(connect_as("r2")), "CONNACK code=0");
  }
}

TEST(Dtls, RefusesAConnectUnderAnotherClientId) {
  DtlsRig rig;
  DtlsClient robot(rig, "r2", key_of_r2);
  ASSERT_TRUE(robot.has_connection());
  robot.send(connect_as("r1"));
  EXPECT_EQ(robot.receive(), "CONNACK code=3");
  EXPECT_TRUE(rig.has_notice("may not connect as 'r1' (CONNACK 0x03)"));
  EXPECT_EQ(rig.counter("connects_refused"), 1U);

  UdpClient plain(rig, "127.0.0.1");
  plain.send(connect_as("r1"));
  plain.send(connect_as("r3", true));
  EXPECT_EQ(plain.receive(), "CONNACK code=0") << "the first answer is r3's";
  EXPECT_TRUE(rig.has_notice("as 'r1' gets no answer: it must come over DTLS"));
}

TEST(Dtls, RefusesAnUnknownIdentityAndAWrongKey) {
  DtlsRig rig;
  DtlsClient stranger(rig, "r9", key_of_r1);
  EXPECT_FALSE(stranger.has_connection(std::chrono::milliseconds(500)));
  EXPECT_EQ(rig.counter("dtls_handshakes_failed"), 1U);
  EXPECT_TRUE(rig.has_notice("'r9' has no key (slam-gatewayctl key add)"));
  DtlsClient liar(rig, "r1", key_of_r2);
  EXPECT_FALSE(liar.has_connection(std::chrono::milliseconds(1500)));
  EXPECT_EQ(rig.counter("dtls_handshakes"), 0U);
  EXPECT_EQ(rig.counter("dtls_connections"), 0U);
  DtlsClient robot(rig, "r1", key_of_r1);
  join(robot);
}

TEST(Dtls, AnswersAHelloWithFewerOctetsAndKeepsNoState) {
  DtlsRig rig;
  DtlsClient robot(rig, "r1", key_of_r1);
  robot.step();
  ASSERT_EQ(robot.sent.size(), 1U);
  const Bytes hello = robot.sent[0];
  boost::asio::ip::udp::socket other(rig.io, boost::asio::ip::udp::v4());
  other.non_blocking(true);
  for (std::size_t length = 1; length <= hello.size(); ++length)
    other.send_to(boost::asio::buffer(hello.data(), length),
                  {boost::asio::ip::make_address("127.0.0.1"), rig.core.port(1)});
  Bytes buffer(2000);
  std::size_t size = 0;
  EXPECT_TRUE(test::eventually(rig.io, [&] {
    boost::system::error_code error;
    size = other.receive(boost::asio::buffer(buffer), 0, error);
    return !error;
  }));
  EXPECT_LT(size, hello.size());
  EXPECT_EQ(buffer[13], 3) << "HelloVerifyRequest";
  EXPECT_EQ(rig.counter("dtls_handshakes_failed"), 0U);
  EXPECT_TRUE(robot.has_connection());
}

class DtlsOnABadNetwork : public testing::TestWithParam<Network> {};

TEST_P(DtlsOnABadNetwork, ConnectsARobotAndForwardsEachMessageOnce) {
  DtlsRig rig;
  DtlsClient robot(rig, "r1", key_of_r1, GetParam());
  ASSERT_TRUE(robot.has_connection(std::chrono::seconds(60)));
  const auto insist = [&](const Packet& packet, const std::string& wanted) {
    for (int i = 0; i < 100; ++i)
      if (robot.insist(packet).starts_with(wanted)) return true;
    return false;
  };
  EXPECT_TRUE(insist(connect_as("r1"), "CONNACK code=0"));
  EXPECT_TRUE(insist(Register{0, 1, "ntnu-slam/robot/r1/adv"}, "REGACK"));
  for (std::uint16_t i = 2; i < 22; ++i) {
    Publish publish = publish_of_r1(i, std::to_string(i));
    robot.send(publish);
    publish.dup = true;
    const std::string wanted = puback + " msg=" + std::to_string(i) + " ";
    EXPECT_TRUE(robot.receive(std::chrono::milliseconds(300)).starts_with(wanted) ||
                insist(publish, wanted));
  }
  EXPECT_EQ(rig.core.reports.size(), 20U) << "each message once";
}

TEST(Dtls, RepeatsItsLastFlight) {
  DtlsRig rig;
  DtlsClient robot(rig, "r1", key_of_r1, Network{.packs = true, .loses_last_flight = true});
  EXPECT_TRUE(robot.has_connection(std::chrono::seconds(60)));
  EXPECT_GE(robot.last_flights, 2U);
}

INSTANTIATE_TEST_SUITE_P(Networks, DtlsOnABadNetwork,
                         testing::Values(Network{0.2, false, 1}, Network{0.2, true, 2},
                                         Network{0, true, 3}, Network{0.2, false, 4, true}));

TEST(Dtls, IgnoresReplayedRecords) {
  DtlsRig rig;
  DtlsClient robot(rig, "r1", key_of_r1);
  join(robot);
  Publish publish = publish_of_r1(0, "once");
  publish.qos = WireQos::zero;
  robot.send(publish);
  ASSERT_TRUE(test::eventually(rig.io, [&] { return rig.core.reports.size() == 1; }));
  for (int i = 0; i < 3; ++i) robot.replay();
  robot.send(publish_of_r1(9));
  EXPECT_EQ(robot.receive(), puback + " msg=9 code=0") << "the connection still works";
  EXPECT_EQ(rig.core.reports.size(), 2U);
}

TEST(Dtls, KeepsTheSessionOverANewConnection) {
  DtlsRig rig;
  DtlsClient robot(rig, "r1", key_of_r1);
  join(robot);
  robot.begin();  // a restart on the same port
  ASSERT_TRUE(robot.has_connection());
  robot.send(publish_of_r1(7, "same address"));
  EXPECT_EQ(robot.receive(), puback + " msg=7 code=0") << "without CONNECT and REGISTER";

  DtlsClient elsewhere(rig, "r1", key_of_r1);
  ASSERT_TRUE(elsewhere.has_connection());
  elsewhere.send(publish_of_r1(8, "another address"));
  EXPECT_EQ(elsewhere.receive(), puback + " msg=8 code=0");
  EXPECT_EQ(rig.counter("dtls_connections"), 1U) << "the newest connection replaces the older one";
  EXPECT_EQ(rig.counter("dtls_handshakes"), 3U);
}

TEST(Dtls, KeepsTheConnectionAfterAForgedHello) {
  DtlsRig rig;
  DtlsClient robot(rig, "r1", key_of_r1);
  join(robot);
  DtlsClient recorded(rig, "r1", key_of_r1);
  recorded.step();
  for (const Bytes& datagram : recorded.sent) robot.transmit(datagram);  // from the robot's port
  robot.send(publish_of_r1(5));
  EXPECT_EQ(robot.receive(), puback + " msg=5 code=0");
}

TEST(Dtls, KeepsTheConnectionDespiteForgedDatagrams) {
  DtlsRig rig;
  DtlsClient robot(rig, "r1", key_of_r1);
  join(robot);
  std::mt19937 random(7);
  for (int i = 0; i < 3000; ++i) {
    Bytes forged = robot.sent[random() % robot.sent.size()];
    for (unsigned flips = 1 + random() % 4; flips > 0; --flips)
      forged[random() % forged.size()] = static_cast<std::uint8_t>(random());
    if (random() % 4 == 0) forged.resize(1 + random() % forged.size());
    if (random() % 4 == 0) forged[0] = static_cast<std::uint8_t>(20 + random() % 4);
    if (random() % 4 == 0 && forged.size() > 4) forged[4] = static_cast<std::uint8_t>(random() % 3);
    robot.transmit(forged);  // from the robot's own port
    if (i % 50 == 0) rig.io.poll();
  }
  robot.send(publish_of_r1(5));
  EXPECT_EQ(robot.receive(), puback + " msg=5 code=0");
  EXPECT_EQ(rig.core.reports.size(), 1U);
}

/// OpenSSL 3.0 ends a connection at a record that is too short for the cipher.
TEST(Dtls, KeepsTheConnectionDespiteForgedRecordsOfAnyLength) {
  for (const char* suite : suites) {
    SCOPED_TRACE(suite);
    DtlsRig rig;
    DtlsClient robot(rig, "r2", key_of_r2, {}, suite);
    ASSERT_TRUE(robot.has_connection());
    ASSERT_EQ(robot.insist(connect_as("r2")), "CONNACK code=0");
    for (std::uint8_t length = 0; length < 100; ++length) {
      for (std::uint8_t type = 20; type <= 23; ++type) {
        // Type, version, epoch 1, a sequence number that the robot has not used, and the length.
        Bytes forged{type, 0xfe, 0xfd, 0, 1, 0, 0, 0, 0, 1, length, 0, length};
        forged.resize(forged.size() + length);
        robot.transmit(forged);
      }
      rig.io.poll();
    }
    robot.send(Pingreq{});
    EXPECT_EQ(robot.receive(), "PINGRESP");
    EXPECT_EQ(rig.counter("dtls_connections"), 1U);
  }
}

TEST(Dtls, EndsTheConnectionOfARemovedKeyAtOnce) {
  DtlsRig rig;
  DtlsClient robot(rig, "r1", key_of_r1);
  DtlsClient other(rig, "r2", key_of_r2);
  join(robot);
  ASSERT_TRUE(other.has_connection());
  EXPECT_EQ(other.insist(connect_as("r2")), "CONNACK code=0");
  rig.use_keys({{"r2", key_of_r2}});
  EXPECT_TRUE(robot.received_close_notify());
  EXPECT_NE(rig.adapter.presence_of("r1"), Presence::online);
  EXPECT_EQ(rig.counter("dtls_connections"), 1U);
  EXPECT_EQ(other.insist(Pingreq{}), "PINGRESP");
  robot.begin();
  EXPECT_FALSE(robot.has_connection(std::chrono::milliseconds(300)));
  rig.use_keys({{"r1", key_of_r2}, {"r2", key_of_r2}});
  DtlsClient renewed(rig, "r1", key_of_r2);
  ASSERT_TRUE(renewed.has_connection());
  EXPECT_EQ(renewed.insist(connect_as("r1")), "CONNACK code=0");
}

TEST(Dtls, CountsHandshakesThatNewKeysEnd) {
  DtlsRig rig;
  DtlsClient robot(rig, "r1", key_of_r2);
  for (int flight = 0; flight < 3; ++flight) {
    robot.step();
    rig.io.poll();
  }
  rig.use_keys(both);
  EXPECT_EQ(rig.counter("dtls_handshakes_failed"), 0U) << "the same keys as before";
  rig.use_keys({{"r2", key_of_r2}});
  EXPECT_EQ(rig.counter("dtls_handshakes_failed"), 1U);
}

TEST(Dtls, CountsTruncatedDatagrams) {
  DtlsRig rig;
  UdpClient client(rig, "127.0.0.1", 1);
  client.send_octets(Bytes(65507, 0x16));
  EXPECT_TRUE(test::eventually(rig.io, [&] { return rig.counter("truncated") == 1U; }));
}

TEST(Dtls, SendsCloseNotifyAtShutdown) {
  std::optional<DtlsRig> rig(std::in_place);
  DtlsClient robot(*rig, "r1", key_of_r1);
  join(robot);
  rig->adapter.stop();
  EXPECT_TRUE(robot.received_close_notify()) << "so that robots can reconnect at once";
}

std::size_t resident_octets() {
  malloc_trim(0);
  std::ifstream file("/proc/self/statm");
  std::size_t pages = 0;
  file >> pages >> pages;
  return pages * 4096;
}

/// SLAMGW_FLOOD=10000 makes the full test.
TEST(Dtls, ServesRobotsInBoundedMemoryDuringAHandshakeFlood) {
  const char* const wanted = std::getenv("SLAMGW_FLOOD");
  const unsigned count = wanted ? static_cast<unsigned>(std::strtoul(wanted, nullptr, 10)) : 600;
  DtlsRig rig;
  const std::size_t before = resident_octets();
  std::list<DtlsClient> robots;
  for (unsigned i = 0; i < count; ++i) {
    const auto address = boost::asio::ip::make_address_v4(0x7f000100U + i % 60);
    DtlsClient attacker(rig, "r1", key_of_r2, {}, "PSK-AES128-GCM-SHA256", {address, 0});
    // Two flights: the ClientHello, and the one with the cookie, which makes the gateway keep
    // state.
    for (int flight = 0; flight < 3; ++flight) {
      attacker.step();
      rig.io.poll();
    }
    if (i % 200 != 199) continue;
    robots.emplace_back(rig, "r1", key_of_r1);
    ASSERT_TRUE(robots.back().has_connection()) << "after " << i;
    EXPECT_EQ(robots.back().insist(connect_as("r1")), "CONNACK code=0");
  }
  EXPECT_EQ(rig.counter("dtls_connections"), 1U);
  EXPECT_GE(rig.counter("dtls_handshakes_failed"),
            count - count / 50 - limits::max_dtls_handshakes);
  EXPECT_LT(rig.core.notices.size(), 20U) << "one notice in ten seconds";
  EXPECT_LT(resident_octets() - before, std::size_t{64} << 20U);
}

}  // namespace
}  // namespace slamgw::mqttsn
