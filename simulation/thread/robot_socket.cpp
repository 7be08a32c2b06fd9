// SPDX-License-Identifier: Apache-2.0
#include "simulation/thread/robot_socket.hpp"

#include <array>
#include <boost/asio/buffer.hpp>
#include <utility>

namespace slamgw::sim::sn {

using boost::asio::ip::udp;
using boost::system::error_code;

namespace {

/// Treats an error as a lost datagram: the client repeats.
void transmit(udp::socket& socket, const Bytes& datagram) {
  error_code ignored;
  socket.send(boost::asio::buffer(datagram), 0, ignored);
}

}  // namespace

RobotSocket::RobotSocket(boost::asio::io_context& io, const udp::endpoint& gateway, Client client,
                         const Impairment& uplink, const Impairment& downlink,
                         std::function<void(RobotSocket&)> on_change)
    : io_(io),
      gateway_(gateway),
      socket_(open()),
      timer_(io),
      roam_timer_(io),
      client_(std::move(client)),
      uplink_(uplink),
      downlink_(downlink),
      on_change_(std::move(on_change)) {}

std::shared_ptr<udp::socket> RobotSocket::open() {
  auto socket = std::make_shared<udp::socket>(io_, gateway_.protocol());
  socket->connect(gateway_);
  socket->non_blocking(true);
  return socket;
}

void RobotSocket::start() {
  wait_readable();
  input([](Client& client, TimePoint now) { client.on_start(now); });
}

void RobotSocket::stop() {
  input([](Client& client, TimePoint now) { client.on_stop(now); });
}

void RobotSocket::roam(Duration first, Duration interval) {
  roam_timer_.expires_after(first);
  roam_timer_.async_wait([this, interval](error_code error) {
    if (error || client_.is_finished()) return;
    move();
    roam(interval, interval);
  });
}

void RobotSocket::move() {
  socket_->cancel();
  socket_ = open();
  wait_readable();
  input([](Client& client, TimePoint) { client.on_moved(); });
}

template <class Change>
void RobotSocket::input(Change&& change) {
  change(client_, std::chrono::steady_clock::now());
  while (auto outgoing = client_.next_datagram()) send(std::move(*outgoing));
  arm_timer();
  on_change_(*this);
}

void RobotSocket::arm_timer() {
  const std::optional<TimePoint> next = client_.deadline();
  if (!next) {
    timer_.expires_at(TimePoint::min());
    return;
  }
  if (timer_.expiry() == *next) return;  // already waiting for it
  timer_.expires_at(*next);
  timer_.async_wait([this](error_code error) {
    if (error) return;
    timer_.expires_at(TimePoint::min());
    input([](Client& client, TimePoint now) { client.on_deadline(now); });
  });
}

void RobotSocket::send(Outgoing outgoing) {
  const std::vector<Duration> copies = uplink_.next_fate();
  if (copies.empty() && outgoing.is_unacknowledged_update) client_.on_update_dropped();
  if (outgoing.number > 0) client_.on_link_repeats(outgoing.number, uplink_.link_repeats());
  for (const Duration delay : copies) {
    if (delay == Duration::zero()) {
      transmit(*socket_, outgoing.datagram);
    } else {
      later(delay, [from = socket_, datagram = outgoing.datagram] { transmit(*from, datagram); });
    }
  }
}

void RobotSocket::wait_readable() {
  socket_->async_wait(udp::socket::wait_read, [this](error_code error) {
    if (error) return;
    read_all();
    wait_readable();
  });
}

void RobotSocket::read_all() {
  std::array<std::uint8_t, 2048> buffer;
  for (;;) {
    error_code error;
    const std::size_t size = socket_->receive(boost::asio::buffer(buffer), 0, error);
    if (error == boost::asio::error::connection_refused) continue;  // no listener yet
    if (error) return;
    const Bytes datagram(buffer.begin(), buffer.begin() + static_cast<std::ptrdiff_t>(size));
    for (const Duration delay : downlink_.next_fate()) {
      const auto deliver = [this, datagram] {
        input([&](Client& client, TimePoint now) { client.on_datagram(datagram, now); });
      };
      if (delay == Duration::zero()) {
        deliver();
      } else {
        later(delay, deliver);
      }
    }
  }
}

void RobotSocket::later(Duration delay, std::function<void()> what) {
  auto timer = std::make_shared<boost::asio::steady_timer>(io_, delay);
  timer->async_wait([timer, what = std::move(what)](error_code error) {
    if (!error) what();
  });
}

}  // namespace slamgw::sim::sn
