// SPDX-License-Identifier: Apache-2.0
#include "tests/support/mqtt311_proxy.hpp"

#include <array>
#include <boost/asio/write.hpp>
#include <memory>
#include <optional>
#include <vector>

namespace slamgw::test {
namespace {

using boost::asio::ip::tcp;
using Error = boost::system::error_code;

constexpr std::uint8_t refused_level = 5;

/// The protocol level of a CONNECT (MQTT 5 section 3.1.2.2); nothing while it has not come.
std::optional<std::uint8_t> level_of(const std::vector<std::uint8_t>& connect) {
  std::size_t at = 1;
  while (at < connect.size() && (connect[at] & 0x80) != 0) ++at;  // the remaining length
  constexpr std::size_t from_length_to_level = 1 + 2 + 4;         // with "MQTT" and its own length
  at += from_length_to_level;
  return at < connect.size() ? std::optional(connect[at]) : std::nullopt;
}

}  // namespace

class Mqtt311Proxy::Connection : public std::enable_shared_from_this<Connection> {
 public:
  Connection(Mqtt311Proxy& proxy, tcp::socket client)
      : proxy_(proxy), client_(std::move(client)), broker_(proxy.io_) {}

  void read_connect() {
    client_.async_read_some(
        boost::asio::buffer(up_), [self = shared_from_this()](Error error, std::size_t size) {
          if (error) return;
          self->connect_.insert(self->connect_.end(), self->up_.begin(), self->up_.begin() + size);
          const auto level = level_of(self->connect_);
          if (!level) return self->read_connect();
          if (*level == refused_level) return self->turn_away();
          self->pass_on();
        });
  }

 private:
  using Buffer = std::array<std::uint8_t, 16384>;

  void turn_away() {
    ++proxy_.turned_away_;
    constexpr std::array<std::uint8_t, 5> connack{0x20, 3, 0, 0x84, 0};
    Error ignored;
    if (proxy_.answer_ == Answer::refuse)
      boost::asio::write(client_, boost::asio::buffer(connack), ignored);
    close();
  }

  void pass_on() {
    Error error;
    broker_.connect({boost::asio::ip::address_v4::loopback(), proxy_.broker_port_}, error);
    if (error) return close();
    client_.set_option(tcp::no_delay(true));
    broker_.set_option(tcp::no_delay(true));
    boost::asio::write(broker_, boost::asio::buffer(connect_), error);
    pump(client_, broker_, up_);
    pump(broker_, client_, down_);
  }

  void pump(tcp::socket& from, tcp::socket& to, Buffer& buffer) {
    from.async_read_some(boost::asio::buffer(buffer),
                         [&, self = shared_from_this()](Error error, std::size_t size) {
                           if (error) return self->close();
                           boost::asio::async_write(to, boost::asio::buffer(buffer, size),
                                                    [&, self](Error failure, std::size_t) {
                                                      if (failure) return self->close();
                                                      self->pump(from, to, buffer);
                                                    });
                         });
  }

  void close() {
    Error ignored;
    client_.close(ignored);
    broker_.close(ignored);
  }

  Mqtt311Proxy& proxy_;
  tcp::socket client_;
  tcp::socket broker_;
  std::vector<std::uint8_t> connect_;
  Buffer up_{};
  Buffer down_{};
};

Mqtt311Proxy::Mqtt311Proxy(std::uint16_t broker_port, Answer answer)
    : broker_port_(broker_port),
      answer_(answer),
      acceptor_(io_, {boost::asio::ip::address_v4::loopback(), 0}),
      port_(acceptor_.local_endpoint().port()) {
  accept();
  thread_ = std::thread([this] { io_.run(); });
}

Mqtt311Proxy::~Mqtt311Proxy() {
  io_.stop();
  thread_.join();
}

void Mqtt311Proxy::accept() {
  acceptor_.async_accept([this](Error error, tcp::socket client) {
    if (error) return;
    std::make_shared<Connection>(*this, std::move(client))->read_connect();
    accept();
  });
}

}  // namespace slamgw::test
