// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/mosquitto/mosquitto_link.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <mqtt_protocol.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <boost/asio/post.hpp>
#include <cerrno>
#include <cstring>

#include "daemon/mqtt/connect_failure.hpp"

namespace slamgw {
namespace {

using boost::system::error_code;

/// Whole seconds are libmosquitto's unit of time.
constexpr std::chrono::seconds tick{1};
/// Reason codes of the broker's DISCONNECT begin here; smaller numbers are the library's errors.
constexpr int first_reason = 0x80;
/// One call reads all that answers our own packets, and at least this many.
constexpr int packets_at_once = 1;
/// No packet id: the library refuses the filter itself.
constexpr int not_sent = 0;
/// Not a port: see start_client().
constexpr int no_port = -1;

/// Whether the broker has closed the connection, or its host has.
bool is_closing(int error) { return error == ECONNRESET || error == EPIPE; }

TimePoint now() { return std::chrono::steady_clock::now(); }

MosquittoLink& link_of(void* object) { return *static_cast<MosquittoLink*>(object); }

/// Why a connection did not come about; 0 when it stands. libmosquitto begins the TLS handshake
/// before that, and when the connection is refused at once, as on this host, its handshake has
/// taken the error from the socket.
int connection_error(int socket) {
  int error = 0;
  socklen_t size = sizeof error;
  getsockopt(socket, SOL_SOCKET, SO_ERROR, &error, &size);
  sockaddr_storage broker{};
  socklen_t broker_size = sizeof broker;
  const bool stands = getpeername(socket, reinterpret_cast<sockaddr*>(&broker), &broker_size) == 0;
  return error == 0 && !stands ? ECONNREFUSED : error;
}

}  // namespace

MosquittoLink::MosquittoLink(boost::asio::io_context& io, boost::asio::thread_pool& lane,
                             LinkOptions options, MqttLinkListener& listener)
    : io_(io),
      lane_(lane),
      options_(std::move(options)),
      settings_(options_.broker),
      listener_(listener),
      timeout_(io),
      tick_(io),
      socket_(io),
      writable_(io),
      properties_(options_.version, settings_.gateway_id) {
  [[maybe_unused]] static const int once = mosquitto_lib_init();
}

MosquittoLink::~MosquittoLink() = default;

void MosquittoLink::connect() {
  timeout_.expires_after(options_.timeout);
  timeout_.async_wait([self = shared_from_this()](error_code error) {
    if (error || self->is_abandoned_ || self->is_open_) return;
    self->fail({0, self->is_reached_ ? explain_stranger(self->settings_)
                                     : explain_no_connection(self->settings_, ETIMEDOUT)});
  });
  boost::asio::post(lane_, [self = shared_from_this()] { self->prepare(); });
}

void MosquittoLink::prepare() {
  HostAddresses addresses = resolve_host(settings_);
  std::unique_ptr<TlsClient> tls;
  if (settings_.tls) tls = std::make_unique<TlsClient>(settings_);
  boost::asio::post(io_, [self = shared_from_this(), addresses = std::move(addresses),
                          tls = std::move(tls)]() mutable {
    self->tls_ = std::move(tls);
    if (!self->is_abandoned_ && !self->has_failed_) self->open(addresses);
  });
}

void MosquittoLink::open(const HostAddresses& addresses) {
  if (addresses.literals.empty()) return fail({0, addresses.problem});
  if (tls_ && !tls_->problem().empty()) return fail({0, tls_->problem()});
  const std::size_t choice = options_.attempt % addresses.literals.size();
  const int result = start_client(addresses.literals[choice]);
  const int error = errno;
  if (result > 0) {
    after_call(result, error);
    return deliver();
  }
  adopt_socket();
  if (!is_over_) await_connection();
  deliver();
}

/// 0 when a connection is under way, else libmosquitto's error.
int MosquittoLink::start_client(const std::string& address) {
  const bool is_v5 = options_.version == MqttVersion::v5;
  client_.reset(mosquitto_new(settings_.client_id.c_str(), /*clean_session=*/true, this));
  mosquitto* client = client_.get();
  if (!client) return MOSQ_ERR_INVAL;
  mosquitto_int_option(client, MOSQ_OPT_PROTOCOL_VERSION,
                       is_v5 ? MQTT_PROTOCOL_V5 : MQTT_PROTOCOL_V311);
  mosquitto_int_option(client, MOSQ_OPT_TCP_NODELAY, 1);
  mosquitto_int_option(client, MOSQ_OPT_SEND_MAXIMUM, 0);  // the outbox has the window
  mosquitto_int_option(client, MOSQ_OPT_RECEIVE_MAXIMUM, 0);
  // Packets wait for write(), which sends them together; no thread is started by this.
  mosquitto_threaded_set(client, true);
  const LastWill& will = options_.will;
  if (!will.topic.empty())
    mosquitto_will_set(client, will.topic.c_str(), static_cast<int>(will.payload.size()),
                       will.payload.data(), static_cast<int>(will.qos), will.is_retained);
  if (settings_.credentials)
    mosquitto_username_pw_set(client, settings_.credentials->username.c_str(),
                              settings_.credentials->password.c_str());
  if (tls_) {
    mosquitto_void_option(client, MOSQ_OPT_SSL_CTX, tls_->context());
    mosquitto_int_option(client, MOSQ_OPT_SSL_CTX_WITH_DEFAULTS, 0);
  }
  set_callbacks();
  const int keep_alive =
      static_cast<int>(std::max(settings_.keep_alive, shortest_keep_alive).count());
  if (is_v5) {
    // libmosquitto 2.0 has no asynchronous connect with properties. This one keeps them for any
    // later connect, and then refuses the port.
    mosquitto_property* properties = nullptr;
    mosquitto_property_add_int32(&properties, MQTT_PROP_MAXIMUM_PACKET_SIZE,
                                 options_.max_inbound_octets);
    mosquitto_connect_bind_v5(client, address.c_str(), no_port, keep_alive, nullptr, properties);
    mosquitto_property_free_all(&properties);
  }
  errno = 0;
  return mosquitto_connect_async(client, address.c_str(), settings_.port, keep_alive);
}

void MosquittoLink::set_callbacks() {
  mosquitto* client = client_.get();
  mosquitto_connect_v5_callback_set(
      client, [](mosquitto*, void* object, int code, int, const mosquitto_property* said) {
        const BrokerLimits limits = code == 0 ? limits_of(said) : BrokerLimits{};
        link_of(object).events_.push_back(Answered{code, limits});
      });
  mosquitto_disconnect_v5_callback_set(
      client, [](mosquitto*, void* object, int reason, const mosquitto_property*) {
        MosquittoLink& link = link_of(object);
        link.after_call(reason == 0 ? MOSQ_ERR_CONN_LOST : reason, errno);
      });
  mosquitto_publish_v5_callback_set(
      client, [](mosquitto*, void* object, int id, int reason, const mosquitto_property*) {
        link_of(object).events_.push_back(Published{id, reason});
      });
  mosquitto_subscribe_callback_set(
      client, [](mosquitto*, void* object, int id, int count, const int* granted) {
        link_of(object).events_.push_back(Subscribed{id, count > 0 && granted[0] < first_reason});
      });
  mosquitto_message_v5_callback_set(
      client, [](mosquitto*, void* object, const mosquitto_message* message,
                 const mosquitto_property* properties) {
        const auto* payload = static_cast<const std::uint8_t*>(message->payload);
        link_of(object).events_.push_back(
            Arrived{{message->topic, Bytes(payload, payload + message->payloadlen),
                     static_cast<Qos>(message->qos), message->retain},
                    user_properties_of(properties)});
      });
  // Until the connection is up: the library makes a text of each packet for it.
  mosquitto_log_callback_set(client, [](mosquitto*, void* object, int level, const char* text) {
    if (level == MOSQ_LOG_ERR) link_of(object).last_error_ = text;
  });
}

void MosquittoLink::adopt_socket() {
  const int descriptor = mosquitto_socket(client_.get());
  fcntl(descriptor, F_SETFD, FD_CLOEXEC);
  duplicate(descriptor, socket_);
}

/// False when the process may not have more; the connection ends then.
bool MosquittoLink::duplicate(int descriptor, boost::asio::posix::stream_descriptor& to) {
  const int duplicate = fcntl(descriptor, F_DUPFD_CLOEXEC, 0);
  if (duplicate < 0) {
    after_call(MOSQ_ERR_ERRNO, errno);
    return false;
  }
  to.assign(duplicate);
  return true;
}

/// `then` is called once, unless the link is abandoned before.
template <class Then>
void MosquittoLink::when_writable(Then then) {
  if (!duplicate(socket_.native_handle(), writable_)) return;
  writable_.async_wait(boost::asio::posix::descriptor_base::wait_write,
                       [self = shared_from_this(), then](error_code error) {
                         if (error || self->is_abandoned_) return;
                         self->writable_.close();
                         then(*self);
                       });
}

void MosquittoLink::await_connection() {
  when_writable([](MosquittoLink& link) { link.on_connection(); });
}

void MosquittoLink::on_connection() {
  const int error = connection_error(socket_.native_handle());
  if (is_closing(error)) return fail(explain_failure({MOSQ_ERR_ERRNO, error}));
  if (error != 0) return fail({0, explain_no_connection(settings_, error)});
  is_reached_ = true;
  on_readable();  // CONNECT, or the TLS handshake
  if (is_over_ || is_abandoned_) return;
  await_readable();
  await_tick();
}

void MosquittoLink::await_readable() {
  socket_.async_wait(boost::asio::posix::descriptor_base::wait_read,
                     [self = shared_from_this()](error_code error) {
                       if (error || self->is_abandoned_) return;
                       self->on_readable();
                       if (!self->is_over_ && !self->is_abandoned_) self->await_readable();
                     });
}

void MosquittoLink::await_writable() {
  if (writable_.is_open()) return;
  when_writable([](MosquittoLink& link) {
    if (link.is_over_) return;
    link.write();
    link.deliver();
  });
}

void MosquittoLink::on_readable() {
  if (is_over_) return;
  errno = 0;
  const int result = mosquitto_loop_read(client_.get(), packets_at_once);
  after_call(result, errno);
  if (tls_ && !is_open_) watch_handshake();
  deliver();
  if (is_abandoned_ || is_over_ || !mosquitto_want_write(client_.get())) return;
  write();
  deliver();
}

/// libmosquitto 2.0.11 goes on for ever with a handshake whose connection has broken.
void MosquittoLink::watch_handshake() {
  if (is_over_ || tls_->has_shaken_hands()) return;
  char first = 0;
  const auto got = recv(socket_.native_handle(), &first, 1, MSG_PEEK | MSG_DONTWAIT);
  if (got == 0) after_call(MOSQ_ERR_CONN_LOST, 0);
  if (got < 0 && errno != EAGAIN) after_call(MOSQ_ERR_ERRNO, errno);
}

/// Keep-alive. A silent broker is left by Upstream.
void MosquittoLink::await_tick() {
  tick_.expires_after(tick);
  tick_.async_wait([self = shared_from_this()](error_code error) {
    if (error || self->is_abandoned_ || self->is_over_) return;
    self->on_tick();
    if (!self->is_over_ && !self->is_abandoned_) self->await_tick();
  });
}

void MosquittoLink::on_tick() {
  errno = 0;
  const int result = mosquitto_loop_misc(client_.get());
  after_call(result, errno);
  if (!is_over_) write();  // the ping
  deliver();
}

void MosquittoLink::publish(std::uint64_t sequence, const BrokerMessage& message) {
  if (is_over_) return;
  int id = 0;
  const bool is_text = message.topic.find('\0') == std::string::npos;  // C knows no such text
  const int result =
      is_text ? mosquitto_publish_v5(client_.get(), &id, message.topic.c_str(),
                                     static_cast<int>(message.payload.size()),
                                     message.payload.data(), static_cast<int>(message.qos),
                                     message.retain, properties_.of(message))
              : MOSQ_ERR_MALFORMED_UTF8;
  if (result == MOSQ_ERR_SUCCESS) {
    in_flight_.emplace_back(id, sequence);
    ++unwritten_;
  } else if (result == MOSQ_ERR_NO_CONN || result == MOSQ_ERR_NOMEM) {
    after_call(result, 0);
  } else {
    events_.push_back(NotSendable{sequence});
  }
  write_soon();
}

void MosquittoLink::subscribe(std::string filter) {
  if (is_over_) return;
  int packet_id = 0;
  const int result = mosquitto_subscribe(client_.get(), &packet_id, filter.c_str(), 0);
  if (result == MOSQ_ERR_SUCCESS) {
    subscribing_.emplace_back(packet_id, std::move(filter));
    ++unwritten_;
  } else if (result != MOSQ_ERR_NO_CONN && result != MOSQ_ERR_NOMEM) {
    subscribing_.emplace_back(not_sent, std::move(filter));
    events_.push_back(Subscribed{not_sent, false});
  }
  write_soon();
}

void MosquittoLink::unsubscribe(std::string filter) {
  if (is_over_) return;
  mosquitto_unsubscribe(client_.get(), nullptr, filter.c_str());
  write_soon();
}

/// After the present handler, so that what it publishes goes out together.
void MosquittoLink::write_soon() {
  if (std::exchange(is_write_due_, true)) return;
  boost::asio::post(io_, [self = shared_from_this()] {
    self->is_write_due_ = false;
    if (self->is_abandoned_) return;
    if (!self->is_over_) self->write();
    self->deliver();
  });
}

void MosquittoLink::write() {
  const bool are_many = std::exchange(unwritten_, 0) > 1;
  if (are_many) cork(1);
  errno = 0;
  const int result = mosquitto_loop_write(client_.get(), packets_at_once);
  const int error = errno;
  if (are_many) cork(0);
  after_call(result, error);
  if (!is_over_ && mosquitto_want_write(client_.get()) && is_open_) await_writable();
}

/// One segment for many packets, whose cost on the way to the broker is that of one.
void MosquittoLink::cork(int on) {
  setsockopt(socket_.native_handle(), IPPROTO_TCP, TCP_CORK, &on, sizeof on);
}

void MosquittoLink::after_call(int result, int error) {
  if (result == MOSQ_ERR_SUCCESS || result == MOSQ_ERR_CONN_PENDING || is_over_) return;
  is_over_ = true;
  events_.push_back(Ended{result, error});
}

std::string MosquittoLink::explain_loss(const Ended& end) const {
  if (end.result == session_taken_over) return explain_rival(settings_.client_id);
  if (end.result >= first_reason) return explain_connect_failure(end.result);
  if (end.result == MOSQ_ERR_KEEPALIVE) return "connection lost: the broker does not answer";
  if (end.result == MOSQ_ERR_ERRNO && !is_closing(end.error) && end.error != EPROTO)
    return fmt::format("connection lost: {}", std::strerror(end.error));
  return "connection lost";
}

/// No CONNACK has come.
ConnectFailure MosquittoLink::explain_failure(const Ended& end) const {
  const bool is_closed = end.result == MOSQ_ERR_CONN_LOST || is_closing(end.error);
  if (tls_) {
    if (const std::string problem = tls_->certificate_problem(); !problem.empty())
      return {0, problem};
    const std::string reason = last_error_.substr(last_error_.rfind(':') + 1);
    if (!reason.empty())
      return {0, tls_->has_shaken_hands() ? explain_tls_end(reason)
                                          : explain_handshake_failure(reason)};
    if (!tls_->has_shaken_hands())
      return {0, explain_handshake_failure("the broker closed the connection")};
    // The end of the connection may overtake the alert that says why.
    const bool is_cut = end.error == ECONNRESET || end.error == EPROTO;
    if (is_cut && !settings_.certificate_file)
      return {0, explain_tls_end(std::strerror(end.error)), ConnectAnswer::closed};
  }
  if (is_closed) return {0, explain_stranger(settings_), ConnectAnswer::closed};
  if (end.result == MOSQ_ERR_ERRNO) return {0, explain_no_connection(settings_, end.error)};
  // Some answer MQTT 5 with a CONNACK that only MQTT 3.1.1 allows.
  const bool is_garbled =
      end.result == MOSQ_ERR_PROTOCOL || end.result == MOSQ_ERR_MALFORMED_PACKET;
  return {0, explain_stranger(settings_),
          is_garbled ? ConnectAnswer::version_refused : ConnectAnswer::other};
}

void MosquittoLink::deliver() {
  while (!is_abandoned_ && !events_.empty()) {
    delivered_.swap(events_);
    for (Event& event : delivered_) {
      if (is_abandoned_) break;
      std::visit([this](auto& what) { handle(what); }, event);
    }
    delivered_.clear();
  }
}

void MosquittoLink::handle(const Answered& answer) {
  if (answer.code == 0) {
    is_open_ = true;
    timeout_.cancel();
    mosquitto_log_callback_set(client_.get(), nullptr);
    return listener_.on_connected(answer.limits);
  }
  fail({answer.code, explain_connect_failure(answer.code),
        is_version_refusal(answer.code) ? ConnectAnswer::version_refused : ConnectAnswer::other,
        is_not_authorised(answer.code)});
}

void MosquittoLink::handle(const Ended& end) {
  if (!is_open_) return fail(explain_failure(end));
  listener_.on_lost(explain_loss(end), end.result == session_taken_over);
}

void MosquittoLink::handle(const Published& published) {
  const auto found = std::find_if(in_flight_.begin(), in_flight_.end(), [&](const auto& each) {
    return each.first == published.packet_id;
  });
  if (found == in_flight_.end()) return;
  const std::uint64_t sequence = found->second;
  in_flight_.erase(found);
  if (published.reason < first_reason) return listener_.on_published(sequence);
  listener_.on_publish_refused(sequence,
                               {published.reason, explain_publish_refusal(published.reason)});
}

void MosquittoLink::handle(const Subscribed& subscribed) {
  const auto found = std::find_if(subscribing_.begin(), subscribing_.end(), [&](const auto& each) {
    return each.first == subscribed.packet_id;
  });
  if (found == subscribing_.end()) return;
  const std::string filter = std::move(found->second);
  subscribing_.erase(found);
  listener_.on_subscribe_result(filter, subscribed.granted);
}

void MosquittoLink::handle(Arrived& arrived) {
  options_.on_message(std::move(arrived.message), arrived.said);
}

void MosquittoLink::handle(const NotSendable& not_sendable) {
  listener_.on_publish_refused(
      not_sendable.sequence,
      {MQTT_RC_TOPIC_NAME_INVALID, explain_publish_refusal(MQTT_RC_TOPIC_NAME_INVALID)});
}

void MosquittoLink::fail(ConnectFailure failure) {
  if (std::exchange(has_failed_, true)) return;
  listener_.on_connect_failed(std::move(failure));
}

void MosquittoLink::abandon(bool is_orderly) {
  is_abandoned_ = true;
  timeout_.cancel();
  tick_.cancel();
  if (writable_.is_open()) writable_.close();
  if (socket_.is_open()) goodbye_socket_ = socket_.release();
  if (!is_orderly || is_over_ || !is_open_) {
    const linger at_once{1, 0};
    setsockopt(goodbye_socket_, SOL_SOCKET, SO_LINGER, &at_once, sizeof at_once);
    client_.reset();
    if (goodbye_socket_ >= 0) ::close(goodbye_socket_);
    return;
  }
  boost::asio::post(lane_, [self = shared_from_this()] { self->disconnect_and_wait(); });
}

/// Waits until the broker has read all: it has closed its side too. A socket that is closed with
/// something unread in it ends with a reset, which may overtake what was written.
void MosquittoLink::disconnect_and_wait() {
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

std::shared_ptr<MqttLink> make_mosquitto_link(boost::asio::io_context& io,
                                              boost::asio::thread_pool& lane, LinkOptions options,
                                              MqttLinkListener& listener) {
  return std::make_shared<MosquittoLink>(io, lane, std::move(options), listener);
}

}  // namespace slamgw
