// SPDX-License-Identifier: Apache-2.0
// A small MQTT broker on loopback, for both versions, that remembers what it acknowledges and keeps
// to the protocol except where a test says otherwise. No subscriber ever gets anything from it but
// what a test sends. On a thread of its own.
#pragma once

#include <array>
#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

namespace slamgw::test {

class FakeBroker {
 public:
  using Octets = std::vector<std::uint8_t>;
  enum Type : std::uint8_t {
    connect = 1,
    connack,
    publish,
    puback,
    pubrec,
    pubrel,
    pubcomp,
    subscribe,
    suback,
    unsubscribe,
    unsuback,
    pingreq,
    pingresp,
    disconnect,
    auth,
  };
  struct Packet {
    std::uint8_t first = 0;  ///< type and flags
    Octets body;
    Type type() const { return static_cast<Type>(first >> 4); }
    /// Of a SUBSCRIBE: whether the filter is in it.
    bool contains(std::string_view text) const;
  };
  class Connection;
  /// Called for each packet before it is answered; true: it is not to be answered any more.
  using Misbehaviour = std::function<bool(Connection&, const Packet&)>;

  FakeBroker();
  ~FakeBroker();
  FakeBroker(const FakeBroker&) = delete;
  FakeBroker& operator=(const FakeBroker&) = delete;

  std::uint16_t port() const { return port_; }
  std::size_t connections() const { return connections_; }
  /// From now on, on old connections too; nothing: it keeps to the protocol.
  void misbehave(Misbehaviour misbehaviour);
  /// "topic payload" of each message that it has acknowledged (QoS 0: read), in their order.
  std::vector<std::string> arrived() const;

 private:
  void accept();
  bool misbehaves(Connection& connection, const Packet& packet);
  void on_arrived(std::string message);

  boost::asio::io_context io_;
  boost::asio::ip::tcp::acceptor acceptor_;
  const std::uint16_t port_;
  std::atomic<std::size_t> connections_{0};
  mutable std::mutex mutex_;
  Misbehaviour misbehaviour_;
  std::vector<std::string> arrived_;
  std::thread thread_;
};

/// What a Misbehaviour may do.
class FakeBroker::Connection : public std::enable_shared_from_this<Connection> {
 public:
  Connection(FakeBroker& broker, boost::asio::ip::tcp::socket socket);

  bool is_v5() const { return is_v5_; }
  /// As they are.
  void send(const Octets& octets);
  /// With its length.
  void send(std::uint8_t first, const Octets& body);
  void close();
  /// How many packets have come, this one included.
  std::size_t packets() const { return packets_; }

 private:
  friend class FakeBroker;
  void read();
  bool take_packet();
  void answer(const Packet& packet);
  void answer_publish(const Packet& packet);
  void acknowledge(std::uint8_t first, const Packet& packet, std::size_t id_at = 0);

  FakeBroker& broker_;
  boost::asio::ip::tcp::socket socket_;
  Octets buffer_;
  std::array<std::uint8_t, 16384> chunk_{};
  bool is_v5_ = false;
  std::size_t packets_ = 0;
};

}  // namespace slamgw::test
