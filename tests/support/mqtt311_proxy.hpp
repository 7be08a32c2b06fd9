// SPDX-License-Identifier: Apache-2.0
// A broker that speaks MQTT 3.1.1 only: a TCP proxy on loopback before a real one. It passes
// connections whose CONNECT has protocol level 4 and rejects the others.
#pragma once

#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <cstdint>
#include <thread>

namespace slamgw::test {

class Mqtt311Proxy {
 public:
  /// The answer to a CONNECT of MQTT 5.
  enum class Answer : std::uint8_t {
    refuse,  ///< CONNACK 0x84, then the end of the connection
    close,   ///< the end of the connection alone
  };

  explicit Mqtt311Proxy(std::uint16_t broker_port, Answer answer = Answer::refuse);
  ~Mqtt311Proxy();
  Mqtt311Proxy(const Mqtt311Proxy&) = delete;
  Mqtt311Proxy& operator=(const Mqtt311Proxy&) = delete;

  std::uint16_t port() const { return port_; }
  std::size_t turned_away() const { return turned_away_; }

 private:
  class Connection;
  void accept();

  const std::uint16_t broker_port_;
  const Answer answer_;
  boost::asio::io_context io_;
  boost::asio::ip::tcp::acceptor acceptor_;
  const std::uint16_t port_;
  std::atomic<std::size_t> turned_away_{0};
  std::thread thread_;
};

}  // namespace slamgw::test
