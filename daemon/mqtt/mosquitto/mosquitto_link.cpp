// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/mosquitto/mosquitto_link.hpp"

#include <fmt/format.h>
#include <mosquitto.h>
#include <mqtt_protocol.h>

#include <boost/asio/post.hpp>
#include <cerrno>
#include <cstring>

#include "daemon/mqtt/connect_failure.hpp"

namespace slamgw {
namespace {

/// Returns true when the broker, or its host, has closed the connection.
bool is_closing(int error) { return error == ECONNRESET || error == EPIPE; }

LossCause cause_of(int result) {
  if (result == session_taken_over) return LossCause::taken_over;
  if (result >= MosquittoClient::first_reason) return LossCause::told;
  return result == MOSQ_ERR_PROTOCOL ? LossCause::misread : LossCause::unknown;
}

}  // namespace

MosquittoLink::MosquittoLink(boost::asio::io_context& io, boost::asio::thread_pool& lane,
                             LinkOptions options, MqttLinkListener& listener)
    : MosquittoClient(io),
      lane_(lane),
      options_(std::move(options)),
      settings_(options_.broker),
      listener_(listener),
      timeout_(io),
      tick_(io),
      properties_(options_.version, settings_.gateway_id) {}

void MosquittoLink::connect() {
  timeout_.after(options_.timeout, [self = self()] {
    if (self->is_ended() || self->is_open()) return;
    self->fail({0, self->is_reached() ? explain_not_a_broker(self->settings_)
                                      : explain_no_connection(self->settings_, ETIMEDOUT)});
  });
  const WayToBroker& way = options_.way;
  open({.broker = settings_,
        .client_id = settings_.client_id,
        .address = way.addresses[options_.attempt % way.addresses.size()],
        .version = options_.version,
        .will = &options_.will,
        .max_inbound_octets = options_.max_inbound_octets},
       way.tls);
  tick_.every(tick_interval, [this] {
    const auto until_done = self();
    if (!is_ended() && !is_over()) tick();
  });
}

void MosquittoLink::publish(std::uint64_t sequence, const BrokerMessage& message) {
  const auto id = MosquittoClient::publish(message.topic, message.payload, message.qos,
                                           message.retain, properties_.of(message));
  if (id) in_flight_.emplace_back(*id, sequence);
  if (id || is_over()) return;
  boost::asio::post(io_, [self = self(), sequence] {
    if (!self->is_ended()) self->listener_.on_publish_refused(sequence, MQTT_RC_TOPIC_NAME_INVALID);
  });
}

void MosquittoLink::subscribe(std::string filter) {
  if (MosquittoClient::subscribe(filter, Qos::at_most_once) || is_over()) return;
  boost::asio::post(io_, [self = self(), filter = std::move(filter)] {
    if (!self->is_ended()) self->listener_.on_subscribe_result(filter, false);
  });
}

void MosquittoLink::unsubscribe(std::string filter) {
  if (const auto id = MosquittoClient::unsubscribe(filter))
    unsubscribing_.emplace_back(*id, std::move(filter));
}

std::string MosquittoLink::explain_loss(const Ended& ended) const {
  if (ended.result == session_taken_over) return explain_rival(settings_.client_id);
  if (ended.result >= first_reason) return explain_connect_failure(ended.result);
  if (ended.result == MOSQ_ERR_KEEPALIVE) return "connection lost: the broker does not answer";
  if (ended.result == MOSQ_ERR_ERRNO && !is_closing(ended.error) && ended.error != EPROTO)
    return fmt::format("connection lost: {}", std::strerror(ended.error));
  return "connection lost";
}

/// Explains the end of a connection before its CONNACK.
ConnectFailure MosquittoLink::explain_failure(const Ended& ended) const {
  const bool is_closed = ended.result == MOSQ_ERR_CONN_LOST || is_closing(ended.error);
  if (!is_reached() && !is_closed) return {0, explain_no_connection(settings_, ended.error)};
  if (const TlsClient* const tls = this->tls()) {
    if (const std::string problem = tls->certificate_problem(); !problem.empty())
      return {0, problem};
    const std::string reason = last_error().substr(last_error().rfind(':') + 1);
    if (!reason.empty())
      return {
          0, tls->has_shaken_hands() ? explain_tls_end(reason) : explain_handshake_failure(reason)};
    if (!tls->has_shaken_hands())
      return {0, explain_handshake_failure("the broker closed the connection")};
    // The end of the connection may overtake the alert that has the reason.
    const bool is_cut = ended.error == ECONNRESET || ended.error == EPROTO;
    if (is_cut && !settings_.certificate_file)
      return {0, explain_tls_end(std::strerror(ended.error)), ConnectAnswer::closed};
  }
  if (is_closed) return {0, explain_not_a_broker(settings_), ConnectAnswer::closed};
  if (ended.result == MOSQ_ERR_ERRNO) return {0, explain_no_connection(settings_, ended.error)};
  // Some brokers answer MQTT 5 with a CONNACK that only MQTT 3.1.1 allows.
  const bool is_garbled =
      ended.result == MOSQ_ERR_PROTOCOL || ended.result == MOSQ_ERR_MALFORMED_PACKET;
  return {0, explain_not_a_broker(settings_),
          is_garbled ? ConnectAnswer::version_refused : ConnectAnswer::other};
}

void MosquittoLink::on_connack(const Connack& connack) {
  if (connack.code == 0) {
    timeout_.cancel();
    return listener_.on_connected(connack.limits);
  }
  fail({connack.code});
}

void MosquittoLink::on_ended(const Ended& ended) {
  if (!is_open()) return fail(explain_failure(ended));
  listener_.on_lost(explain_loss(ended), cause_of(ended.result));
}

void MosquittoLink::on_confirmed(const Confirmed& confirmed) {
  if (const auto filter = take(unsubscribing_, confirmed.packet_id))
    return listener_.on_unsubscribed(*filter);
  const auto sequence = take(in_flight_, confirmed.packet_id);
  if (!sequence) return;
  if (confirmed.reason < first_reason) return listener_.on_published(*sequence);
  listener_.on_publish_refused(*sequence, confirmed.reason);
}

void MosquittoLink::on_subscribed(const std::string& filter, bool is_granted) {
  listener_.on_subscribe_result(filter, is_granted);
}

void MosquittoLink::on_arrived(Arrived& arrived) {
  options_.on_message(std::move(arrived.message), arrived.said);
}

void MosquittoLink::fail(ConnectFailure failure) {
  if (std::exchange(has_failed_, true)) return;
  listener_.on_connect_failed(std::move(failure));
}

void MosquittoLink::abandon(bool is_orderly) {
  timeout_.cancel();
  tick_.cancel();
  if (is_orderly)
    leave(lane_);
  else
    end(Farewell::abort);
}

std::shared_ptr<MqttLink> make_mosquitto_link(boost::asio::io_context& io,
                                              boost::asio::thread_pool& lane, LinkOptions options,
                                              MqttLinkListener& listener) {
  return std::make_shared<MosquittoLink>(io, lane, std::move(options), listener);
}

}  // namespace slamgw
