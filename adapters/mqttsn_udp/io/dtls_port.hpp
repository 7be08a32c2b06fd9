// SPDX-License-Identifier: Apache-2.0
// DTLS 1.2 with pre-shared keys (RFC 6347, RFC 4279) on its own UDP sockets. Passes on what it
// decrypts, with the identity that the client's key proves, and encrypts the answers. Knows nothing
// of MQTT-SN. I/O shell of OpenSSL; owned by MqttsnAdapter. Loop's thread only.
#pragma once

#include <openssl/ssl.h>
#include <boost/asio/io_context.hpp>

#include <array>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "adapters/mqttsn_udp/io/udp_socket.hpp"
#include "daemon/core/freed_by.hpp"
#include "daemon/core/log_throttle.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/robot_keys.hpp"
#include "daemon/runtime/timer.hpp"

namespace slamgw::mqttsn {

class DtlsPort {
 public:
  /// Called with `datagram`, whose octets are decrypted.
  using Receive =
      std::function<void(const UdpSocket::Datagram& datagram, const std::string& identity)>;
  using Report = std::function<void(Notice)>;

  /// `receive` may call send().
  DtlsPort(boost::asio::io_context& io, RobotKeys keys, Receive receive, Report report);
  DtlsPort(const DtlsPort&) = delete;
  DtlsPort& operator=(const DtlsPort&) = delete;

  /// Receives from this socket, too.
  void add(std::shared_ptr<UdpSocket> socket);
  const std::vector<std::shared_ptr<UdpSocket>>& sockets() const { return sockets_; }
  /// Call when the sockets are closed. Connections stay, and wait for new sockets.
  void forget_sockets() { sockets_.clear(); }

  /// Returns false if this client has no connection there, or if `bytes` do not fit a record.
  bool send(const Endpoint& to, const std::string& identity, ByteView bytes);
  /// Ends connections whose key has changed or is gone, and all handshakes.
  void use_keys(RobotKeys keys);
  /// Ends all connections with a close alert, so that clients make new ones at once.
  void end_connections();
  Counters counters() const;

 private:
  using Ssl = std::unique_ptr<SSL, FreedBy<SSL_free>>;
  using ClientRandom = std::array<std::uint8_t, 32>;

  struct Connection {
    Ssl ssl;
    LocalAddress local;     ///< to which its last datagram came
    ClientRandom random{};  ///< of the ClientHello that began it
    TimePoint began{};
    std::string identity{};      ///< proven; empty during the handshake
    unsigned early_records = 0;  ///< encrypted ones in the handshake, which OpenSSL keeps
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
  void fail(Connections::iterator handshake, const std::string& why);
  void send_waiting(SSL* ssl, const LocalAddress& local, const Endpoint& to);
  void watch_handshakes();
  void on_time();

  const Receive receive_;
  const Report report_;
  RobotKeys keys_;
  std::unique_ptr<SSL_CTX, FreedBy<SSL_CTX_free>> context_;
  std::array<std::uint8_t, 32> cookie_secret_{};
  std::vector<std::shared_ptr<UdpSocket>> sockets_;
  Ssl listener_;                            ///< answers ClientHellos until one has a valid cookie
  const Endpoint* hello_sender_ = nullptr;  ///< the sender of the ClientHello that is being read
  Connections handshakes_;                  ///< bounded by find_handshake_to_end()
  Connections established_;                 ///< at most one for each identity
  std::map<std::string, Endpoint> endpoint_of_;  ///< of `established_`, by identity
  std::array<std::uint8_t, 2048> plain_{};
  Timer timer_;  ///< runs while there are handshakes
  bool is_watching_ = false;
  LogThrottle failure_lines_;
  std::uint64_t handshakes_done_ = 0;
  std::uint64_t handshakes_failed_ = 0;
};

}  // namespace slamgw::mqttsn
