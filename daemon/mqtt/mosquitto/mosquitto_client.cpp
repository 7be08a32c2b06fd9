// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/mosquitto/mosquitto_client.hpp"

#include <fcntl.h>
#include <mqtt_protocol.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <boost/asio/post.hpp>
#include <cerrno>
#include <utility>

#include "daemon/core/time.hpp"
#include "daemon/mqtt/mosquitto/publish_properties.hpp"
#include "daemon/runtime/loop_turn.hpp"

namespace slamgw {
namespace {

using boost::system::error_code;

/// One call reads all answers to our own packets, and at least this many packets.
constexpr int packets_at_once = 1;
/// Not a port: see MosquittoClient::start().
constexpr int no_port = -1;

TimePoint now() { return std::chrono::steady_clock::now(); }

/// Returns true when the connection was established at some time: it has measured a round trip.
bool was_established(int socket) {
  tcp_info info{};
  socklen_t size = sizeof info;
  return getsockopt(socket, IPPROTO_TCP, TCP_INFO, &info, &size) == 0 && info.tcpi_rtt > 0;
}

/// Returns the errno of a failed connection; 0 when it is established. libmosquitto begins the TLS
/// handshake earlier. When the connection is refused or closed at once, as on this host, the
/// handshake has taken the error from the socket.
int connection_error(int socket) {
  int error = 0;
  socklen_t size = sizeof error;
  getsockopt(socket, SOL_SOCKET, SO_ERROR, &error, &size);
  sockaddr_storage broker{};
  socklen_t broker_size = sizeof broker;
  const bool stands = getpeername(socket, reinterpret_cast<sockaddr*>(&broker), &broker_size) == 0;
  if (error != 0 || stands) return error;
  return was_established(socket) ? ECONNRESET : ECONNREFUSED;
}

/// Returns true for a descriptor that robots' sessions leave to the rest of the daemon: the store,
/// the control socket, its own connection. The kernel gives the lowest free number.
bool reaches_reserve(int descriptor) {
  constexpr rlim_t reserve = 256;
  rlimit limit{};
  getrlimit(RLIMIT_NOFILE, &limit);
  return static_cast<rlim_t>(descriptor) >= limit.rlim_cur - std::min(reserve, limit.rlim_cur / 4);
}

/// The socket pair of a new client. libmosquitto 2.0 writes an octet for each packet to it, which a
/// loop like ours never reads. That takes 215 KiB of the kernel's memory for each client, unless
/// the buffer is small. The library also leaves the pair open across exec().
class SocketPair {
 public:
  /// Finds the numbers that the next pair gets; another thread may take them first.
  SocketPair() {
    for (int& each : expected_) each = fcntl(0, F_DUPFD_CLOEXEC, 0);
    for (const int each : expected_)
      if (each >= 0) ::close(each);
  }
  /// Shrinks the buffers and closes the pair on exec(), if the descriptors look like the library's.
  void shrink() const {
    for (const int each : expected_) {
      int domain = 0;
      socklen_t size = sizeof domain;
      const bool is_local =
          getsockopt(each, SOL_SOCKET, SO_DOMAIN, &domain, &size) == 0 && domain == AF_UNIX;
      if (!is_local || fcntl(each, F_GETFD) != 0) continue;
      const int smallest = 1;
      setsockopt(each, SOL_SOCKET, SO_SNDBUF, &smallest, sizeof smallest);
      fcntl(each, F_SETFD, FD_CLOEXEC);
    }
  }

