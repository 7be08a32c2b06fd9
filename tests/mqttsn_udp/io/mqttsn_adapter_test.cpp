// SPDX-License-Identifier: Apache-2.0
// The shell with real UDP on loopback: source addresses of answers, oversized datagrams, multicast,
// and errors of sockets.
#include "adapters/mqttsn_udp/io/mqttsn_adapter.hpp"

#include <gtest/gtest.h>

#include <boost/asio/ip/multicast.hpp>
#include <boost/asio/ip/udp.hpp>

#include "tests/mqttsn_udp/io/udp_rig.hpp"

namespace slamgw::mqttsn {
namespace {

using boost::asio::ip::udp;

TEST(MqttsnAdapter, R17_AnswersFromTheAddressThatWasAsked) {
  UdpRig rig({"0.0.0.0:0", "[::]:0"});
  const std::pair<const char*, std::size_t> ways[] = {
      {"127.0.0.1", 0}, {"127.0.0.5", 0}, {"127.0.0.9", 1}, {"::1", 1}};
  for (const auto& [address, index] : ways) {
    UdpClient client(rig, address, index);
    client.send(SearchGw{1});
    EXPECT_EQ(client.receive(), "GWINFO gw=1 address=") << address;
  }
}

TEST(MqttsnAdapter, R22_ListensOnTheConfiguredAddresses) {
  UdpRig rig({"127.0.0.1:0", "[::1]:0"});
  UdpClient v4(rig, "127.0.0.1", 0);
  UdpClient v6(rig, "::1", 1);
  v4.send(Connect{false, true, 1, 60, "four"});
  v6.send(Connect{false, true, 1, 60, "six"});
  EXPECT_EQ(v4.receive(), "CONNACK code=0");
  EXPECT_EQ(v6.receive(), "CONNACK code=0");
  EXPECT_EQ(rig.adapter.presence_of("four"), Presence::online);
  EXPECT_EQ(rig.adapter.presence_of("six"), Presence::online);
}

TEST(MqttsnAdapter, CarriesARobotsMessageUpAndACommandDown) {
  const std::uint16_t adv = topic_id_of("ntnu-slam/robot/r1/adv");
  const std::string cmd = std::to_string(topic_id_of("ntnu-slam/server/r1/cmd"));
  UdpRig rig({"127.0.0.1:0"});
  UdpClient robot(rig, "127.0.0.1");
  robot.send(Connect{false, true, 1, 60, "r1"});
  EXPECT_EQ(robot.receive(), "CONNACK code=0");
  robot.send(Register{0, 1, "ntnu-slam/robot/r1/adv"});
  EXPECT_EQ(robot.receive(), "REGACK id=" + std::to_string(adv) + " msg=1 code=0");
  Subscribe subscribe;
  subscribe.msg_id = 2;
  subscribe.topic_name = "ntnu-slam/server/r1/cmd";
  robot.send(subscribe);
  EXPECT_EQ(robot.receive(), "SUBACK qos=0 id=" + cmd + " msg=2 code=0");
  robot.send(Publish{false, WireQos::one, false, TopicIdType::normal, adv, 3, to_bytes("x")});
  EXPECT_EQ(robot.receive(), "PUBACK id=" + std::to_string(adv) + " msg=3 code=0");
  ASSERT_EQ(rig.core.reports.size(), 1U);
  rig.adapter.on_broker_message(
      {"r1", {"ntnu-slam/server/r1/cmd", to_bytes("y"), Qos{}, false}, CommandId{1}});
  EXPECT_EQ(robot.receive(), "PUBLISH dup=0 qos=0 retain=0 normal id=" + cmd + " msg=0 data=79");
}

TEST(MqttsnAdapter, TakesOverARoamingRobotAndHandsItOn) {
  const std::string cmd = "ntnu-slam/server/r1/cmd";
  UdpRig rig({"127.0.0.1:0"});
  rig.adapter.ask_where_served([](const std::string& robot) { return robot == "r1"; });
  UdpClient robot(rig, "127.0.0.1");
  robot.send(Connect{false, false, 1, 60, "r1"});
  EXPECT_EQ(robot.receive(), "CONNACK code=0");
  robot.send(Disconnect{60});
  EXPECT_EQ(robot.receive(), "DISCONNECT plain");
  rig.adapter.on_broker_message({"r1", {cmd, to_bytes("y"), Qos::at_least_once}, CommandId{1}});
  const auto unsent = rig.adapter.give_up("r1");
  ASSERT_EQ(unsent.size(), 1U);
  EXPECT_EQ(unsent[0].command, CommandId{1});
  EXPECT_EQ(rig.adapter.presence_of("r1"), std::nullopt);
}

TEST(MqttsnAdapter, R9_CountsOversizedDatagramsAndContinues) {
  UdpRig rig({"127.0.0.1:0"});
  UdpClient client(rig, "127.0.0.1");
  client.send_octets(Bytes(65507, 0x0c));
  client.send_octets(Bytes(1233, 0x0c));
  client.send(SearchGw{0});
  EXPECT_EQ(client.receive(), "GWINFO gw=1 address=");
  std::map<std::string_view, std::uint64_t> counters;
  for (const Counter& counter : rig.adapter.counters()) counters[counter.name] = counter.value;
  EXPECT_EQ(counters["oversized"], 2U);
  EXPECT_EQ(counters["truncated"], 1U);
}

TEST(MqttsnAdapter, R19_HearsSearchesByMulticastOnItsInterface) {
  boost::asio::io_context io;
  FakeCore core;
  Settings settings;
  settings.listen = {"0.0.0.0:0"};
  settings.interface = "lo";
  settings.multicast_group = "239.9.9.9";
  MqttsnAdapter adapter(io, settings, TopicPolicy(TopicScheme("ntnu-slam", "gw"), {}, {}),
                        RobotNames(), core);
  adapter.start();
  adapter.on_broker_link(true);
  const auto loopback = boost::asio::ip::address_v4::loopback();
  udp::socket client(io, {loopback, 0});
  client.set_option(boost::asio::ip::multicast::outbound_interface(loopback));
  client.non_blocking(true);
  const udp::endpoint group(boost::asio::ip::make_address("239.9.9.9"), core.port());
  client.send_to(boost::asio::buffer(encode(SearchGw{1})), group);
  udp::endpoint from;
  EXPECT_EQ(receive(io, client, &from), "GWINFO gw=1 address=");
  EXPECT_EQ(from.address(), loopback);
  adapter.stop();
}

/// Robots on Wi-Fi search by the broadcast address of their network.
TEST(MqttsnAdapter, R19_HearsSearchesByBroadcastToANetwork) {
  for (const std::string listen : {"0.0.0.0:0", "[::]:0"}) {
    UdpRig rig({listen});
    udp::socket client(rig.io, {boost::asio::ip::address_v4::loopback(), 0});
    client.set_option(boost::asio::socket_base::broadcast(true));
    client.non_blocking(true);
    const auto network = boost::asio::ip::make_address("127.255.255.255");
    client.send_to(boost::asio::buffer(encode(SearchGw{1})), {network, rig.core.port()});
    udp::endpoint from;
    EXPECT_EQ(receive(rig.io, client, &from), "GWINFO gw=1 address=") << listen;
    EXPECT_EQ(from.address(), boost::asio::ip::address_v4::loopback()) << listen;
  }
}

TEST(MqttsnAdapter, R19_WaitsForAMissingInterface) {
  boost::asio::io_context io;
  FakeCore core;
  Settings settings = UdpRig::with({}, {"127.0.0.1:0"});
  settings.interface = "nowhere0";
  MqttsnAdapter adapter(io, settings, TopicPolicy(TopicScheme("ntnu-slam", "gw"), {}, {}),
                        RobotNames(), core);
  adapter.start();
  ASSERT_EQ(core.links.size(), 1U);
  EXPECT_FALSE(core.links[0].is_up);
  EXPECT_NE(core.links[0].detail.find("nowhere0"), std::string::npos);
  adapter.on_broker_link(true);
  EXPECT_EQ(core.links.size(), 1U) << "it still waits";
  adapter.stop();
}

TEST(MqttsnAdapter, NamesTheAddressOnWhichItCannotListen) {
  boost::asio::io_context io;
  udp::socket other(io, {boost::asio::ip::address_v4::loopback(), 0});
  const std::string taken = "127.0.0.1:" + std::to_string(other.local_endpoint().port());
  for (const std::string& listen : {taken, std::string("nonsense"), std::string("[::1:5")}) {
    FakeCore core;
    MqttsnAdapter adapter(io, UdpRig::with({}, {listen}),
                          TopicPolicy(TopicScheme("ntnu-slam", "gw"), {}, {}), RobotNames(), core);
    try {
      adapter.start();
      ADD_FAILURE() << listen;
    } catch (const std::runtime_error& error) {
      EXPECT_NE(std::string(error.what()).find(listen), std::string::npos) << error.what();
    }
  }
}

}  // namespace
}  // namespace slamgw::mqttsn
