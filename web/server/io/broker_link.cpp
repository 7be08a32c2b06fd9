// SPDX-License-Identifier: Apache-2.0
#include "web/server/io/broker_link.hpp"

#include <fmt/format.h>
#include <mosquitto.h>
#include <mqtt_protocol.h>

#include <algorithm>
#include <boost/asio/post.hpp>
#include <chrono>
#include <random>
#include <stdexcept>
#include <utility>

#include "daemon/mqtt/mosquitto/read_user_properties.hpp"
#include "daemon/mqtt/user_properties.hpp"

namespace slamgw::web {
namespace {

using namespace std::chrono_literals;

constexpr auto first_pause = 500ms;
constexpr auto longest_pause = 15s;
constexpr int loop_ms = 1000;

/// Two programs with one id would throw each other out again and again.
std::string random_client_id() {
  std::random_device random;
  return fmt::format("slam-gateway-web-{:08x}", random());
}

/// The reasons of MQTT 5 (section 3.2.2.2) and of 3.1.1 (3.2.2.3).
bool is_user_refused(int connack) {
  return connack == MQTT_RC_BAD_USERNAME_OR_PASSWORD || connack == MQTT_RC_NOT_AUTHORIZED ||
         connack == CONNACK_REFUSED_BAD_USERNAME_PASSWORD ||
         connack == CONNACK_REFUSED_NOT_AUTHORIZED;
}

std::int64_t unix_ms() {
  const auto now = std::chrono::system_clock::now().time_since_epoch();
  return std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
}

/// Takes the three user properties of the gateway's messages.
void read_properties(const mqtt5__property* properties, BrokerMessage& message) {
  read_user_properties(properties, [&](std::string_view name, std::string_view value) {
    if (name == "mesh") message.mesh = value;
    if (name == "gateway") message.gateway = value;
    if (name == "received_at") message.received_at = value;
  });
}

}  // namespace

BrokerLink::BrokerLink(boost::asio::io_context& io, BrokerSettings settings,
                       std::vector<std::string> filters, Listener listener)
    : io_(io),
      settings_(std::move(settings)),
      places_(settings_.addresses()),
      filters_(std::move(filters)),
      listener_(std::move(listener)),
      gather_(io) {
  mosquitto_lib_init();
  set_up_client();
  thread_ = std::thread([this] { run(); });
}

BrokerLink::~BrokerLink() {
  {
    const std::lock_guard lock(mutex_);
    is_stopping_ = true;
  }
  wake_.notify_all();
  {
    const std::lock_guard lock(client_mutex_);
    mosquitto_disconnect(client_);
  }
  thread_.join();
  mosquitto_destroy(client_);
  mosquitto_lib_cleanup();
}

void BrokerLink::set_up_client() {
  client_ = mosquitto_new(random_client_id().c_str(), true, this);
  if (client_ == nullptr) throw std::runtime_error("libmosquitto has no memory");
  mosquitto_threaded_set(client_, true);
  if (const auto& login = settings_.credentials)
    mosquitto_username_pw_set(client_, login->username.c_str(), login->password.c_str());
  if (places_[at_].tls) set_up_tls();
  mosquitto_log_callback_set(client_, [](mosquitto*, void* self, int level, const char* text) {
    if (level == MOSQ_LOG_ERR) of(self).library_error_ = text;
  });
  mosquitto_connect_v5_callback_set(
      client_, [](mosquitto*, void* self, int reason, int, const mosquitto_property*) {
        of(self).on_connected(reason);
      });
  mosquitto_message_v5_callback_set(client_, [](mosquitto*, void* self,
                                                const mosquitto_message* message,
                                                const mosquitto_property* properties) {
    of(self).on_message(
        message->topic,
        {static_cast<const char*>(message->payload), static_cast<std::size_t>(message->payloadlen)},
        message->retain, properties);
  });
  mosquitto_subscribe_v5_callback_set(client_, [](mosquitto*, void* self, int id, int count,
                                                  const int* answers, const mosquitto_property*) {
    if (count > 0) of(self).on_subscribed(id, answers[0]);
  });
  mosquitto_publish_v5_callback_set(
      client_, [](mosquitto*, void* self, int id, int reason, const mosquitto_property*) {
        if (reason >= MQTT_RC_UNSPECIFIED)
          of(self).hand_over(Refusal{id, mosquitto_reason_string(reason)});
      });
}

void BrokerLink::set_up_tls() {
  const auto text = [](const auto& path) { return path ? path->c_str() : nullptr; };
  if (!settings_.ca_file) mosquitto_int_option(client_, MOSQ_OPT_TLS_USE_OS_CERTS, 1);
  const int failure = mosquitto_tls_set(
      client_, text(settings_.ca_file), settings_.ca_file ? nullptr : "/etc/ssl/certs",
      text(settings_.certificate_file), text(settings_.key_file), nullptr);
  if (failure != MOSQ_ERR_SUCCESS)
    throw std::runtime_error(fmt::format("broker.tls: {}", mosquitto_strerror(failure)));
}

std::optional<int> BrokerLink::publish(const CommandRequest& command) {
  int id = 0;
  const std::lock_guard lock(client_mutex_);
  mosquitto_property* sender = nullptr;
  if (is_version_5_)
    mosquitto_property_add_string_pair(&sender, MQTT_PROP_USER_PROPERTY, sender_property.data(),
                                       command.sender.c_str());
  const int failure = is_up_ ? mosquitto_publish_v5(client_, &id, command.topic.c_str(),
                                                    static_cast<int>(command.payload.size()),
                                                    command.payload.data(), 1, false, sender)
                             : MOSQ_ERR_NO_CONN;
  mosquitto_property_free_all(&sender);
  if (failure != MOSQ_ERR_SUCCESS) return std::nullopt;
  return id;
}

// ---- on the link's thread

void BrokerLink::run() {
  std::chrono::milliseconds pause = first_pause;
  while (true) {
    const int failure = stay_connected();
    const bool was_up = is_up_.exchange(false);
    if (was_up) pause = first_pause;
    report_failure(failure);
    choose_version(failure);
    go_to_next_broker();
    if (at_ != 0 && !was_up) {  // once round the list without a pause
      if (!wait(std::chrono::milliseconds::zero())) return;
      continue;
    }
    if (!wait(pause)) return;
    pause = std::min<std::chrono::milliseconds>(pause * 2, longest_pause);
  }
}

/// A client of libmosquitto keeps its TLS for good, so another broker gets another client.
void BrokerLink::go_to_next_broker() {
  if (places_.size() < 2) return;
  const std::lock_guard lock(client_mutex_);
  at_ = (at_ + 1) % places_.size();
  mosquitto_destroy(client_);
  set_up_client();
}

/// Until the connection ends; why it did.
int BrokerLink::stay_connected() {
  connack_ = 0;
  library_error_.clear();
  mosquitto_int_option(client_, MOSQ_OPT_PROTOCOL_VERSION,
                       is_version_5_ ? MQTT_PROTOCOL_V5 : MQTT_PROTOCOL_V311);
  int failure = start_connection();
  while (failure == MOSQ_ERR_SUCCESS) {
    failure = mosquitto_loop(client_, loop_ms, 1);
    const std::lock_guard lock(mutex_);
    if (is_stopping_) return MOSQ_ERR_SUCCESS;
  }
  return failure;
}

/// With MQTT 5 the broker does not send what would not be shown: a packet may have 256 MB.
int BrokerLink::start_connection() {
  mosquitto_property* properties = nullptr;
  if (is_version_5_)
    mosquitto_property_add_int32(&properties, MQTT_PROP_MAXIMUM_PACKET_SIZE, max_packet);
  const int failure = mosquitto_connect_bind_v5(
      client_, places_[at_].host.c_str(), places_[at_].port,
      static_cast<int>(settings_.keep_alive.count()), nullptr, properties);
  mosquitto_property_free_all(&properties);
  return failure;
}

/// A broker that knows no MQTT 5 refuses it (1, 132) or answers with what is no MQTT 5.
void BrokerLink::choose_version(int failure) {
  const bool is_foreign = connack_ == 1 || connack_ == MQTT_RC_UNSUPPORTED_PROTOCOL_VERSION ||
                          failure == MOSQ_ERR_PROTOCOL;
  if (is_foreign) is_version_5_ = !is_version_5_;
}

void BrokerLink::report_failure(int failure) {
  std::string why = failure == MOSQ_ERR_ERRNO ? "the connection cannot be made, or was closed"
                                              : mosquitto_strerror(failure);
  if (is_user_refused(connack_))
    why = fmt::format(
        "the broker does not authorise this user ({}): correct web-credentials.json, beside "
        "gateway.json, and restart slam-gateway-web",
        settings_.credentials ? "'" + settings_.credentials->username + "'"
                              : "no user name was sent");
  else if (places_[at_].tls && !library_error_.empty())  // "OpenSSL Error[0]: error:...: words"
    why =
        fmt::format("TLS with {} fails: {}; look at broker.tls and at the broker's certificate",
                    places_[at_].host, library_error_.substr(library_error_.find_last_of(':') + 1));
  else if (connack_ != 0)
    why = is_version_5_ ? mosquitto_reason_string(connack_) : mosquitto_connack_string(connack_);
  if (why == last_failure_) return;
  last_failure_ = why;
  hand_over(StateChange{false, why});
}

/// False when the program ends.
bool BrokerLink::wait(std::chrono::milliseconds time) {
  std::unique_lock lock(mutex_);
  return !wake_.wait_for(lock, time, [this] { return is_stopping_; });
}

void BrokerLink::on_connected(int reason) {
  connack_ = reason;
  if (reason != 0) return;
  asked_.clear();
  for (const std::string& filter : filters_) {
    int id = 0;
    if (mosquitto_subscribe(client_, &id, filter.c_str(), 0) == MOSQ_ERR_SUCCESS)
      asked_[id] = filter;
  }
  is_up_ = true;
  last_failure_.clear();
  hand_over(StateChange{true, {}});
}

/// MQTT 3.1.1 knows one code for a refusal, 0x80.
void BrokerLink::on_subscribed(int message_id, int answer) {
  const auto asked = asked_.find(message_id);
  if (asked == asked_.end() || answer < MQTT_RC_UNSPECIFIED) return;
  hand_over(Unreadable{asked->second, is_version_5_ ? mosquitto_reason_string(answer) : "refused"});
}

void BrokerLink::on_message(std::string topic, std::string payload, bool is_retained,
                            const mqtt5__property* properties) {
  BrokerMessage message{std::move(topic), std::move(payload), unix_ms(), is_retained, {}, {}, {}};
  read_properties(properties, message);
  hand_over(std::move(message));
}

void BrokerLink::hand_over(Happening happening) {
  bool is_due = false;
  {
    const std::lock_guard lock(mutex_);
    if (const auto* message = std::get_if<BrokerMessage>(&happening)) {
      if (waiting_.size() >= max_waiting || waiting_bytes_ > max_waiting_bytes) {
        ++overruns_;
        return;
      }
      waiting_bytes_ += message->topic.size() + message->payload.size();
    }
    waiting_.push_back(std::move(happening));
    is_due = std::exchange(is_delivery_due_, true);
  }
  if (!is_due) boost::asio::post(io_, [this] { deliver(); });
}

// ---- on the loop's thread

/// The first of a row at once. While messages come, the loop checks again by itself, so that it is
/// woken once for many.
void BrokerLink::deliver() {
  std::vector<Happening> batch;
  {
    const std::lock_guard lock(mutex_);
    batch.swap(waiting_);
    waiting_bytes_ = 0;
    is_delivery_due_ = !batch.empty();
  }
  if (batch.empty()) return;
  gather_.expires_after(gathering);
  gather_.async_wait([this](boost::system::error_code end) {
    if (!end) deliver();
  });
  for (const Happening& happening : batch) {
    if (const auto* message = std::get_if<BrokerMessage>(&happening))
      listener_.on_message(*message);
    else if (const auto* state = std::get_if<StateChange>(&happening))
      listener_.on_state(state->is_up, state->why);
    else if (const auto* refusal = std::get_if<Refusal>(&happening))
      listener_.on_refused(refusal->message_id, refusal->why);
    else if (const auto* unreadable = std::get_if<Unreadable>(&happening))
      listener_.on_unreadable(unreadable->filter, unreadable->why);
  }
}

}  // namespace slamgw::web
