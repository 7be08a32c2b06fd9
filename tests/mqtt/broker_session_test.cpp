// SPDX-License-Identifier: Apache-2.0
// State that outlives one connection to a real Mosquitto: the credentials, the configuration, and a
// rival with our client id.
#include <gtest/gtest.h>

#include <array>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/write.hpp>

#include "daemon/mqtt/connection_probe.hpp"
#include "tests/mqtt/broker_link.hpp"
#include "tests/support/fake_broker.hpp"
#include "tests/support/free_port.hpp"
#include "tests/support/mosquitto.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw {
namespace {

using test::Mosquitto;
using test::Subscriber;

using BrokerSession = WithEachClient;
INSTANTIATE_TEST_SUITE_P(Over, BrokerSession, each_client, BrokerSession::name);

void send_command(const Mosquitto& broker, const std::string& payload) {
  test::mosquitto_publish(broker, {"-q", "1", "-t", "server/r1/cmd", "-m", payload});
}

/// Robots' commands wait in the robots' own sessions.
TEST_P(BrokerSession, LeavesNothingAtTheBrokerForTheNextConnection) {
  Mosquitto broker;
  {
    Link link(settings_for(broker.port()));
    ASSERT_TRUE(link.comes_up());
    link.upstream->subscribe("server/r1/cmd");
    ASSERT_TRUE(link.sees([&] { return link.listener.subscribed.contains("server/r1/cmd"); }));
    send_command(broker, "heard");
    ASSERT_TRUE(link.sees([&] { return link.listener.messages.size() == 1; }));
    link.upstream->stop();
  }
  send_command(broker, "sent while disconnected");
  Link link(settings_for(broker.port()));
  ASSERT_TRUE(link.comes_up());
  send_command(broker, "not subscribed");
  link.upstream->subscribe("other");
  ASSERT_TRUE(link.sees([&] { return link.listener.subscribed.contains("other"); }));
  test::mosquitto_publish(broker, {"-q", "1", "-t", "other", "-m", "last"});
  ASSERT_TRUE(link.sees([&] { return !link.listener.messages.empty(); }));
  EXPECT_EQ(link.listener.messages[0].payload, to_bytes("last"));
}

/// Too large retained messages would arrive at each connection.
TEST_P(BrokerSession, ReceivesNoMessageAboveTheInboundBound) {
  Mosquitto broker;
  const test::TempDir directory;
  test::write_file(directory / "large", std::string(max_inbound_packet_octets + 1, 'x'));
  for (const char* qos : {"0", "1", "2"})
    test::mosquitto_publish(broker, {"-r", "-q", qos, "-t", std::string("server/large/") + qos,
                                     "-f", directory / "large"});
  Link link(settings_for(broker.port()));
  ASSERT_TRUE(link.comes_up());
  link.upstream->subscribe("server/+/+");
  ASSERT_TRUE(link.sees([&] { return link.listener.subscribed.contains("server/+/+"); }));
  for (int i = 0; i < 40; ++i)  // more than Mosquitto sends without an answer
    test::mosquitto_publish(broker,
                            {"-q", "1", "-t", "server/large/cmd", "-f", directory / "large"});
  send_command(broker, "small");
  ASSERT_TRUE(link.sees([&] { return !link.listener.messages.empty(); }));
  EXPECT_EQ(link.listener.messages[0].payload, to_bytes("small"));
  EXPECT_TRUE(link.listener.reasons.empty()) << link.listener.reasons[0];
}

TEST_P(BrokerSession, PublishesMeshGatewayAndTimeOfARobotsMessage) {
  Mosquitto broker;
  Subscriber subscriber(broker, "t", "%P %p", "mqttv5");
  BrokerSettings settings = settings_for(broker.port());
  settings.gateway_id = "lab-1";
  Link link(settings);
  ASSERT_TRUE(link.comes_up());
  const WallTime received{std::chrono::milliseconds{1763700000042}};
  link.upstream->publish(
      1, {"t", to_bytes("x"), Qos::at_least_once, false, Provenance{Mesh::ble, received}});
  ASSERT_TRUE(link.sees([&] { return !subscriber.lines().empty(); }));
  EXPECT_EQ(subscriber.lines()[0], "mesh:ble gateway:lab-1 received_at:2025-11-21T04:40:00.042Z x");
}

/// Connects with the client id of Link, and stays.
boost::asio::ip::tcp::socket rival_of(Link& link, std::uint16_t port) {
  const std::string id = "slam-gateway-test";
  std::string connect = "\x10" + std::string(1, static_cast<char>(12 + id.size()));
  connect += std::string("\0\4MQTT\4\2\0\x3c\0", 11) + static_cast<char>(id.size()) + id;
  boost::asio::ip::tcp::socket socket(link.io);
  socket.connect({boost::asio::ip::address_v4::loopback(), port});
  boost::asio::write(socket, boost::asio::buffer(connect));
  return socket;
}

TEST_P(BrokerSession, ReportsAnotherClientWithItsClientId) {
  Mosquitto broker;  // Debian 12's sends no reason when it ends a connection
  const std::string suspicion = "another client connects as 'slam-gateway-test'";
  Link link(settings_for(broker.port()));
  for (std::size_t times = 1; times <= 2; ++times) {
    ASSERT_TRUE(link.comes_up());
    const auto rival = rival_of(link, broker.port());
    ASSERT_TRUE(link.sees([&] { return link.listener.reasons.size() == times; }));
  }
  const std::string& first = link.listener.reasons[0];
  EXPECT_TRUE(first == "connection lost" || first.starts_with(suspicion)) << first;
  EXPECT_NE(link.listener.reasons[1].find(suspicion), std::string::npos)
      << link.listener.reasons[1];
}

/// A broker that accepts a CONNECT and answers nothing else.
struct CurtBroker {
  using tcp = boost::asio::ip::tcp;