 private:
  std::array<int, 2> expected_{};
};

}  // namespace

MosquittoClient::MosquittoClient(boost::asio::io_context& io)
    : io_(io), socket_(io), writable_(io) {
  [[maybe_unused]] static const int once = mosquitto_lib_init();
}

MosquittoClient::~MosquittoClient() = default;

// --- The connection ------------------------------------------------------------------------------

void MosquittoClient::open(const Opening& opening, std::shared_ptr<const TlsClient> tls) {
  tls_ = std::move(tls);
  is_v5_ = opening.version == MqttVersion::v5;
  errno = 0;
  const int result = start(opening);
  if (result > 0) {
    is_reached_ = result == MOSQ_ERR_TLS;  // the broker has answered within the call
    after_call(result, errno);
  } else {
    adopt_socket(opening.spares_descriptors);
  }
  if (is_over_) return write_soon();
  when_writable([](MosquittoClient& client) { client.on_connection(); });
}

/// Returns 0 when a connection is under way, else libmosquitto's error.
int MosquittoClient::start(const Opening& opening) {
  const SocketPair pair;
  client_.reset(mosquitto_new(opening.client_id.c_str(), opening.is_clean, this));
  mosquitto* client = client_.get();
  if (!client) return MOSQ_ERR_INVAL;
  pair.shrink();
  mosquitto_int_option(client, MOSQ_OPT_PROTOCOL_VERSION,
                       is_v5_ ? MQTT_PROTOCOL_V5 : MQTT_PROTOCOL_V311);
  mosquitto_int_option(client, MOSQ_OPT_TCP_NODELAY, 1);
  mosquitto_int_option(client, MOSQ_OPT_SEND_MAXIMUM, 0);  // the outbox limits what is under way
  mosquitto_int_option(client, MOSQ_OPT_RECEIVE_MAXIMUM, opening.receive_maximum.value_or(0));
  // Packets wait for write(), which sends them together; no thread is started by this.
  mosquitto_threaded_set(client, true);
  if (const LastWill* will = opening.will; will && !will->topic.empty())
    mosquitto_will_set(client, will->topic.c_str(), static_cast<int>(will->payload.size()),
                       will->payload.data(), static_cast<int>(will->qos), will->is_retained);
  const BrokerSettings& broker = opening.broker;
  if (broker.credentials)
    mosquitto_username_pw_set(client, broker.credentials->username.c_str(),
                              broker.credentials->password.c_str());
  if (tls_) {
    mosquitto_void_option(client, MOSQ_OPT_SSL_CTX, tls_->context());
    mosquitto_int_option(client, MOSQ_OPT_SSL_CTX_WITH_DEFAULTS, 0);
  }
  set_callbacks();
  const int keep_alive = static_cast<int>(std::max(broker.keep_alive, shortest_keep_alive).count());
  if (is_v5_) {
    // libmosquitto 2.0 has no asynchronous connect with properties. This call keeps them for any
    // later connect, and then refuses the port.
    mosquitto_property* properties = nullptr;
    if (opening.session_expiry_s != 0)
      mosquitto_property_add_int32(&properties, MQTT_PROP_SESSION_EXPIRY_INTERVAL,
                                   opening.session_expiry_s);
    mosquitto_property_add_int32(&properties, MQTT_PROP_MAXIMUM_PACKET_SIZE,
                                 opening.max_inbound_octets);
    if (opening.receive_maximum)
      mosquitto_property_add_int16(&properties, MQTT_PROP_RECEIVE_MAXIMUM,
                                   *opening.receive_maximum);
    mosquitto_connect_bind_v5(client, opening.address.c_str(), no_port, keep_alive, nullptr,
                              properties);
    mosquitto_property_free_all(&properties);
  }
  errno = 0;
  const int result =
      mosquitto_connect_async(client, opening.address.c_str(), broker.port, keep_alive);
  // Mosquitto 2.0 sends more messages of QoS 2 than this client's CONNECT allows, and libmosquitto
  // would end the connection then. From CONNACK on the library counts with this number.
  mosquitto_int_option(client, MOSQ_OPT_RECEIVE_MAXIMUM, 0);
  return result;
}

void MosquittoClient::set_callbacks() {
  mosquitto* client = client_.get();
  mosquitto_connect_v5_callback_set(
      client, [](mosquitto*, void* object, int code, int flags, const mosquitto_property* said) {
        const BrokerLimits limits = code == 0 ? limits_of(said) : BrokerLimits{};
        of(object).events_.push_back(Connack{code, (flags & 1) != 0, limits});
      });
  mosquitto_disconnect_v5_callback_set(
      client, [](mosquitto*, void* object, int reason, const mosquitto_property*) {
        of(object).after_call(reason == 0 ? MOSQ_ERR_CONN_LOST : reason, errno);
      });
  mosquitto_publish_v5_callback_set(
      client, [](mosquitto*, void* object, int id, int reason, const mosquitto_property*) {
        of(object).events_.push_back(Confirmed{id, reason});
      });
  mosquitto_subscribe_callback_set(
      client, [](mosquitto*, void* object, int id, int count, const int* granted) {
        of(object).events_.push_back(Suback{id, count > 0 && granted[0] < first_reason});
      });
  mosquitto_unsubscribe_callback_set(client, [](mosquitto*, void* object, int id) {
    of(object).events_.push_back(Confirmed{id, 0});
  });
  mosquitto_message_v5_callback_set(
      client, [](mosquitto*, void* object, const mosquitto_message* message,
                 const mosquitto_property* properties) {
        // Its acknowledgement goes out together with what the message leads to, as a fence.
        if (message->qos > 0) ++of(object).unwritten_;
        const auto* payload = static_cast<const std::uint8_t*>(message->payload);
        of(object).events_.push_back(
            Arrived{{message->topic, Bytes(payload, payload + message->payloadlen),
                     static_cast<Qos>(message->qos), message->retain},
                    user_properties_of(properties),
                    subscriptions_of(properties)});
      });
  if (!tls_) return;
  // Removed when the connection is up, because the library formats a text for each packet.
  mosquitto_log_callback_set(client, [](mosquitto*, void* object, int level, const char* text) {
    if (level == MOSQ_LOG_ERR) of(object).last_error_ = text;
  });
}

void MosquittoClient::adopt_socket(bool spares_descriptors) {
  const int descriptor = mosquitto_socket(client_.get());
  fcntl(descriptor, F_SETFD, FD_CLOEXEC);
  if (!duplicate(descriptor, socket_)) return;
  if (spares_descriptors && reaches_reserve(socket_.native_handle())) give_up(EMFILE);
}

/// Returns false, and ends the connection, when the process may not have more descriptors.
bool MosquittoClient::duplicate(int descriptor, boost::asio::posix::stream_descriptor& to) {
  const int copy = fcntl(descriptor, F_DUPFD_CLOEXEC, 0);
  if (copy < 0)
    give_up(errno);
  else
    to.assign(copy);
  return copy >= 0;
}

/// Calls `then` once, when the socket can be written, unless the connection ends first.
template <class Then>
void MosquittoClient::when_writable(Then then) {
  if (!duplicate(socket_.native_handle(), writable_)) return write_soon();
  writable_.async_wait(boost::asio::posix::descriptor_base::wait_write,
                       [self = shared_from_this(), then](error_code error) {
                         if (error || self->is_ended_) return;
                         self->writable_.close();
                         then(*self);
                       });
}

void MosquittoClient::on_connection() {
  if (const int error = connection_error(socket_.native_handle()); error != 0) {
    give_up(error);
    return deliver();
  }
  is_reached_ = true;
  on_readable();  // CONNECT, or the TLS handshake
  if (!is_over_ && !is_ended_) await_readable();
}

void MosquittoClient::await_readable() {
  socket_.async_wait(boost::asio::posix::descriptor_base::wait_read,
                     [self = shared_from_this()](error_code error) {
                       if (error || self->is_ended_) return;
                       LoopTurn::of(self->io_).run([&] { self->on_readable(); });
                       if (!self->is_over_ && !self->is_ended_) self->await_readable();
                     });
}

void MosquittoClient::on_readable() {
  if (is_over_) return;
  errno = 0;
  const int result = mosquitto_loop_read(client_.get(), packets_at_once);
  after_call(result, errno);
  if (tls_ && !is_open_ && !is_over_ && events_.empty()) watch_handshake();
  deliver();
  if (is_ended_ || is_over_ || !mosquitto_want_write(client_.get())) return;
  write();
  deliver();
}

/// Ends a handshake whose connection has broken: libmosquitto 2.0.11 would go on for ever.
void MosquittoClient::watch_handshake() {
  char first = 0;
  const auto got = recv(socket_.native_handle(), &first, 1, MSG_PEEK | MSG_DONTWAIT);
  if (got == 0) after_call(MOSQ_ERR_CONN_LOST, 0);
  if (got < 0 && errno != EAGAIN) give_up(errno);
}

void MosquittoClient::tick() {
  if (is_ended_ || is_over_ || !is_reached_) return deliver();
  errno = 0;
  const int result = mosquitto_loop_misc(client_.get());
  after_call(result, errno);
  if (!is_over_ && mosquitto_want_write(client_.get())) write();  // the ping
  deliver();
}

void MosquittoClient::write_soon() {
  if (std::exchange(is_write_due_, true)) return;
  LoopTurn::of(io_).at_end([self = shared_from_this()] {
    self->is_write_due_ = false;
    if (self->is_ended_) return;
    if (!self->is_over_) self->write();
    self->deliver();
  });
}

void MosquittoClient::write() {
  const bool was_due = std::exchange(is_write_due_, true);
  before_write();
  is_write_due_ = was_due;
  const bool are_many = std::exchange(unwritten_, 0) > 1;
  if (are_many) cork(1);
  errno = 0;
  const int result = mosquitto_loop_write(client_.get(), packets_at_once);
  const int error = errno;
  if (are_many) cork(0);
  after_call(result, error);
  if (is_over_ || !is_open_ || writable_.is_open() || !mosquitto_want_write(client_.get())) return;
  when_writable([](MosquittoClient& client) {
    if (!client.is_over_) client.write();
    client.deliver();
  });
}

/// Collects many packets into one TCP segment (1), or sends it (0): it costs as much as one packet.
void MosquittoClient::cork(int on) {
  setsockopt(socket_.native_handle(), IPPROTO_TCP, TCP_CORK, &on, sizeof on);
}

void MosquittoClient::after_call(int result, int error) {
  if (result == MOSQ_ERR_SUCCESS || result == MOSQ_ERR_CONN_PENDING || is_over_) return;
  is_over_ = true;
  events_.push_back(Ended{result, error});
}

void MosquittoClient::deliver() {
  const auto self = shared_from_this();  // a handler may drop this object
  while (!is_ended_ && !events_.empty()) {
    std::vector<Event> delivered;
    delivered.swap(events_);
    for (Event& event : delivered)
      if (!is_ended_) std::visit([this](auto& what) { report(what); }, event);
  }
}

void MosquittoClient::report(Connack& connack) {
  is_open_ = connack.code == 0;
  max_qos_ = connack.limits.max_qos;
  if (is_open_ && tls_) mosquitto_log_callback_set(client_.get(), nullptr);
  on_connack(connack);
}

// --- Requests ------------------------------------------------------------------------------------

std::optional<int> MosquittoClient::sent(int result, int packet_id) {
  if (result == MOSQ_ERR_NO_CONN || result == MOSQ_ERR_NOMEM) after_call(result, 0);
  write_soon();
  if (result != MOSQ_ERR_SUCCESS) return std::nullopt;
  ++unwritten_;
  return packet_id;
}

std::optional<int> MosquittoClient::publish(const std::string& topic, ByteView payload, Qos qos,
                                            bool is_retained,
                                            const mosquitto_property* properties) {
  if (is_over_) return std::nullopt;
  if (topic.find('\0') != std::string::npos) return std::nullopt;  // not possible in a C string
  int id = 0;
  const int result = mosquitto_publish_v5(
      client_.get(), &id, topic.c_str(), static_cast<int>(payload.size()), payload.data(),
      static_cast<int>(std::min(qos, max_qos_)), is_retained, properties);
  return sent(result, id);
}

std::optional<int> MosquittoClient::subscribe(const std::string& filter, Qos qos, int options,
                                              const mosquitto_property* properties) {
  if (is_over_) return std::nullopt;
  int id = 0;
  const int result = mosquitto_subscribe_v5(client_.get(), &id, filter.c_str(),
                                            static_cast<int>(qos), options, properties);
  const auto packet_id = sent(result, id);
  if (!packet_id) return packet_id;
  // A broker that answers none of them must not make this list grow.
  std::erase_if(subscribing_, [&](const auto& earlier) { return earlier.second == filter; });
  subscribing_.emplace_back(*packet_id, filter);
  return packet_id;
}

std::optional<int> MosquittoClient::unsubscribe(const std::string& filter) {
  if (is_over_) return std::nullopt;
  int id = 0;
  const int result = mosquitto_unsubscribe(client_.get(), &id, filter.c_str());
  return sent(result, id);
}

// --- The end -------------------------------------------------------------------------------------

void MosquittoClient::end(Farewell farewell) {
  is_ended_ = true;
  const bool says_goodbye = farewell == Farewell::disconnect || farewell == Farewell::forget;
  if (says_goodbye && is_open_ && !is_over_) {
    mosquitto_property* properties = nullptr;
    if (farewell == Farewell::forget && is_v5_)
      mosquitto_property_add_int32(&properties, MQTT_PROP_SESSION_EXPIRY_INTERVAL, 0);
    mosquitto_disconnect_v5(client_.get(), 0, properties);
    mosquitto_property_free_all(&properties);
    mosquitto_loop_write(client_.get(), packets_at_once);
  }
  if (farewell == Farewell::abort && socket_.is_open()) {
    const linger at_once{1, 0};
    setsockopt(socket_.native_handle(), SOL_SOCKET, SO_LINGER, &at_once, sizeof at_once);
    client_.reset();
  }
  if (writable_.is_open()) writable_.close();
  if (socket_.is_open()) socket_.close();
}

void MosquittoClient::leave(boost::asio::thread_pool& lane) {
  if (is_over_ || !is_open_) return end(Farewell::abort);
  is_ended_ = true;
  if (writable_.is_open()) writable_.close();
  goodbye_socket_ = socket_.release();
  boost::asio::post(lane, [self = shared_from_this()] { self->disconnect_and_wait(); });
}

/// Waits until the broker has closed its side, too, and so has read all. A socket that is closed
/// with unread data sends a reset, which may overtake the data that was written.
void MosquittoClient::disconnect_and_wait() {
  const TimePoint end = now() + goodbye_timeout;
  const auto left_ms = [end] {
    return static_cast<int>(std::max<std::int64_t>(
        0, std::chrono::duration_cast<std::chrono::milliseconds>(end - now()).count()));
  };
  mosquitto_disconnect_v5_callback_set(client_.get(), nullptr);
  mosquitto_publish_v5_callback_set(client_.get(), nullptr);
  mosquitto_disconnect_v5(client_.get(), 0, nullptr);
  while (mosquitto_socket(client_.get()) >= 0 && left_ms() > 0) {
    mosquitto_loop_write(client_.get(), packets_at_once);
    pollfd writable{goodbye_socket_, POLLOUT, 0};
    if (mosquitto_socket(client_.get()) >= 0) poll(&writable, 1, left_ms());
  }
  client_.reset();
  shutdown(goodbye_socket_, SHUT_WR);
  char ignored[4096];
  pollfd readable{goodbye_socket_, POLLIN, 0};
  while (poll(&readable, 1, left_ms()) > 0 &&
         recv(goodbye_socket_, ignored, sizeof ignored, 0) > 0) {
  }
  ::close(goodbye_socket_);
}

}  // namespace slamgw
