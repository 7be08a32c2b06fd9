// SPDX-License-Identifier: Apache-2.0
// A DTLS client with OpenSSL's library. A test may lose, reorder and repeat its datagrams.
#pragma once

#include <openssl/err.h>
#include <openssl/ssl.h>

#include <algorithm>
#include <boost/asio/ip/udp.hpp>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "tests/mqttsn_udp/io/udp_rig.hpp"

namespace slamgw::mqttsn {

/// Faults of the network between a client and the gateway.
struct Network {
  double loss = 0;
  bool reorders = false;  ///< swaps each pair of datagrams to the gateway
  unsigned seed = 1;
  bool packs = false;              ///< sends a flight of the handshake as one datagram
  bool loses_last_flight = false;  ///< of the gateway, once
};

class DtlsClient {
 public:
  using udp = boost::asio::ip::udp;

  DtlsClient(UdpRig& rig, std::string identity, Bytes key, Network network = {},
             const std::string& suites = "PSK-AES128-GCM-SHA256", udp::endpoint local = {})
      : rig_(rig),
        identity_(std::move(identity)),
        key_(std::move(key)),
        network_(network),
        random_(network.seed),
        socket_(rig.io, udp::v4()),
        context_(SSL_CTX_new(DTLS_client_method())),
        ssl_(nullptr) {
    if (local.port() != 0) socket_.set_option(boost::asio::socket_base::reuse_address(true));
    if (local != udp::endpoint()) socket_.bind(local);
    socket_.connect({boost::asio::ip::make_address("127.0.0.1"), rig.core.port(1)});
    socket_.non_blocking(true);
    EXPECT_EQ(SSL_CTX_set_cipher_list(context_.get(), suites.c_str()), 1);
    SSL_CTX_set_psk_client_callback(context_.get(), tell_key);
    SSL_CTX_set_app_data(context_.get(), this);
    begin();
  }
  DtlsClient(const DtlsClient&) = delete;
  DtlsClient& operator=(const DtlsClient&) = delete;

  /// Starts without a connection, as after a restart, on the same port.
  void begin() {
    ssl_.reset(SSL_new(context_.get()));
    SSL_set_bio(ssl_.get(), BIO_new(BIO_s_mem()), BIO_new(BIO_s_mem()));
    SSL_set_options(ssl_.get(), SSL_OP_NO_QUERY_MTU);
    SSL_set_mtu(ssl_.get(), 1200);
    SSL_set_connect_state(ssl_.get());
  }
  bool has_connection(std::chrono::milliseconds limit = test::patience) {
    return test::eventually(
        rig_.io, [this] { return step() == 1; }, limit);
  }
  /// Makes one step of the handshake. Returns 1 when it is done.
  int step() {
    take_datagram();
    ERR_clear_error();
    const int result = SSL_do_handshake(ssl_.get());
    if (result != 1) DTLSv1_handle_timeout(ssl_.get());
    send_records();
    return result;
  }
  void send(const Packet& packet) {
    const Bytes bytes = encode(packet);
    EXPECT_EQ(SSL_write(ssl_.get(), bytes.data(), static_cast<int>(bytes.size())),
              static_cast<int>(bytes.size()));
    send_records();
  }
  /// Waits for a message. Returns "nothing" if none comes.
  std::string receive(std::chrono::milliseconds limit = test::patience) {
    Bytes buffer(2000);
    int size = 0;
    const auto has_come = [&] {
      take_datagram();
      ERR_clear_error();
      size = SSL_read(ssl_.get(), buffer.data(), static_cast<int>(buffer.size()));
      send_records();
      return size > 0;
    };
    if (!test::eventually(rig_.io, has_come, limit)) return "nothing";
    return describe_octets(ByteView(buffer).first(static_cast<std::size_t>(size)));
  }
  /// Repeats the packet until it is answered, as robots do. Returns the answer.
  std::string insist(const Packet& packet) {
    std::string answer = "nothing";
    for (int i = 0; i < 40 && answer == "nothing"; ++i) {
      send(packet);
      answer = receive(std::chrono::milliseconds(300));
    }
    return answer;
  }
  bool received_close_notify() {
    return test::eventually(rig_.io, [this] {
      std::uint8_t octet = 0;
      take_datagram();
      ERR_clear_error();
      SSL_read(ssl_.get(), &octet, 1);
      return (SSL_get_shutdown(ssl_.get()) & SSL_RECEIVED_SHUTDOWN) != 0;
    });
  }
  /// Sends all of its earlier datagrams again.
  void replay() {
    for (const Bytes& datagram : std::vector<Bytes>(sent)) transmit(datagram);
  }
  void transmit(const Bytes& datagram) {
    boost::system::error_code ignored;
    socket_.send(boost::asio::buffer(datagram), 0, ignored);
  }
  udp::endpoint local() const { return socket_.local_endpoint(); }
  const char* suite() const { return SSL_get_cipher_name(ssl_.get()); }