  std::uint16_t port() const { return acceptor.local_endpoint().port(); }
  void connect(Link& link) {
    acceptor.non_blocking(true);
    boost::system::error_code error;
    ASSERT_TRUE(link.sees([&] { return !acceptor.accept(connection, error); }));
    read_packet(link);
    boost::asio::write(connection,
                       boost::asio::buffer(std::array<std::uint8_t, 5>{0x20, 3, 0, 0, 0}));
    ASSERT_TRUE(link.comes_up());
  }
  void read_packet(Link& link) {
    std::array<std::uint8_t, 512> packet{};
    ASSERT_TRUE(link.sees([&] { return connection.available() > 0; }));
    connection.read_some(boost::asio::buffer(packet));
  }

  boost::asio::io_context io;
  tcp::acceptor acceptor{io, {boost::asio::ip::address_v4::loopback(), 0}};
  tcp::socket connection{io};
};

TEST_P(BrokerSession, ReportsALostConnectionWhileAMessageIsUnderWay) {
  CurtBroker broker;
  Link link(settings_for(broker.port()));
  ASSERT_NO_FATAL_FAILURE(broker.connect(link));
  link.upstream->publish(1, {"t", to_bytes("x"), Qos::at_least_once, false});
  ASSERT_NO_FATAL_FAILURE(broker.read_packet(link));
  broker.connection.close();
  ASSERT_TRUE(link.sees([&] { return !link.listener.reasons.empty(); }));
  EXPECT_TRUE(link.listener.reasons[0].starts_with("connection lost")) << link.listener.reasons[0];
}

/// The broker sends a DISCONNECT with a reason (MQTT 5 section 3.14).
TEST_P(BrokerSession, ReportsTheReasonOfTheBrokersDisconnect) {
  CurtBroker broker;
  Link link(settings_for(broker.port()));
  ASSERT_NO_FATAL_FAILURE(broker.connect(link));
  boost::asio::write(broker.connection,
                     boost::asio::buffer(std::array<std::uint8_t, 4>{0xe0, 2, 0x8e, 0}));
  broker.connection.shutdown(CurtBroker::tcp::socket::shutdown_both);
  ASSERT_TRUE(link.sees([&] { return !link.listener.reasons.empty(); }));
  EXPECT_NE(link.listener.reasons[0].find("another client connects as"), std::string::npos)
      << link.listener.reasons[0];
}

TEST_P(BrokerSession, SuspectsNoOtherClientWhenTheBrokerSaysWhyItCloses) {
  test::FakeBroker broker;
  broker.misbehave([](test::FakeBroker::Connection& connection, const auto& packet) {
    if (packet.type() != test::FakeBroker::connect) return false;
    connection.send(0x20, {0, 0, 0});
    connection.send(0xe0, {0x89, 0});
    return true;
  });
  Link link(settings_for(broker.port()));
  ASSERT_TRUE(link.sees([&] { return link.listener.reasons.size() == 3; }));
  for (const std::string& why : link.listener.reasons) EXPECT_EQ(why, "the broker is busy");
}

TEST_P(BrokerSession, ReadsItsCredentialsAgainForEachAttempt) {
  Mosquitto broker({}, "gw", "right");
  std::optional<Credentials> in_file = Credentials{"gw", "wrong"};
  Link link(settings_for(broker.port(), in_file), [&] { return in_file; });
  ASSERT_TRUE(link.sees([&] { return !link.listener.reasons.empty(); }));
  in_file->password = "right";
  EXPECT_TRUE(link.comes_up());
}

TEST_P(BrokerSession, MovesToAnotherBrokerWhenReconfigured) {
  Mosquitto first;
  Mosquitto second;
  Link link(settings_for(first.port()));
  ASSERT_TRUE(link.comes_up());
  link.upstream->reconfigure(settings_for(first.port()));
  EXPECT_TRUE(link.listener.is_up) << "nothing has changed";
  link.upstream->reconfigure(settings_for(second.port()));
  EXPECT_FALSE(link.listener.is_up);
  ASSERT_TRUE(link.comes_up());
  Subscriber subscriber(second, "t");
  link.upstream->publish(1, {"t", to_bytes("x"), Qos::at_least_once, false});
  EXPECT_TRUE(link.sees([&] { return subscriber.lines().size() == 1; }));
}

TEST_P(BrokerSession, TriesEachAddressOfAName) {
  // "localhost" is ::1 and 127.0.0.1 where there is IPv6: whichever the broker has is found.
  Mosquitto broker;
  BrokerSettings settings = settings_for(broker.port());
  settings.host = "localhost";
  EXPECT_FALSE(find_broker(settings).addresses.empty());
  Link link(settings);
  EXPECT_TRUE(link.comes_up());
}

TEST(ConnectionProbe, ReportsAHostNameThatCannotBeResolved) {
  BrokerSettings settings = settings_for(1883);
  settings.host = "no-such-host.invalid";
  const Reachability found = probe_broker(settings);
  EXPECT_NE(found.text.find("'no-such-host.invalid' can't be resolved"), std::string::npos)
      << found.text;
}

TEST(ConnectionProbe, ReportsAPortWithoutTls) {
  Mosquitto broker;
  BrokerSettings settings = settings_for(broker.port());
  settings.tls = true;
  const Reachability found = probe_broker(settings);
  EXPECT_NE(found.text.find("TLS port"), std::string::npos) << found.text;
  EXPECT_FALSE(found.is_reachable);
}

}  // namespace
}  // namespace slamgw
