// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/io/dtls_port.hpp"

#include <fmt/format.h>
#include <openssl/err.h>
#include <openssl/evp.h>
#include <openssl/hmac.h>
#include <openssl/rand.h>

#include <algorithm>
#include <stdexcept>
#include <utility>

#include "adapters/mqttsn_udp/clients/handshake_places.hpp"
#include "adapters/mqttsn_udp/limits.hpp"
#include "daemon/runtime/machine_driver.hpp"

namespace slamgw::mqttsn {
namespace {

/// Forward secrecy is only for robots that offer nothing else. The smallest robots have CCM8.
constexpr const char* cipher_suites =
    "PSK-AES128-GCM-SHA256:ECDHE-PSK-CHACHA20-POLY1305:ECDHE-PSK-AES128-CBC-SHA256:"
    "PSK-AES128-CCM8:PSK-AES128-CCM";
constexpr std::chrono::milliseconds retransmission_tick{200};
/// A cookie is good for the rest of its window and for the next one.
constexpr std::chrono::seconds cookie_window{30};
/// A copy of a ClientHello is ignored for this long. A later copy begins another handshake, which
/// ends by itself; so a robot without good random numbers can start again.
constexpr std::chrono::seconds copies_are_late{10};
/// Retransmissions of a client's last flight bring a few; OpenSSL would keep a hundred.
constexpr unsigned max_early_records = 8;

// The header of a record (RFC 6347 section 4.1), and of the ClientHello in it (section 4.2.2).
constexpr std::size_t record_header_octets = 13;
constexpr std::size_t epoch_offset = 3;
constexpr std::size_t length_offset = 11;
constexpr std::uint8_t handshake_type = 22;
constexpr std::uint8_t client_hello_type = 1;
constexpr std::size_t random_offset = record_header_octets + 12 + 2;
/// Shorter ClientHellos are ignored, so that a HelloVerifyRequest is not longer than its request.
constexpr std::size_t min_hello_octets = record_header_octets + 12 + 3 + 32;

std::size_t read_u16(ByteView bytes, std::size_t at) {
  return static_cast<std::size_t>(bytes[at]) << 8U | bytes[at + 1];
}

bool is_client_hello(ByteView bytes) {
  return bytes.size() >= min_hello_octets && bytes[0] == handshake_type &&
         read_u16(bytes, epoch_offset) == 0 && bytes[record_header_octets] == client_hello_type;
}

/// Returns the size of the first record with its header; all that is left if it claims more.
std::size_t first_record(ByteView bytes) {
  if (bytes.size() < record_header_octets) return bytes.size();
  return std::min(bytes.size(), record_header_octets + read_u16(bytes, length_offset));
}

unsigned encrypted_records(ByteView bytes) {
  unsigned count = 0;
  for (; bytes.size() >= record_header_octets; bytes = bytes.subspan(first_record(bytes)))
    count += read_u16(bytes, epoch_offset) != 0 ? 1 : 0;
  return count;
}

void feed(SSL* ssl, ByteView bytes) {
  BIO_write(SSL_get_rbio(ssl), bytes.data(), static_cast<int>(bytes.size()));
}

/// Returns true for a record that is too short for the connection's cipher. OpenSSL 3.0 ends the
/// connection at such a record, which any sender can forge.
bool is_too_short(const SSL* ssl, ByteView record) {
  return record.size() < limits::max_dtls_record_octets - DTLS_get_data_mtu(ssl);
}

/// Allocates the buffers of a connection only while it is in use: they take 34 KiB.
class Buffers {
 public:
  explicit Buffers(SSL* ssl) : ssl_(ssl) {
    ERR_clear_error();
    SSL_alloc_buffers(ssl_);
  }
  ~Buffers() {
    SSL_free_buffers(ssl_);
    ERR_clear_error();
  }
  Buffers(const Buffers&) = delete;
  Buffers& operator=(const Buffers&) = delete;

