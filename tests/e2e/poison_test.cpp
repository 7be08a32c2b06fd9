// SPDX-License-Identifier: Apache-2.0
// Text for which a real Mosquitto closes the connection: a robot that sends it is refused, and the
// link that all robots share stays up.
#include <gtest/gtest.h>

#include <algorithm>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/read.hpp>
#include <boost/asio/write.hpp>

#include "daemon/core/topic_scheme.hpp"
#include "daemon/core/utf8.hpp"
#include "tests/e2e/device.hpp"
#include "tests/e2e/gateway_process.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;
using sim::sn::Type;

constexpr std::uint8_t not_supported = 3;

TEST(Poison, IsRefusedWhileBrokerLinkStaysUp) {
  Mosquitto broker;
  GatewayProcess gateway(json{{"broker", {{"uri", broker.uri()}}},
                              {"topics", {{"extra_publish", {"#"}}, {"extra_subscribe", {"#"}}}}});
  Subscriber subscriber(broker, "ntnu-slam/robot/#");
  ASSERT_TRUE(eventually([&] { return gateway.logs(" connected (MQTT"); })) << gateway.log();
  Device stranger(gateway.mqttsn_address());
  const auto refused = stranger.insist(
      sim::sn::connect("r\xef\xbf\xbe", 60, sim::sn::flag_clean_session), Type::connack);
  EXPECT_EQ(refused.return_code, not_supported);

  Device device(gateway.mqttsn_address());
  device.insist(sim::sn::connect("r1", 60, sim::sn::flag_clean_session), Type::connack);
  std::uint16_t msg_id = 0;
  const auto register_topic = [&](const std::string& topic) {
    device.send(sim::sn::register_topic(++msg_id, topic));
    return device.expect(Type::regack);
  };
  for (const std::string poison : {"a\xc2\x85", "a\xef\xb7\x90", "a\x01"}) {
    EXPECT_EQ(register_topic("ntnu-slam/robot/r1/" + poison).return_code, not_supported);
    EXPECT_EQ(register_topic(poison).return_code, not_supported);
    device.send(sim::sn::subscribe(1, ++msg_id, poison));
    EXPECT_EQ(device.expect(Type::suback).return_code, not_supported);
  }
  const auto topic_id = register_topic("ntnu-slam/robot/r1/adv").topic_id;
  device.send(sim::sn::publish(1, topic_id, ++msg_id, std::vector<std::uint8_t>{1}));
  EXPECT_EQ(device.expect(Type::puback).return_code, 0);
  EXPECT_TRUE(eventually([&] { return !subscriber.lines().empty(); }));
  EXPECT_EQ(subscriber.lines(), std::vector<std::string>{"ntnu-slam/robot/r1/adv 01"});
  EXPECT_FALSE(gateway.logs("connection lost")) << gateway.log();
  EXPECT_EQ(gateway.ctl({"status"})["broker"]["state"], "up");
}

std::string mqtt_string(std::string_view text) {
  return std::string{static_cast<char>(text.size() >> 8), static_cast<char>(text.size())} +
         std::string(text);
}

/// An MQTT 3.1.1 packet with `first` as its first octet.
std::string mqtt_packet(std::uint8_t first, const std::string& body) {
  std::string packet(1, static_cast<char>(first));
  for (std::size_t rest = body.size();; rest >>= 7) {
    packet += static_cast<char>((rest & 0x7f) | (rest > 0x7f ? 0x80 : 0));
    if (rest <= 0x7f) return packet + body;
  }
}

/// Publishes to `topic` at QoS 1 without the checks of a client library. Returns false when the
/// broker closes the connection instead of acknowledging.
bool is_taken(const Mosquitto& broker, const std::string& topic) {
  using boost::asio::ip::tcp;
  boost::asio::io_context io;
  tcp::socket socket(io);
  socket.connect({boost::asio::ip::address_v4::loopback(), broker.port()});
  const std::string connect = mqtt_string("MQTT") + std::string("\x04\x02\x00\x3c", 4);
  boost::asio::write(socket, boost::asio::buffer(mqtt_packet(0x10, connect + mqtt_string("t"))));
  std::array<std::uint8_t, 4> answer{};
  boost::asio::read(socket, boost::asio::buffer(answer));
  const std::string publish = mqtt_string(topic) + std::string("\x00\x07hi", 4);
  boost::asio::write(socket, boost::asio::buffer(mqtt_packet(0x32, publish)));
  boost::system::error_code closed;
  boost::asio::read(socket, boost::asio::buffer(answer), closed);
  return !closed && answer[0] == 0x40;
}

std::string utf8_of(std::uint32_t c) {
  if (c < 0x80) return {static_cast<char>(c)};
  if (c < 0x800) return {static_cast<char>(0xc0 | c >> 6), static_cast<char>(0x80 | (c & 0x3f))};
  const char low[] = {static_cast<char>(0x80 | (c >> 6 & 0x3f)),
                      static_cast<char>(0x80 | (c & 0x3f))};
  if (c < 0x10000) return {static_cast<char>(0xe0 | c >> 12), low[0], low[1]};
  return {static_cast<char>(0xf0 | c >> 18), static_cast<char>(0x80 | (c >> 12 & 0x3f)), low[0],
          low[1]};
}

std::string levels(int count) {
  std::string topic = "a";
  for (int i = 1; i < count; ++i) topic += "/a";
  return topic;
}

/// The rule is as strict as Mosquitto's for single code points, and never laxer.
TEST(Poison, MatchesTopicsThatMosquittoRejects) {
  Mosquitto broker;
  for (const std::uint32_t c :
       {0x00u,   0x01u,    0x1fu,    0x20u,    0x7eu,    0x7fu,   0x80u,   0x85u,
        0x9fu,   0xa0u,    0xadu,    0x202eu,  0xd7ffu,  0xd800u, 0xdfffu, 0xe000u,
        0xfdcfu, 0xfdd0u,  0xfdefu,  0xfdf0u,  0xfefeu,  0xfeffu, 0xfffdu, 0xfffeu,
        0xffffu, 0x10000u, 0x1fffdu, 0x1fffeu, 0x10ffffu}) {
    const std::string topic = "a/" + utf8_of(c);
    EXPECT_EQ(is_taken(broker, topic), is_valid_topic_name(topic)) << std::hex << c;
  }
  for (const std::string& topic : {std::string("a/\xff"), std::string("a/\xc0\xaf"),
                                   std::string("a/\xf4\x90\x80\x80"), std::string("a/+")}) {
    EXPECT_FALSE(is_taken(broker, topic));
    EXPECT_FALSE(is_valid_topic_name(topic));
  }
  EXPECT_TRUE(is_taken(broker, levels(200)));
  EXPECT_TRUE(is_valid_topic_name(levels(200)));
  EXPECT_FALSE(is_taken(broker, levels(202)));
  EXPECT_FALSE(is_valid_topic_name(levels(202)));
  EXPECT_TRUE(is_taken(broker, std::string(65535, 'x')));
}

}  // namespace
}  // namespace slamgw::test
