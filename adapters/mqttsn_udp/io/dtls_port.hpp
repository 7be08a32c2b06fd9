// SPDX-License-Identifier: Apache-2.0
// DTLS 1.2 with pre-shared keys (RFC 6347, RFC 4279) on UDP sockets of its own: hands on what
// clients say together with the identity that their key proves, and encrypts what they are told.
// Knows nothing of MQTT-SN. I/O shell of OpenSSL; owned by MqttsnAdapter. Loop's thread only.
#pragma once

#include <openssl/ssl.h>
#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>

#include <array>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "adapters/mqttsn_udp/clients/handshake_places.hpp"
#include "adapters/mqttsn_udp/io/udp_socket.hpp"
#include "daemon/core/freed_by.hpp"
#include "daemon/core/log_throttle.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/robot_keys.hpp"

namespace slamgw::mqttsn {

class DtlsPort {
 public:
  /// `datagram` with what the client has encrypted in its place.
  using Receive =
      std::function<void(const UdpSocket::Datagram& datagram, const std::string& identity)>;
  using Tell = std::function<void(Notice)>;

  /// `receive` may call send().
  DtlsPort(boost::asio::io_context& io, RobotKeys keys, Receive receive, Tell tell);
  DtlsPort(const DtlsPort&) = delete;
  DtlsPort& operator=(const DtlsPort&) = delete;

  /// Receives from this socket, too.
  void add(std::shared_ptr<UdpSocket> socket);
  const std::vector<std::shared_ptr<UdpSocket>>& sockets() const { return sockets_; }
  /// They are closed; connections wait for others.
  void forget_sockets() { sockets_.clear(); }

  /// False when this client has no connection there, or is too long for a record.
  bool send(const Endpoint& to, const std::string& identity, ByteView bytes);
  /// Ends connections whose key is another one now, or has gone.
  void use_keys(RobotKeys keys);
  /// Tells all clients that their connections end: they make new ones at once.
  void end_connections();
  Counters counters() const;

 private:
  using Ssl = std::unique_ptr<SSL, FreedBy<SSL_free>>;
  using ClientRandom = std::array<std::uint8_t, 32>;

  struct Connection {
    Ssl ssl;
    LocalAddress local;     ///< where its last datagram came to
    ClientRandom random{};  ///< of the ClientHello that began it
    TimePoint began{};
    std::string identity{};      ///< proven; empty during the handshake
    unsigned early_records = 0;  ///< encrypted ones during the handshake, which OpenSSL keeps
  };
  using Connections = std::map<Endpoint, Connection>;

  static int make_cookie(SSL* ssl, unsigned char* cookie, unsigned* size);
  static int check_cookie(SSL* ssl, const unsigned char* cookie, unsigned size);
  static unsigned find_key(SSL* ssl, const char* identity, unsigned char* key, unsigned max);

  std::array<std::uint8_t, 32> cookie(std::int64_t window) const;
  Ssl make_ssl() const;
  void on_datagram(const UdpSocket::Datagram& datagram);
  void on_hello(const UdpSocket::Datagram& hello);
  void begin(const UdpSocket::Datagram& hello, const ClientRandom& random);
  void advance(Connections::iterator handshake, ByteView bytes);
  void establish(Connections::iterator handshake);
  void read(Connections::iterator connection, const UdpSocket::Datagram& datagram);
  int read_record(Connection& connection, const UdpSocket::Datagram& record);
  void say_goodbye(Connections::iterator connection);
  void end(Connections::iterator connection);
  void give_up(const Endpoint& from, const std::string& why);
  void fail(Connections::iterator handshake, const std::string& why);
  void send_waiting(SSL* ssl, const LocalAddress& local, const Endpoint& to);
  void send_datagram(const LocalAddress& local, const Endpoint& to, ByteView bytes);
  void watch_handshakes();
  void on_time();

  const Receive receive_;
  const Tell tell_;
  RobotKeys keys_;
  std::unique_ptr<SSL_CTX, FreedBy<SSL_CTX_free>> context_;
  std::array<std::uint8_t, 32> cookie_secret_{};
  std::vector<std::shared_ptr<UdpSocket>> sockets_;
  Ssl listener_;                        ///< answers ClientHellos until one has a good cookie
  const Endpoint* helloing_ = nullptr;  ///< who sent it
  Connections handshakes_;              ///< places_ bounds them
  Connections established_;             ///< one for each identity at most
  std::map<std::string, Endpoint> endpoint_of_;  ///< of `established_`, by identity
  HandshakePlaces places_;
  std::array<std::uint8_t, 2048> plain_{};
  boost::asio::steady_timer timer_;  ///< runs while there are handshakes
  bool is_watching_ = false;
  LogThrottle failure_lines_;
  std::uint64_t handshakes_done_ = 0;
  std::uint64_t handshakes_failed_ = 0;
};

}  // namespace slamgw::mqttsn
