// SPDX-License-Identifier: Apache-2.0
#include "daemon/sessions/io/robot_link.hpp"

#include <fcntl.h>
#include <mqtt_protocol.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <boost/asio/post.hpp>
#include <cerrno>

#include "daemon/mqtt/connect_failure.hpp"
#include "daemon/mqtt/mosquitto/publish_properties.hpp"
#include "daemon/mqtt/mqtt_link.hpp"

namespace slamgw::sessions {
namespace {

using boost::system::error_code;

constexpr int first_reason = 0x80;  ///< MQTT's refusals; smaller numbers are libmosquitto's errors
constexpr int no_port = -1;         ///< see MosquittoLink::start_client()
constexpr int packets_at_once = 1;
constexpr int shortest_keep_alive_s = 5;
/// MQTT 5 section 3.8.3.1: no retained messages.
constexpr int retain_handling_never = 0x20;
/// A filter that no session has: to unsubscribe it changes nothing and is answered in its order.
constexpr const char* fence_filter = "slam-gateway/fence";

/// Descriptors that robots' sessions leave to the rest of the daemon: the store, the control
/// socket, its own connection. The kernel gives the lowest free number.
bool reaches_reserve(int descriptor) {
  constexpr rlim_t reserve = 256;
  rlimit limit{};
  getrlimit(RLIMIT_NOFILE, &limit);
  return static_cast<rlim_t>(descriptor) >= limit.rlim_cur - std::min(reserve, limit.rlim_cur / 4);
}

bool is_connected(int socket) {
  int error = 0;
  socklen_t size = sizeof error;
  getsockopt(socket, SOL_SOCKET, SO_ERROR, &error, &size);
  sockaddr_storage peer{};
  socklen_t peer_size = sizeof peer;
  return error == 0 && getpeername(socket, reinterpret_cast<sockaddr*>(&peer), &peer_size) == 0;
}

/// libmosquitto 2.0 writes an octet for each packet to a socket pair of its own, which a loop like
/// ours never reads: 215 KiB of the kernel's memory for each client, unless its buffer is small.
/// It also leaves the pair open across exec().
class SocketPair {
 public:
  /// The numbers that the next pair gets; another thread may take them first.
  SocketPair() {
    for (int& each : expected_) each = fcntl(0, F_DUPFD_CLOEXEC, 0);
    for (const int each : expected_)
      if (each >= 0) ::close(each);
  }
  /// Only what is what the library makes.
  void tame() const {
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

bool is_id_refusal(int code) {  // MQTT 3.1.1 section 3.2.2.3, MQTT 5 section 3.2.2.2
  return code == 2 || code == 5 || code == 0x85 || code == 0x87;
}

}  // namespace

RobotLink::RobotLink(RobotLinks& links, std::shared_ptr<const RobotLinks::Broker> broker,
                     std::string robot)
    : links_(links),
      broker_(std::move(broker)),
      robot_(std::move(robot)),
      socket_(links.io_),
      writable_(links.io_) {}

RobotLink::~RobotLink() = default;

// --- The connection ------------------------------------------------------------------------------

void RobotLink::open(const std::string& client_id, bool is_clean, const std::string& address,
                     TimePoint give_up_at) {
  give_up_at_ = give_up_at;
  const bool is_v5 = broker_->version == MqttVersion::v5;
  const SocketPair pair;
  client_.reset(mosquitto_new(client_id.c_str(), is_clean, this));
  mosquitto* client = client_.get();
  if (!client) return fail_to_open(errno);
  pair.tame();
  mosquitto_int_option(client, MOSQ_OPT_PROTOCOL_VERSION,
                       is_v5 ? MQTT_PROTOCOL_V5 : MQTT_PROTOCOL_V311);
  mosquitto_int_option(client, MOSQ_OPT_TCP_NODELAY, 1);
  mosquitto_int_option(client, MOSQ_OPT_RECEIVE_MAXIMUM, RobotLinks::receive_maximum);
  mosquitto_threaded_set(client, true);  // packets wait for write(); no thread is started by this
  const BrokerSettings& settings = broker_->settings;
  if (settings.credentials)
    mosquitto_username_pw_set(client, settings.credentials->username.c_str(),
                              settings.credentials->password.c_str());
  if (broker_->tls) {
    mosquitto_void_option(client, MOSQ_OPT_SSL_CTX, broker_->tls->context());
    mosquitto_int_option(client, MOSQ_OPT_SSL_CTX_WITH_DEFAULTS, 0);
  }
  set_callbacks();
  const int keep_alive =
      std::max(static_cast<int>(settings.keep_alive.count()), shortest_keep_alive_s);
  if (is_v5) {  // as in MosquittoLink::start_client()
    mosquitto_property* properties = nullptr;
    mosquitto_property_add_int32(&properties, MQTT_PROP_SESSION_EXPIRY_INTERVAL,
                                 RobotLinks::session_expiry_s);
    mosquitto_property_add_int32(&properties, MQTT_PROP_MAXIMUM_PACKET_SIZE,
                                 max_inbound_packet_octets);
    mosquitto_property_add_int16(&properties, MQTT_PROP_RECEIVE_MAXIMUM,
                                 RobotLinks::receive_maximum);
    mosquitto_connect_bind_v5(client, address.c_str(), no_port, keep_alive, nullptr, properties);
    mosquitto_property_free_all(&properties);
  }
  errno = 0;
  const int result = mosquitto_connect_async(client, address.c_str(), settings.port, keep_alive);
  if (result > 0) return fail_to_open(errno);
  const int descriptor = mosquitto_socket(client);
  fcntl(descriptor, F_SETFD, FD_CLOEXEC);
  if (!duplicate(descriptor, socket_)) return fail_to_open(errno);
  if (reaches_reserve(socket_.native_handle())) return fail_to_open(EMFILE);
  await_connection();
}

/// Reported after the call to RobotLinks::open().
void RobotLink::fail_to_open(int error) {
  error_ = error;
  is_over_ = true;
  write_soon();
}

/// False when the process may not have more descriptors.
bool RobotLink::duplicate(int descriptor, boost::asio::posix::stream_descriptor& to) const {
  const int copy = fcntl(descriptor, F_DUPFD_CLOEXEC, 0);
  if (copy < 0) return false;
  to.assign(copy);
  return true;
}

void RobotLink::set_callbacks() {
  mosquitto* client = client_.get();
  mosquitto_connect_v5_callback_set(
      client, [](mosquitto*, void* object, int code, int flags, const mosquitto_property*) {
        of(object).events_.push_back(Answered{code, (flags & 1) != 0});
      });
  mosquitto_disconnect_v5_callback_set(
      client,
      [](mosquitto*, void* object, int, const mosquitto_property*) { of(object).is_over_ = true; });
  mosquitto_subscribe_callback_set(
      client, [](mosquitto*, void* object, int id, int count, const int* granted) {
        of(object).events_.push_back(Subscribed{id, count > 0 && granted[0] < first_reason});
      });
  mosquitto_unsubscribe_callback_set(client, [](mosquitto*, void* object, int id) {
    of(object).events_.push_back(Confirmed{id});
  });
  mosquitto_publish_callback_set(client, [](mosquitto*, void* object, int id) {
    of(object).events_.push_back(Confirmed{id});
  });
  mosquitto_message_v5_callback_set(
      client, [](mosquitto*, void* object, const mosquitto_message* message,
                 const mosquitto_property* properties) {
        const auto* payload = static_cast<const std::uint8_t*>(message->payload);
        of(object).events_.push_back(
            Arrived{{message->topic, Bytes(payload, payload + message->payloadlen),
                     static_cast<Qos>(message->qos), message->retain, std::nullopt, Waited{},
                     sender_of(user_properties_of(properties))},
                    subscriptions_of(properties)});
      });
}

void RobotLink::await_connection() {
  if (!duplicate(socket_.native_handle(), writable_)) return fail_to_open(errno);
  writable_.async_wait(boost::asio::posix::descriptor_base::wait_write,
                       [self = shared_from_this()](error_code error) {
                         if (error || self->is_ended_) return;
                         self->writable_.close();
                         if (!is_connected(self->socket_.native_handle()))
                           self->is_over_ = true;
                         else
                           self->on_readable();  // CONNECT, or the TLS handshake
                         self->deliver();
                         if (!self->is_over_ && !self->is_ended_) self->await_readable();
                       });
}

void RobotLink::await_readable() {
  socket_.async_wait(boost::asio::posix::descriptor_base::wait_read,
                     [self = shared_from_this()](error_code error) {
                       if (error || self->is_ended_) return;
                       self->on_readable();
                       self->deliver();
                       if (!self->is_over_ && !self->is_ended_) self->await_readable();
                     });
}

void RobotLink::on_readable() {
  after_call(mosquitto_loop_read(client_.get(), packets_at_once));
  if (!is_open_) watch_handshake();
  if (!is_over_ && mosquitto_want_write(client_.get())) write();
}

/// As in MosquittoLink: the library goes on for ever with a TLS handshake that has broken off.
void RobotLink::watch_handshake() {
  char first = 0;
  const auto got = recv(socket_.native_handle(), &first, 1, MSG_PEEK | MSG_DONTWAIT);
  if (got == 0 && events_.empty()) is_over_ = true;
}

/// After the present handler, so that what it sends goes out together.
void RobotLink::write_soon() {
  if (std::exchange(is_write_due_, true)) return;
  boost::asio::post(links_.io_, [self = shared_from_this()] {
    self->is_write_due_ = false;
    if (self->is_ended_) return;
    if (!self->is_over_) self->write();
    self->deliver();
  });
}

void RobotLink::write() {
  after_call(mosquitto_loop_write(client_.get(), packets_at_once));
  if (is_over_ || !is_open_ || !mosquitto_want_write(client_.get()) || writable_.is_open()) return;
  if (!duplicate(socket_.native_handle(), writable_)) return after_call(MOSQ_ERR_ERRNO);
  writable_.async_wait(boost::asio::posix::descriptor_base::wait_write,
                       [self = shared_from_this()](error_code error) {
                         if (error || self->is_ended_) return;
                         self->writable_.close();
                         if (!self->is_over_) self->write();
                         self->deliver();
                       });
}

void RobotLink::on_tick(TimePoint now) {
  if (is_ended_) return;
  if (!is_open_ && now >= give_up_at_) is_over_ = true;
  if (!is_over_) after_call(mosquitto_loop_misc(client_.get()));
  if (!is_over_ && is_open_ && mosquitto_want_write(client_.get())) write();  // the ping
  deliver();
}

void RobotLink::after_call(int result) {
  if (result != MOSQ_ERR_SUCCESS && result != MOSQ_ERR_CONN_PENDING) is_over_ = true;
}

// --- What is sent --------------------------------------------------------------------------------

void RobotLink::subscribe(const std::string& filter, Qos qos, std::uint32_t id,
                          bool wants_retained) {
  if (is_over_) return;
  mosquitto_property* properties = nullptr;
  int options = 0;
  if (broker_->version == MqttVersion::v5) {
    mosquitto_property_add_varint(&properties, MQTT_PROP_SUBSCRIPTION_IDENTIFIER, id);
    options = wants_retained ? 0 : retain_handling_never;
  }
  int packet_id = 0;
  after_call(mosquitto_subscribe_v5(client_.get(), &packet_id, filter.c_str(),
                                    static_cast<int>(qos), options, properties));
  mosquitto_property_free_all(&properties);
  subscribing_.emplace_back(packet_id, filter);
  write_soon();
}

void RobotLink::unsubscribe(const std::string& filter) {
  if (is_over_) return;
  after_call(mosquitto_unsubscribe(client_.get(), nullptr, filter.c_str()));
  write_soon();
}

/// A broker of MQTT 5 answers in order. In a cluster of MQTT 3.1.1 (RabbitMQ) another node may keep
/// the session, and what is published to it goes the way of our acknowledgements.
void RobotLink::ask_fence(std::uint64_t number, const std::string& own_topic) {
  if (is_over_) return;
  int packet_id = 0;
  if (broker_->version == MqttVersion::v5)
    after_call(mosquitto_unsubscribe(client_.get(), &packet_id, fence_filter));
  else
    after_call(mosquitto_publish(client_.get(), &packet_id, own_topic.c_str(), 0, nullptr, 1,
                                 /*retain=*/false));
  fences_.emplace_back(packet_id, number);
  write_soon();
}

void RobotLink::publish(const std::string& topic, const std::string& text) {
  if (is_over_) return;
  after_call(mosquitto_publish(client_.get(), nullptr, topic.c_str(), static_cast<int>(text.size()),
                               text.data(), 1, false));
  write_soon();
}

// --- What comes ----------------------------------------------------------------------------------

/// Everything that has come before the connection ended, then its end. The listener may end this
/// link at any time.
void RobotLink::deliver() {
  const auto self = shared_from_this();
  while (!is_ended_ && !events_.empty()) {
    std::vector<Event> events;
    events.swap(events_);
    for (Event& event : events)
      if (!is_ended_) std::visit([this](auto& what) { handle(what); }, event);
  }
  if (!is_over_ || is_ended_) return;
  const bool was_open = is_open_;
  RobotLinksListener& listener = links_.listener_;
  links_.remove(robot_);
  if (was_open)
    listener.on_detached(robot_);
  else
    listener.on_attach_failed(robot_, {"the broker does not answer, or has closed the connection",
                                       false, error_ == EMFILE || error_ == ENFILE});
}

void RobotLink::handle(const Answered& answer) {
  if (answer.code == 0) {
    is_open_ = true;
    return links_.listener_.on_attached(robot_, answer.is_present);
  }
  RobotLinksListener& listener = links_.listener_;
  links_.remove(robot_);
  listener.on_attach_failed(
      robot_, {explain_connect_failure(answer.code), is_id_refusal(answer.code), false});
}

void RobotLink::handle(const Subscribed& subscribed) {
  const auto found =
      std::ranges::find(subscribing_, subscribed.packet_id, &std::pair<int, std::string>::first);
  if (found == subscribing_.end()) return;
  const std::string filter = std::move(found->second);
  subscribing_.erase(found);
  links_.listener_.on_subscribed(robot_, filter, subscribed.is_granted);
}

void RobotLink::handle(const Confirmed& confirmed) {
  if (fences_.empty() || fences_.front().first != confirmed.packet_id) return;
  const std::uint64_t number = fences_.front().second;
  fences_.pop_front();
  links_.listener_.on_fence(robot_, number);
}

void RobotLink::handle(Arrived& arrived) {
  links_.listener_.on_message(robot_, std::move(arrived.message), std::move(arrived.ids));
}

void RobotLink::end(Farewell farewell) {
  is_ended_ = true;
  if (farewell != Farewell::none && is_open_ && !is_over_) {
    mosquitto_property* properties = nullptr;
    if (farewell == Farewell::forget && broker_->version == MqttVersion::v5)
      mosquitto_property_add_int32(&properties, MQTT_PROP_SESSION_EXPIRY_INTERVAL, 0);
    mosquitto_disconnect_v5(client_.get(), 0, properties);
    mosquitto_property_free_all(&properties);
    mosquitto_loop_write(client_.get(), packets_at_once);
  }
  if (writable_.is_open()) writable_.close();
  if (socket_.is_open()) socket_.close();
}

}  // namespace slamgw::sessions
