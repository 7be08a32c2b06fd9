// SPDX-License-Identifier: Apache-2.0
// One robot on the Thread mesh, controlled step by step. It uses the simulator's codec, which
// shares no code with the daemon's.
#pragma once

#include <gtest/gtest.h>

#include <array>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/udp.hpp>
#include <string>
#include <vector>

#include "simulation/thread/packet.hpp"
#include "tests/support/eventually.hpp"

namespace slamgw::test {

class Device {
 public:
  explicit Device(const std::string& gateway) : socket_(io_, boost::asio::ip::udp::v4()) {
    const std::size_t colon = gateway.rfind(':');
    socket_.connect({boost::asio::ip::make_address(gateway.substr(0, colon)),
                     static_cast<std::uint16_t>(std::stoi(gateway.substr(colon + 1)))});
    socket_.non_blocking(true);
  }

  /// Returns false if the kernel reports that the previous message was refused: no daemon listens.
  bool send(const std::vector<std::uint8_t>& octets) {
    boost::system::error_code refused;
    socket_.send(boost::asio::buffer(octets), 0, refused);
    return !refused;
  }
  /// Returns the next message, which must be of `type`. Skips repeated answers to insist().
  sim::sn::Packet expect(sim::sn::Type type) {
    std::optional<sim::sn::Packet> packet;
    const bool has_come = eventually([&] {
      boost::system::error_code error;
      const std::size_t size = socket_.receive(boost::asio::buffer(buffer_), 0, error);
      if (error) return false;
      packet = sim::sn::decode({buffer_.data(), size});
      return !packet || packet->type == type || packet->type != insisted_;
    });
    EXPECT_TRUE(has_come) << "no answer";
    EXPECT_TRUE(packet && packet->type == type) << (packet ? int(packet->type) : -1);
    return packet.value_or(sim::sn::Packet{});
  }
  /// Sends again until answered, as devices do while the gateway is away.
  sim::sn::Packet insist(const std::vector<std::uint8_t>& octets, sim::sn::Type type) {
    std::size_t size = 0;
    eventually([&] {
      send(octets);
      boost::system::error_code error;
      return eventually(
          [&] { return (size = socket_.receive(boost::asio::buffer(buffer_), 0, error)) > 0; },
          std::chrono::milliseconds(300));
    });
    const auto packet = sim::sn::decode({buffer_.data(), size});
    EXPECT_TRUE(packet && packet->type == type);
    insisted_ = type;
    return packet.value_or(sim::sn::Packet{});
  }
  /// Connects without CleanSession, with a will on ntnu-slam/robot/<robot>/gone. An exchange like
  /// that of the will proves the address to the gateway.
  void connect_with_will(const std::string& robot) {
    constexpr std::uint8_t keep_alive_s = 60;
    insist(sim::sn::connect(robot, keep_alive_s, sim::sn::flag_will), sim::sn::Type::willtopicreq);
    send(sim::sn::willtopic("ntnu-slam/robot/" + robot + "/gone", 0x20));
    expect(sim::sn::Type::willmsgreq);
    send(sim::sn::willmsg("will"));
    EXPECT_EQ(expect(sim::sn::Type::connack).return_code, sim::sn::accepted);
  }
  void subscribe(const std::string& topic) {
    send(sim::sn::subscribe(1, 2, topic));
    EXPECT_EQ(expect(sim::sn::Type::suback).return_code, sim::sn::accepted);
  }
  /// Takes a command on a topic whose id is not registered yet.
  void obey() {
    const auto topic = expect(sim::sn::Type::register_topic);
    send(sim::sn::regack(topic.topic_id, topic.msg_id, sim::sn::accepted));
    const auto message = expect(sim::sn::Type::publish);
    send(sim::sn::puback(message.topic_id, message.msg_id, sim::sn::accepted));
  }
  bool is_silent() {
    while (true) {
      boost::system::error_code error;
      const std::size_t size = socket_.receive(boost::asio::buffer(buffer_), 0, error);
      const auto packet = sim::sn::decode({buffer_.data(), size});
      if (size == 0 || !packet || packet->type != insisted_) return size == 0;
    }
  }

 private:
  boost::asio::io_context io_;
  boost::asio::ip::udp::socket socket_;
  std::array<std::uint8_t, 2000> buffer_{};
  std::optional<sim::sn::Type> insisted_;  ///< type of the answer that may come repeatedly
};

}  // namespace slamgw::test