  std::vector<Bytes> sent;
  std::size_t longest_received = 0;
  unsigned last_flights = 0;  ///< datagrams of the gateway that begin with ChangeCipherSpec

 private:
  static unsigned tell_key(SSL* ssl, const char*, char* identity, unsigned max, std::uint8_t* key,
                           unsigned max_key) {
    const auto& client = *static_cast<DtlsClient*>(SSL_CTX_get_app_data(SSL_get_SSL_CTX(ssl)));
    if (client.identity_.size() >= max || client.key_.size() > max_key) return 0;
    client.identity_.copy(identity, max - 1);
    identity[client.identity_.size()] = '\0';
    std::copy(client.key_.begin(), client.key_.end(), key);
    return static_cast<unsigned>(client.key_.size());
  }
  bool is_lost() { return std::uniform_real_distribution<>(0, 1)(random_) < network_.loss; }
  /// Reads one datagram.
  void take_datagram() {
    Bytes buffer(2000);
    boost::system::error_code error;
    while (const std::size_t size = socket_.receive(boost::asio::buffer(buffer), 0, error)) {
      longest_received = std::max(longest_received, size);
      const bool is_last_flight = buffer[0] == SSL3_RT_CHANGE_CIPHER_SPEC;
      last_flights += is_last_flight ? 1 : 0;
      const bool is_first = is_last_flight && last_flights == 1;
      if (is_lost() || (is_first && network_.loses_last_flight)) continue;
      BIO_write(SSL_get_rbio(ssl_.get()), buffer.data(), static_cast<int>(size));
      return;
    }
  }
  /// Sends each record in its own datagram, or all in one.
  void send_records() {
    char* data = nullptr;
    const auto size = static_cast<std::size_t>(BIO_get_mem_data(SSL_get_wbio(ssl_.get()), &data));
    const Bytes all(data, data + size);
    (void)BIO_reset(SSL_get_wbio(ssl_.get()));
    if (network_.packs && !all.empty()) return send_record(all);
    for (std::size_t at = 0; at < all.size();) {
      const std::size_t octets = 13 + (std::size_t{all[at + 11]} << 8U | all[at + 12]);
      send_record(Bytes(all.begin() + static_cast<std::ptrdiff_t>(at),
                        all.begin() + static_cast<std::ptrdiff_t>(at + octets)));
      at += octets;
    }
    if (!held_.empty()) transmit(std::exchange(held_, {}));
  }
  void send_record(Bytes record) {
    sent.push_back(record);
    if (is_lost()) return;
    if (network_.reorders && held_.empty()) {
      held_ = std::move(record);
      return;
    }
    transmit(record);
    if (!held_.empty()) transmit(std::exchange(held_, {}));
  }

  struct Free {
    void operator()(SSL_CTX* context) const { SSL_CTX_free(context); }
    void operator()(SSL* ssl) const { SSL_free(ssl); }
  };

  UdpRig& rig_;
  const std::string identity_;
  const Bytes key_;
  const Network network_;
  std::mt19937 random_;
  udp::socket socket_;
  const std::unique_ptr<SSL_CTX, Free> context_;
  std::unique_ptr<SSL, Free> ssl_;
  Bytes held_;
};

}  // namespace slamgw::mqttsn
