// SPDX-License-Identifier: Apache-2.0
#include "daemon/sessions/io/robot_link.hpp"

#include <mqtt_protocol.h>

#include <boost/asio/post.hpp>
#include <cerrno>

#include "daemon/mqtt/connect_failure.hpp"
#include "daemon/sessions/io/session_host.hpp"

namespace slamgw::sessions {
namespace {

/// MQTT 5 section 3.8.3.1: no retained messages.
constexpr int retain_handling_never = 0x20;
/// A filter that no session has: UNSUBSCRIBE changes nothing, and its answer comes in order.
const std::string fence_filter = "slam-gateway/fence";

bool is_id_refusal(int code) {  // MQTT 3.1.1 section 3.2.2.3, MQTT 5 section 3.2.2.2
  return code == 2 || code == 5 || code == 0x85 || code == 0x87;
}

/// Returns true when this side has ended the connection: the library, or RobotLink::must_be_sent.
bool is_own(int result, int error) {
  return result == MOSQ_ERR_PROTOCOL || result == MOSQ_ERR_MALFORMED_PACKET ||
         result == MOSQ_ERR_NOMEM || (result == MOSQ_ERR_ERRNO && error == EINVAL);
}

}  // namespace

RobotLink::RobotLink(boost::asio::io_context& io, SessionHost& host,
                     std::shared_ptr<const RobotBroker> broker, std::string robot)
    : MosquittoClient(io), host_(host), broker_(std::move(broker)), robot_(std::move(robot)) {}

void RobotLink::open(const std::string& client_id, bool is_clean, const std::string& address) {
  give_up_at_ = read_clocks().mono + connect_timeout;
  MosquittoClient::open({.broker = broker_->settings,
                         .client_id = client_id,
                         .address = address,
                         .version = broker_->version,
                         .is_clean = is_clean,
                         .receive_maximum = receive_maximum,
                         .session_expiry_s = session_expiry_s,
                         .spares_descriptors = true},
                        broker_->way.tls);
}

void RobotLink::on_tick() {
  if (!is_open() && read_clocks().mono >= give_up_at_) give_up(ETIMEDOUT);
  tick();
}

// --- Requests ------------------------------------------------------------------------------------

std::optional<int> RobotLink::must_be_sent(std::optional<int> packet_id) {
  if (!packet_id) give_up(EINVAL);
  return packet_id;
}

void RobotLink::subscribe(const SubscribeSession& wanted) {
  mosquitto_property* properties = nullptr;
  int options = 0;
  if (broker_->version == MqttVersion::v5) {
    mosquitto_property_add_varint(&properties, MQTT_PROP_SUBSCRIPTION_IDENTIFIER, wanted.id);
    options = wanted.wants_retained ? 0 : retain_handling_never;
  }
  const auto id = MosquittoClient::subscribe(wanted.filter, wanted.qos, options, properties);
  mosquitto_property_free_all(&properties);
  if (id || is_over()) return;
  boost::asio::post(io_, [this, self = shared_from_this(), filter = wanted.filter] {
    if (!is_ended()) on_subscribed(filter, false);
  });
}

void RobotLink::ask_fence(std::uint64_t number, const std::string& own_topic) {
  due_fence_ = {number, own_topic};
  write_soon();
}

/// A broker of MQTT 5 answers UNSUBSCRIBE in order. In a cluster of MQTT 3.1.1 (RabbitMQ) another
/// node may keep the session, and only a PUBLISH takes the same way as our acknowledgements.
void RobotLink::before_write() {
  const auto due = std::exchange(due_fence_, std::nullopt);
  if (!due) return;
  const bool is_v5 = broker_->version == MqttVersion::v5;
  const auto packet_id = must_be_sent(
      is_v5 ? MosquittoClient::unsubscribe(fence_filter)
            : MosquittoClient::publish(due->second, {}, Qos::at_least_once, /*is_retained=*/false));
  if (packet_id) fences_.emplace_back(*packet_id, due->first);
}

void RobotLink::publish(const std::string& topic, const std::string& text) {
  const auto* octets = reinterpret_cast<const std::uint8_t*>(text.data());
  must_be_sent(MosquittoClient::publish(topic, {octets, text.size()}, Qos::at_least_once, false));
}

// --- Events; the host may end this link at any time ----------------------------------------------

void RobotLink::on_connack(const Connack& connack) {
  if (connack.code == 0 && !connack.limits.takes_wildcards)
    return host_.on_attach_failed(
        robot_, {.why = "the broker takes no subscriptions with wildcards, so no commands arrive"});
  if (connack.code == 0 && !connack.limits.takes_subscription_ids)
    return host_.on_no_subscription_ids();
  if (connack.code == 0)
    return host_->on_attached(robot_, connack.is_session_present, read_clocks());
  host_.on_attach_failed(robot_, {.why = explain_connect_failure(connack.code),
                                  .is_id_refused = is_id_refusal(connack.code)});
}

/// MosquittoClient has reported all that came before the end.
void RobotLink::on_ended(const Ended& ended) {
  // One copy of a message with several identifiers: libmosquitto takes it for an error.
  if (ended.result == MOSQ_ERR_DUPLICATE_PROPERTY) return host_.on_no_subscription_ids();
  if (is_open())
    return host_.on_detached(
        robot_, is_own(ended.result, ended.error) ? LossReason::broken : LossReason::taken);
  host_.on_attach_failed(robot_,
                         {.why = "the broker does not answer, or has closed the connection",
                          .is_without_files = ended.error == EMFILE || ended.error == ENFILE});
}

void RobotLink::on_subscribed(const std::string& filter, bool is_granted) {
  host_.on_subscribed(robot_, filter, is_granted);
}

void RobotLink::on_confirmed(const Confirmed& confirmed) {
  if (fences_.empty() || fences_.front().first != confirmed.packet_id) return;
  const std::uint64_t number = fences_.front().second;
  fences_.pop_front();
  host_->on_fence(robot_, number, read_clocks());
}

void RobotLink::on_arrived(Arrived& arrived) {
  arrived.message.sender = sender_of(arrived.said);
  host_->on_message(robot_, std::move(arrived.message), arrived.subscriptions, read_clocks());
}

}  // namespace slamgw::sessions
