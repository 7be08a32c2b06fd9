// SPDX-License-Identifier: Apache-2.0
// One robot's Client on a UDP socket of its own, with the bad radio in between. Used by the fleet,
// which owns it until the io_context has stopped.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/udp.hpp>
#include <boost/asio/steady_timer.hpp>
#include <functional>

#include "simulation/thread/client.hpp"
#include "simulation/thread/impairment.hpp"

namespace slamgw::sim::sn {

class RobotSocket {
 public:
  /// `on_change` is called after each input to the client. The socket is connected to `gateway`:
  /// answers from any other address are not for this robot (R17).
  RobotSocket(boost::asio::io_context& io, const boost::asio::ip::udp::endpoint& gateway,
              Client client, Impairment uplink, Impairment downlink,
              std::function<void(RobotSocket&)> on_change);

  void start();
  void stop();
  const Client& client() const { return client_; }

  bool is_counted_done = false;  ///< the fleet's notes
  bool is_counted_finished = false;

 private:
  template <class Change>
  void input(Change&& change);
  void arm_timer();
  void send(Client::Outgoing outgoing);
  void transmit(const Bytes& datagram);
  void wait_readable();
  void read_all();
  void later(Duration delay, std::function<void()> what);

  boost::asio::io_context& io_;
  boost::asio::ip::udp::socket socket_;
  boost::asio::steady_timer timer_;
  Client client_;
  Impairment uplink_;
  Impairment downlink_;
  std::function<void(RobotSocket&)> on_change_;
};

}  // namespace slamgw::sim::sn