 private:
  SSL* const ssl_;
};

std::string text_of(const Endpoint& endpoint) { return to_string(Peer{endpoint, {}}); }

/// Returns the identity that the client claims, before or after it has proven it.
std::string claimed_identity(const SSL* ssl) {
  const char* const identity = SSL_get_psk_identity(ssl);
  return identity ? std::string(identity).substr(0, limits::max_logged_id_octets) : std::string();
}

}  // namespace

DtlsPort::DtlsPort(boost::asio::io_context& io, RobotKeys keys, Receive receive, Report report)
    : receive_(std::move(receive)),
      report_(std::move(report)),
      keys_(std::move(keys)),
      context_(SSL_CTX_new(DTLS_server_method())),
      timer_(io) {
  SSL_CTX* const context = context_.get();
  const bool is_ready =
      context && RAND_bytes(cookie_secret_.data(), static_cast<int>(cookie_secret_.size())) == 1 &&
      SSL_CTX_set_min_proto_version(context, DTLS1_2_VERSION) == 1 &&
      SSL_CTX_set_max_proto_version(context, DTLS1_2_VERSION) == 1 &&
      SSL_CTX_set_cipher_list(context, cipher_suites) == 1;
  if (!is_ready) throw std::runtime_error("mqttsn.dtls: OpenSSL offers no DTLS 1.2 with keys");
  // With encrypt-then-MAC, OpenSSL 3.0 ends a connection at the first forged record.
  SSL_CTX_set_options(context, SSL_OP_COOKIE_EXCHANGE | SSL_OP_CIPHER_SERVER_PREFERENCE |
                                   SSL_OP_NO_QUERY_MTU | SSL_OP_NO_RENEGOTIATION |
                                   SSL_OP_NO_TICKET | SSL_OP_NO_ENCRYPT_THEN_MAC);
  SSL_CTX_set_session_cache_mode(context, SSL_SESS_CACHE_OFF);
  SSL_CTX_set_app_data(context, this);
  SSL_CTX_set_cookie_generate_cb(context, make_cookie);
  SSL_CTX_set_cookie_verify_cb(context, check_cookie);
  SSL_CTX_set_psk_server_callback(context, find_key);
}

DtlsPort::Ssl DtlsPort::make_ssl() const {
  Ssl ssl(SSL_new(context_.get()));
  if (!ssl) throw std::bad_alloc();
  SSL_set_bio(ssl.get(), BIO_new(BIO_s_mem()), BIO_new(BIO_s_mem()));
  SSL_set_mtu(ssl.get(), static_cast<long>(limits::max_dtls_record_octets));
  SSL_set_accept_state(ssl.get());
  return ssl;
}

/// Returns the cookie of the client whose ClientHello is being read. Only a client that receives at
/// that address can know it.
std::array<std::uint8_t, 32> DtlsPort::cookie(std::int64_t window) const {
  ByteWriter who;
  who.write(ByteView(hello_sender_->address)).write_u16_be(hello_sender_->port);
  who.write_u32_le(hello_sender_->scope_id).write_u64_le(static_cast<std::uint64_t>(window));
  std::array<std::uint8_t, 32> cookie{};
  HMAC(EVP_sha256(), cookie_secret_.data(), static_cast<int>(cookie_secret_.size()),
       who.bytes().data(), who.bytes().size(), cookie.data(), nullptr);
  return cookie;
}

namespace {

DtlsPort& port_of(const SSL* ssl) {
  return *static_cast<DtlsPort*>(SSL_CTX_get_app_data(SSL_get_SSL_CTX(ssl)));
}

std::int64_t window_now() { return read_clocks().mono.time_since_epoch() / cookie_window; }

}  // namespace

int DtlsPort::make_cookie(SSL* ssl, unsigned char* cookie, unsigned* size) {
  const auto made = port_of(ssl).cookie(window_now());
  std::copy(made.begin(), made.end(), cookie);
  *size = made.size();
  return 1;
}

int DtlsPort::check_cookie(SSL* ssl, const unsigned char* cookie, unsigned size) {
  const DtlsPort& port = port_of(ssl);
  if (!port.hello_sender_) return 1;  // it was checked when the handshake began
  const auto is_of = [&](std::int64_t window) {
    const auto wanted = port.cookie(window);
    return size == wanted.size() && CRYPTO_memcmp(cookie, wanted.data(), wanted.size()) == 0;
  };
  return is_of(window_now()) || is_of(window_now() - 1) ? 1 : 0;
}

unsigned DtlsPort::find_key(SSL* ssl, const char* identity, unsigned char* key, unsigned max) {
  const RobotKeys& keys = port_of(ssl).keys_;
  const auto known = keys.find(identity);
  if (known == keys.end() || known->second.size() > max) return 0;
  std::copy(known->second.begin(), known->second.end(), key);
  return static_cast<unsigned>(known->second.size());
}

void DtlsPort::add(std::shared_ptr<UdpSocket> socket) {
  const auto index = static_cast<std::uint8_t>(sockets_.size());
  sockets_.push_back(std::move(socket));
  sockets_.back()->start(std::bind_front(&DtlsPort::on_datagram, this), index);
}

/// A ClientHello does not change the connection that its address has: another one begins beside it
/// (RFC 6347 section 4.2.8). All other datagrams may belong to either.
void DtlsPort::on_datagram(const UdpSocket::Datagram& datagram) {
  if (datagram.bytes.empty() || datagram.is_truncated || is_multicast(datagram.to.address)) return;
  if (is_client_hello(datagram.bytes)) return on_hello(datagram);
  if (const auto found = established_.find(datagram.from); found != established_.end())
    read(found, datagram);
  const auto found = handshakes_.find(datagram.from);
  if (found == handshakes_.end()) return;
  found->second.local = datagram.to;
  found->second.early_records += encrypted_records(datagram.bytes);
  if (found->second.early_records <= max_early_records) advance(found, datagram.bytes);
}

void DtlsPort::on_hello(const UdpSocket::Datagram& hello) {
  const Endpoint& from = hello.from;
  ClientRandom random{};
  std::copy_n(hello.bytes.begin() + random_offset, random.size(), random.begin());
  const auto handshake = handshakes_.find(from);
  if (handshake != handshakes_.end() && handshake->second.random == random)
    return advance(handshake, hello.bytes);
  const auto connection = established_.find(from);
  const bool is_copy = connection != established_.end() && connection->second.random == random &&
                       read_clocks().mono - connection->second.began < copies_are_late;
  if (is_copy) return;
  if (!listener_) listener_ = make_ssl();
  ERR_clear_error();
  feed(listener_.get(), hello.bytes);
  const std::unique_ptr<BIO_ADDR, FreedBy<BIO_ADDR_free>> unused(BIO_ADDR_new());
  hello_sender_ = &from;
  const int result = DTLSv1_listen(listener_.get(), unused.get());
  hello_sender_ = nullptr;
  if (result > 0) return begin(hello, random);
  send_waiting(listener_.get(), hello.to, from);
  BIO_reset(SSL_get_rbio(listener_.get()));
  if (result < 0) listener_.reset();
  ERR_clear_error();
}

/// Begins a handshake with a client that receives at its address: its cookie shows this.
void DtlsPort::begin(const UdpSocket::Datagram& hello, const ClientRandom& random) {
  const Endpoint& from = hello.from;
  handshakes_failed_ += handshakes_.erase(from);  // it has started again
  if (const auto gone = find_handshake_to_end(handshakes_, from.address))
    fail(handshakes_.find(*gone), "it lost its place to another handshake");
  const auto begun =
      handshakes_
          .emplace(from, Connection{std::move(listener_), hello.to, random, read_clocks().mono})
          .first;
  advance(begun, {});
  watch_handshakes();
}

void DtlsPort::advance(Connections::iterator handshake, ByteView bytes) {
  SSL* const ssl = handshake->second.ssl.get();
  ERR_clear_error();
  if (!bytes.empty()) feed(ssl, bytes);
  const int result = SSL_accept(ssl);
  const int error = SSL_get_error(ssl, result);
  send_waiting(ssl, handshake->second.local, handshake->first);
  ERR_clear_error();
  if (result == 1) return establish(handshake);
  if (error != SSL_ERROR_WANT_READ) fail(handshake, "it was refused");
}

/// Makes the newest connection of an identity the robot's, and ends its former one.
void DtlsPort::establish(Connections::iterator handshake) {
  const Endpoint from = handshake->first;
  Connection connection = std::move(handshake->second);
  handshakes_.erase(handshake);
  ++handshakes_done_;
  connection.identity = claimed_identity(connection.ssl.get());
  if (const auto former = established_.find(from); former != established_.end()) end(former);
  if (const auto place = endpoint_of_.find(connection.identity); place != endpoint_of_.end())
    end(established_.find(place->second));
  endpoint_of_[connection.identity] = from;
  const LocalAddress local = connection.local;
  const auto established = established_.emplace(from, std::move(connection)).first;
  read(established, {.from = from, .to = local, .bytes = {}});
}

void DtlsPort::read(Connections::iterator connection, const UdpSocket::Datagram& datagram) {
  int error = SSL_ERROR_WANT_READ;
  {
    const Buffers buffers(connection->second.ssl.get());
    ByteView left = datagram.bytes;
    do {
      UdpSocket::Datagram record = datagram;
      record.bytes = left.first(first_record(left));
      left = left.subspan(record.bytes.size());
      error = read_record(connection->second, record);
    } while (!left.empty() && error == SSL_ERROR_WANT_READ);
    send_waiting(connection->second.ssl.get(), connection->second.local, connection->first);
  }
  if (error != SSL_ERROR_WANT_READ) end(connection);
}

/// Reads one record at a time: OpenSSL drops what follows a record that it does not take, and the
/// repetition of a client's last flight begins with such records. Only a genuine record sets the
/// local address, to which the client writes.
int DtlsPort::read_record(Connection& connection, const UdpSocket::Datagram& record) {
  SSL* const ssl = connection.ssl.get();
  const std::string identity = connection.identity;
  if (!record.bytes.empty() && is_too_short(ssl, record.bytes)) return SSL_ERROR_WANT_READ;
  if (!record.bytes.empty()) feed(ssl, record.bytes);
  int count = 0;
  while ((count = SSL_read(ssl, plain_.data(), static_cast<int>(plain_.size()))) > 0) {
    UdpSocket::Datagram inner = record;
    inner.bytes = ByteView(plain_.data(), static_cast<std::size_t>(count));
    connection.local = record.to;
    receive_(inner, identity);
    ERR_clear_error();
  }
  return SSL_get_error(ssl, count);
}

bool DtlsPort::send(const Endpoint& to, const std::string& identity, ByteView bytes) {
  const auto found = established_.find(to);
  if (found == established_.end() || found->second.identity != identity) return false;
  constexpr std::size_t longest = limits::max_dtls_record_octets - limits::max_dtls_overhead_octets;
  if (bytes.empty() || bytes.size() > longest) return false;
  SSL* const ssl = found->second.ssl.get();
  const Buffers buffers(ssl);
  const int size = static_cast<int>(bytes.size());
  const bool is_sent = SSL_write(ssl, bytes.data(), size) == size;
  send_waiting(ssl, found->second.local, to);
  return is_sent;
}

void DtlsPort::use_keys(RobotKeys keys) {
  if (keys == keys_) return;  // handshakes go on
  std::vector<Endpoint> ended;
  for (const auto& [from, connection] : established_) {
    const auto key = keys.find(connection.identity);
    const auto former = keys_.find(connection.identity);
    if (key == keys.end() || former == keys_.end() || key->second != former->second)
      ended.push_back(from);
  }
  keys_ = std::move(keys);
  for (const Endpoint& from : ended) say_goodbye(established_.find(from));
  handshakes_failed_ += handshakes_.size();
  handshakes_.clear();  // a robot begins again by itself
}

void DtlsPort::end_connections() {
  while (!established_.empty()) say_goodbye(established_.begin());
}

void DtlsPort::say_goodbye(Connections::iterator connection) {
  {
    SSL* const ssl = connection->second.ssl.get();
    const Buffers buffers(ssl);
    SSL_shutdown(ssl);
    send_waiting(ssl, connection->second.local, connection->first);
  }
  end(connection);
}

void DtlsPort::end(Connections::iterator connection) {
  endpoint_of_.erase(connection->second.identity);
  established_.erase(connection);
}

void DtlsPort::fail(Connections::iterator handshake, const std::string& why) {
  const Endpoint from = handshake->first;
  const std::string identity = claimed_identity(handshake->second.ssl.get());
  const bool has_key = keys_.contains(identity);
  handshakes_.erase(handshake);
  ++handshakes_failed_;
  const auto times = failure_lines_.on_event(read_clocks().mono);
  if (!times) return;
  std::string reason = why;
  if (has_key) reason = fmt::format("{}; does the robot have another key for '{}'?", why, identity);
  if (!identity.empty() && !has_key)
    reason = fmt::format("'{}' has no key (slam-gatewayctl key add)", identity);
  report_(Notice{.severity = Severity::notice,
                 .text = fmt::format("{} DTLS handshakes failed, the last one with {}: {}", *times,
                                     text_of(from), reason),
                 .robot = has_key ? identity : std::string(),
                 .is_proven = false});
}

/// Sends what OpenSSL has written, in as few datagrams as possible, each of whole records.
void DtlsPort::send_waiting(SSL* ssl, const LocalAddress& local, const Endpoint& to) {
  char* data = nullptr;
  const long size = BIO_get_mem_data(SSL_get_wbio(ssl), &data);
  ByteView left = as_bytes({data, static_cast<std::size_t>(std::max(size, 0L))});
  while (!left.empty()) {
    std::size_t octets = first_record(left);
    while (octets < left.size() &&
           octets + first_record(left.subspan(octets)) <= limits::max_dtls_record_octets)
      octets += first_record(left.subspan(octets));
    const ByteView records = left.first(octets);
    if (local.socket < sockets_.size() && sockets_[local.socket]->can_reach(to.address))
      sockets_[local.socket]->send_soon(to, local, Bytes(records.begin(), records.end()));
    left = left.subspan(octets);
  }
  BIO_reset(SSL_get_wbio(ssl));
}

void DtlsPort::watch_handshakes() {
  if (handshakes_.empty() || std::exchange(is_watching_, true)) return;
  timer_.after(retransmission_tick, [this] {
    is_watching_ = false;
    on_time();
  });
}

void DtlsPort::on_time() {
  const TimePoint now = read_clocks().mono;
  while (const auto overdue = find_overdue_handshake(handshakes_, now))
    fail(handshakes_.find(*overdue), "it was not finished in time");
  for (auto next = handshakes_.begin(); next != handshakes_.end();) {
    const auto handshake = next++;
    SSL* const ssl = handshake->second.ssl.get();
    ERR_clear_error();
    const long result = DTLSv1_handle_timeout(ssl);
    send_waiting(ssl, handshake->second.local, handshake->first);
    if (result < 0) fail(handshake, "the client does not answer");
  }
  ERR_clear_error();
  watch_handshakes();
}

Counters DtlsPort::counters() const {
  return {{"dtls_connections", established_.size()},
          {"dtls_handshakes", handshakes_done_},
          {"dtls_handshakes_failed", handshakes_failed_}};
}

}  // namespace slamgw::mqttsn
