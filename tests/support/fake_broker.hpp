// SPDX-License-Identifier: Apache-2.0
// A small MQTT broker on loopback, for both versions. It records the messages that it acknowledges,
// and follows the protocol unless a test installs a Misbehaviour. Subscribers receive only messages
// that a test sends. It runs on a thread of its own.
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
    /// Returns whether the body contains the text, such as the filter of a SUBSCRIBE.
    bool contains(std::string_view text) const;
  };
  class Connection;
  /// Called for each packet before it is answered. Returns true to suppress the answer.
  using Misbehaviour = std::function<bool(Connection&, const Packet&)>;

  FakeBroker();
  ~FakeBroker();
  FakeBroker(const FakeBroker&) = delete;
  FakeBroker& operator=(const FakeBroker&) = delete;

  std::uint16_t port() const { return port_; }
  std::size_t connections() const { return connections_; }
  /// Applies from now on, also to open connections. Null restores the protocol.
  void misbehave(Misbehaviour misbehaviour);
  /// Returns "topic payload" of each acknowledged (QoS 0: read) message, in order.
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

/// The connection that a Misbehaviour may use.
class FakeBroker::Connection : public std::enable_shared_from_this<Connection> {
 public:
  Connection(FakeBroker& broker, boost::asio::ip::tcp::socket socket);

  bool is_v5() const { return is_v5_; }
  /// Sends the octets unchanged.
  void send(const Octets& octets);
  /// Sends a packet: the first octet, the length, the body.
  void send(std::uint8_t first, const Octets& body);
  void close();
  /// Returns the number of packets so far, including the current one.
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
