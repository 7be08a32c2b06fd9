// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/paho/paho_link.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <unistd.h>
#include <boost/asio/post.hpp>

#include <MQTTAsync.h>
#include <algorithm>
#include <charconv>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <string_view>
#include <utility>

#include "daemon/mqtt/connect_failure.hpp"
#include "daemon/mqtt/connection_probe.hpp"

namespace slamgw {

namespace {

/// Returns the port of the other end; 0 when `descriptor` is not a connection.
std::uint16_t peer_port(int descriptor) {
  sockaddr_storage peer{};
  socklen_t size = sizeof peer;
  if (getpeername(descriptor, reinterpret_cast<sockaddr*>(&peer), &size) != 0) return 0;
  if (peer.ss_family == AF_INET) return ntohs(reinterpret_cast<sockaddr_in&>(peer).sin_port);
  if (peer.ss_family == AF_INET6) return ntohs(reinterpret_cast<sockaddr_in6&>(peer).sin6_port);
  return 0;
}

}  // namespace

void BrokerSocket::forget() {
  const int descriptor = descriptor_.exchange(-1);
  if (descriptor >= 0) close(descriptor);
}

void BrokerSocket::adopt(std::uint16_t broker_port) {
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator("/proc/self/fd", error)) {
    const std::string name = entry.path().filename();
    int descriptor = -1;
    std::from_chars(name.data(), name.data() + name.size(), descriptor);
    if (peer_port(descriptor) != broker_port) continue;
    const int on = 1;
    setsockopt(descriptor, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    descriptor_ = fcntl(descriptor, F_DUPFD_CLOEXEC, 0);
    return;
  }
}

void BrokerSocket::discard_on_close() {
  const linger at_once{1, 0};
  if (descriptor_ >= 0) setsockopt(descriptor_, SOL_SOCKET, SO_LINGER, &at_once, sizeof at_once);
}

void BrokerSocket::cork(int on) {
  if (descriptor_ >= 0) setsockopt(descriptor_, IPPROTO_TCP, TCP_CORK, &on, sizeof on);
}

namespace {

/// Call before the first client. OpenSSL initialises itself where TLS is used; Paho would always
/// have it load everything, 1.4 MiB. Paho also records its last 400 calls and packets as text,
/// under one lock for all threads. That is a fifth of a message's cost, and only a trace needs it.
void keep_paho_small() {
  MQTTAsync_init_options options = MQTTAsync_init_options_initializer;
  options.do_openssl_init = 0;
  MQTTAsync_global_init(&options);
  if (!std::getenv("MQTT_C_CLIENT_TRACE")) MQTTAsync_setTraceLevel(MQTTASYNC_TRACE_ERROR);
}

/// Returns the code of the CONNACK that refused; 0 when none came. Paho returns the codes of MQTT
/// 3.1.1 (1-5) as its own, and its own errors as negative numbers.
int connack_code_of(const mqtt::token& token) {
  const auto reason = token.get_reason_code();
  if (reason != mqtt::ReasonCode::MQTTPP_V3_CODE && reason != mqtt::ReasonCode::SUCCESS)
    return static_cast<int>(reason);
  return std::max(0, token.get_return_code());
}

/// Says why a request failed that got no answer.
std::string explain_no_answer(std::string_view request, int code) {
  if (code == MQTTASYNC_OPERATION_INCOMPLETE || code == MQTTASYNC_DISCONNECTED)
    return "connection lost";  // Paho says so before it calls connection_lost()
  return fmt::format("{} failed (Paho {})", request, code);
}

/// Sequence numbers travel through Paho as the user context of a token, with 32 bits on some hosts.
void* as_context(std::uint64_t sequence) {
  return reinterpret_cast<void*>(static_cast<std::uintptr_t>(sequence));
}

}  // namespace

// --- On Paho's threads: the answers to requests --------------------------------------------------

void PahoLink::on_success(const mqtt::token& token) {
  switch (token.get_type()) {
    case mqtt::token::CONNECT: return on_connack(token);
    case mqtt::token::PUBLISH:
      if (token.get_message_id() == 0) return on_written(sequence_of(token));  // QoS 0
      return report_answer(token, refusal_of(token));
    case mqtt::token::SUBSCRIBE: return report_suback(token, true);
    case mqtt::token::UNSUBSCRIBE: return report_unsuback(token);
    case mqtt::token::DISCONNECT: return;
  }
}

void PahoLink::on_failure(const mqtt::token& token) {
  switch (token.get_type()) {
    case mqtt::token::CONNECT: return report_failure(connack_code_of(token));
    case mqtt::token::PUBLISH:
      if (const auto refusal = refusal_of(token)) return report_answer(token, refusal);
      return report_lost(explain_no_answer("a publish", token.get_return_code()));
    case mqtt::token::SUBSCRIBE:
      if (refusal_of(token))
        report_suback(token, false);  // else connection_lost() reports the loss
      return;
    case mqtt::token::UNSUBSCRIBE:
    case mqtt::token::DISCONNECT: return;
  }
}

void PahoLink::on_connack(const mqtt::token& token) {
  post_to_lane([](PahoLink& link) { link.socket_.adopt(link.settings_.port); });
  post_to_loop([this, limits = limits_of(token, options_.version)](MqttLinkListener& listener) {
    if (!std::exchange(has_answered_, true)) listener.on_connected(limits);
  });
}

void PahoLink::report_answer(const mqtt::token& token, std::optional<int> refusal) {
  post_to_loop([this, sequence = sequence_of(token), refusal](MqttLinkListener& listener) {
    on_acknowledged();
    if (!refusal) return listener.on_published(sequence);
    listener.on_publish_refused(sequence, *refusal);
  });
}

void PahoLink::report_suback(const mqtt::token& token, bool is_granted) {
  const mqtt::const_string_collection_ptr topics = token.get_topics();
  if (!topics || topics->empty()) return;
  post_to_loop([filter = (*topics)[0], is_granted](MqttLinkListener& listener) {
    listener.on_subscribe_result(filter, is_granted);
  });
}

/// Paho takes each UNSUBACK for a success, also one that refuses.
void PahoLink::report_unsuback(const mqtt::token& token) {
  const mqtt::const_string_collection_ptr topics = token.get_topics();
  if (!topics || topics->empty()) return;
  post_to_loop(
      [filter = (*topics)[0]](MqttLinkListener& listener) { listener.on_unsubscribed(filter); });
}

PahoLink::PahoLink(boost::asio::io_context& io, boost::asio::thread_pool& lane, LinkOptions options,
                   MqttLinkListener& listener)
    : io_(io),
      lane_(lane),
      options_(std::move(options)),
      settings_(options_.broker),
      listener_(listener),
      nudge_timer_(io),
      connect_timer_(io) {
  [[maybe_unused]] static const bool once = (keep_paho_small(), true);
}

PahoLink::~PahoLink() = default;

void PahoLink::post_to_loop(Event event) {
  if (events_.give(std::move(event)) != 1) return;
  boost::asio::post(io_, [self = shared_from_this()] {
    for (const Event& happened : self->events_.take()) {
      if (!self->is_abandoned_) happened(self->listener_);
    }
  });
}

void PahoLink::post_to_lane(std::function<void(PahoLink&)> work) {
  boost::asio::post(lane_, [self = shared_from_this(), work = std::move(work)] { work(*self); });
}

void PahoLink::connect() {
  post_to_lane([](PahoLink& session) { session.open(); });
}

void PahoLink::open() {
  opened_ = std::chrono::steady_clock::now();
  try {
    client_ = std::make_unique<mqtt::async_client>(
        server_uri(settings_, host_of_attempt()), settings_.client_id,
        mqtt::create_options(static_cast<int>(options_.version), max_buffered_in_paho), nullptr);
    publish_form_.emplace(options_.version, settings_.gateway_id);
    client_->set_callback(*this);  // before connect: later it can deadlock
    client_->set_disconnected_handler([this](const mqtt::properties&, mqtt::ReasonCode reason) {
      report_ended(static_cast<int>(reason));  // connection_lost is not called then
    });
    set_connect_options();
    connect_token_ = client_->connect(connect_options_, nullptr, *this);
    post_to_loop([this](MqttLinkListener&) { watch_connect(); });
  } catch (const mqtt::exception&) {
    report_failure(0);
  }
}

/// Returns the address for this attempt, because Paho tries only one address of a name, and prefers
/// IPv4. With TLS returns the name, which TLS needs.
std::string PahoLink::host_of_attempt() const {
  if (settings_.tls) return settings_.host;
  const std::vector<std::string>& addresses = options_.way.addresses;
  return addresses[options_.attempt % addresses.size()];
}

/// The default of MQTT 5, which CONNECT names all the same: else Mosquitto 2.0.11 takes 20. It
/// counts each message that is too large for us as under way for ever, so that after 20 no command
/// comes any more.
constexpr std::int32_t largest_receive_maximum = 65535;

/// Sets the options in place, because copies of Paho's options lose their properties.
void PahoLink::set_connect_options() {
  mqtt::connect_options& options = connect_options_;
  options.set_mqtt_version(static_cast<int>(options_.version));
  if (options_.version == MqttVersion::v5) {
    options.set_clean_start(true);
    options.set_properties(mqtt::properties(
        {{mqtt::property::MAXIMUM_PACKET_SIZE, std::int32_t{max_inbound_packet_octets}},
         {mqtt::property::RECEIVE_MAXIMUM, largest_receive_maximum}}));
  } else {
    options.set_clean_session(true);
  }
  options.set_keep_alive_interval(settings_.keep_alive);
  options.set_connect_timeout(options_.timeout);
  options.set_automatic_reconnect(false);
  if (settings_.credentials) {
    options.set_user_name(settings_.credentials->username);
    options.set_password(settings_.credentials->password);
  }
  const LastWill& will = options_.will;
  if (!will.topic.empty())
    options.set_will(
        mqtt::will_options(will.topic, will.payload, static_cast<int>(will.qos), will.is_retained));
  if (settings_.tls) {
    set_tls_options();
    options.set_ssl(tls_options_);
  }
}

void PahoLink::set_tls_options() {
  tls_options_.set_verify(true);  // the host name too, which Paho does not check by default
  tls_options_.set_enable_server_cert_auth(true);
  tls_options_.set_ssl_version(MQTT_SSL_VERSION_TLS_1_2);
  if (settings_.ca_file) tls_options_.set_trust_store(*settings_.ca_file);
  if (settings_.certificate_file) tls_options_.set_key_store(*settings_.certificate_file);
  if (settings_.key_file) tls_options_.set_private_key(*settings_.key_file);
}

/// `code`: of the CONNACK, or 0. The reason is found on the lane, because that may take a while.
void PahoLink::report_failure(int code) {
  const bool is_in_time = std::chrono::steady_clock::now() - opened_ < options_.timeout;
  post_to_lane([code, is_in_time](PahoLink& session) {
    session.post_to_loop([&session, failure = session.explain_failure(code, is_in_time)](
                             MqttLinkListener& listener) {
      if (std::exchange(session.has_answered_, true)) return;
      listener.on_connect_failed(failure);
    });
  });
}

ConnectFailure PahoLink::explain_failure(int code, bool is_in_time) const {
  if (code != 0) return {code};
  Reachability found = probe_broker(settings_);
  const bool is_closed = found.is_reachable && is_in_time;
  return {0, std::move(found.text), is_closed ? ConnectAnswer::closed : ConnectAnswer::other};
}

void PahoLink::watch_connect() {
  connect_timer_.after(options_.timeout + connect_grace, [self = shared_from_this()] {
    if (!self->has_answered_) self->report_failure(0);
  });
}

void PahoLink::publish(std::uint64_t sequence, const BrokerMessage& message) {
  nudge_.on_publish(std::chrono::steady_clock::now());
  if (!is_nudge_armed_) watch_progress();
  if (publications_.give({sequence, message}) != 1) return;
  post_to_lane([](PahoLink& session) { session.publish_all(); });
}

void PahoLink::publish_all() {
  try {
    const std::vector<Publication> publications = publications_.take();
    const auto unacknowledged = static_cast<std::size_t>(
        std::count_if(publications.begin(), publications.end(),
                      [](const Publication& p) { return p.message.qos == Qos::at_most_once; }));
    unwritten_ += unacknowledged;
    if (unacknowledged > 1) socket_.gather();
    for (const Publication& publication : publications) {
      highest_ = publication.sequence;
      client_->publish(publish_form_->fill(publication.message), as_context(publication.sequence),
                       *this);
    }
  } catch (const mqtt::exception& error) {
    report_lost(explain_no_answer("a publish", error.get_return_code()));
  }
}

std::uint64_t PahoLink::sequence_of(const mqtt::token& token) const {
  const auto context = reinterpret_cast<std::uintptr_t>(token.get_user_context());
  return restore_sequence(static_cast<std::uint32_t>(context), highest_);
}

void PahoLink::on_written(std::uint64_t sequence) {
  const std::size_t waiting = written_.give(sequence);
  const bool is_last = --unwritten_ == 0;
  if (is_last) socket_.release();
  if (!is_last && waiting < written_at_once) return;
  post_to_loop([this](MqttLinkListener& listener) {
    for (const std::uint64_t written : written_.take()) {
      on_acknowledged();
      listener.on_published(written);
    }
  });
}

void PahoLink::subscribe(std::string filter) {
  post_to_lane([filter = std::move(filter)](PahoLink& session) {
    try {
      session.client_->subscribe(filter, 0, nullptr, session);
    } catch (const mqtt::exception& error) {
      session.report_lost(explain_no_answer("a subscribe", error.get_return_code()));
    }
  });
}

void PahoLink::unsubscribe(std::string filter) {
  post_to_lane([filter = std::move(filter)](PahoLink& session) {
    try {
      session.client_->unsubscribe(filter, nullptr, session);
    } catch (const mqtt::exception&) {
      // the connection is ending; the next one does not have the subscription
    }
  });
}

void PahoLink::on_acknowledged() { nudge_.on_acknowledged(std::chrono::steady_clock::now()); }

/// Uses one timer for all messages: it fires about 40 times a second at full rate, never when idle.
void PahoLink::watch_progress() {
  const auto deadline = nudge_.deadline();
  is_nudge_armed_ = deadline.has_value();
  if (!deadline) return;
  nudge_timer_.at(*deadline, [self = shared_from_this()] {
    if (self->nudge_.take(std::chrono::steady_clock::now())) self->nudge();
    self->watch_progress();
  });
}

void PahoLink::nudge() {
  // No session has this filter: the smallest request that no subscriber can see.
  unsubscribe("slam-gateway/nudge");
}

void PahoLink::abandon(bool is_orderly) {
  is_abandoned_ = true;
  nudge_timer_.cancel();
  connect_timer_.cancel();
  post_to_lane([is_orderly](PahoLink& session) { session.close(is_orderly); });
}

void PahoLink::close(bool is_orderly) {
  if (!client_) return;
  try {
    if (is_orderly) {
      disconnect_token_ = client_->disconnect(goodbye_timeout);
      disconnect_token_->wait_for(2 * goodbye_timeout);
    }
  } catch (const mqtt::exception&) {
    // the client was not connected
  }
  if (!is_orderly) socket_.discard_on_close();
  publish_form_.reset();
  client_.reset();
  socket_.forget();  // the next link finds its own socket
}

void PahoLink::connection_lost(const std::string& cause) {
  report_lost(cause.empty() ? "connection lost" : "connection lost: " + cause);
}

void PahoLink::report_lost(std::string why, LossCause cause) {
  post_to_loop(
      [why = std::move(why), cause](MqttLinkListener& listener) { listener.on_lost(why, cause); });
}

void PahoLink::report_ended(int reason) {
  if (reason == session_taken_over)
    return report_lost(explain_rival(settings_.client_id), LossCause::taken_over);
  report_lost(explain_connect_failure(reason), LossCause::told);
}

void PahoLink::message_arrived(mqtt::const_message_ptr message) {
  const std::size_t octets = message->get_topic().size() + message->get_payload().size();
  if (inbound_waiting_ >= max_inbound_waiting ||
      inbound_octets_ + octets > max_inbound_waiting_octets) {
    ++inbound_dropped_;
    return;
  }
  ++inbound_waiting_;
  inbound_octets_ += octets;
  post_to_loop([this, octets, arrived = from_paho(*message),
                said = user_properties_of(*message)](MqttLinkListener&) {
    --inbound_waiting_;
    inbound_octets_ -= octets;
    options_.on_message(arrived, said);
  });
}

}  // namespace slamgw
