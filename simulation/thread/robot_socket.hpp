// SPDX-License-Identifier: Apache-2.0
// One robot's Client on a UDP socket of its own, with the bad radio in between. Used by the fleet,
// which owns it until the io_context has stopped.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/udp.hpp>
#include <boost/asio/steady_timer.hpp>
#include <functional>
#include <memory>

#include "simulation/thread/client.hpp"
#include "simulation/thread/impairment.hpp"

namespace slamgw::sim::sn {

class RobotSocket {
 public:
  /// `on_change` is called after each input to the client. The socket is connected to `gateway`:
  /// answers from any other address are not for this robot (R17).
  RobotSocket(boost::asio::io_context& io, const boost::asio::ip::udp::endpoint& gateway,
              Client client, const Impairment& uplink, const Impairment& downlink,
              std::function<void(RobotSocket&)> on_change);

  void start();
  void stop();
  /// Changes the robot's address (its UDP port) after `first` and then each `interval`. Delayed
  /// datagrams still arrive from the old address; answers sent there are lost.
  void roam(Duration first, Duration interval);
  const Client& client() const { return client_; }
  std::optional<UpdateEvent> next_event() { return client_.next_event(); }

  bool is_counted_done = false;  ///< used by the fleet
  bool is_counted_finished = false;

 private:
  template <class Change>
  void input(Change&& change);
  void arm_timer();
  std::shared_ptr<boost::asio::ip::udp::socket> open();
  void move();
  void send(Outgoing outgoing);
  void wait_readable();
  void read_all();
  void later(Duration delay, std::function<void()> what);

  boost::asio::io_context& io_;
  boost::asio::ip::udp::endpoint gateway_;
  std::shared_ptr<boost::asio::ip::udp::socket> socket_;  ///< shared with delayed datagrams
  boost::asio::steady_timer timer_;
  boost::asio::steady_timer roam_timer_;
  Client client_;
  Impairment uplink_;
  Impairment downlink_;
  std::function<void(RobotSocket&)> on_change_;
};

}  // namespace slamgw::sim::sn
