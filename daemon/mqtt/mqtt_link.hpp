// SPDX-License-Identifier: Apache-2.0
// The border to an MQTT client library: one connection to a broker, from its attempt to its end,
// never reused. Nothing of a former connection is resumed, because client libraries forget their
// packet ids. A broker that follows the standard would take a new QoS 2 message with an old id for
// a repeat. All differences between the libraries are behind this border. Upstream decides when and
// where to connect, and with which version.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/thread_pool.hpp>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "daemon/core/messages.hpp"
#include "daemon/mqtt/broker_limits.hpp"
#include "daemon/mqtt/connection_probe.hpp"
#include "daemon/mqtt/settings.hpp"
#include "daemon/mqtt/user_properties.hpp"
#include "daemon/mqtt/version_choice.hpp"

namespace slamgw {

/// The largest packet that an MQTT 5 broker may send: four times the largest between gateways, and
/// far more than a robot can take. Without it, one message of 256 MiB would exhaust the daemon's
/// memory. MQTT 3.1.1 has no such limit.
inline constexpr std::uint32_t max_inbound_packet_octets = 1024 * 1024;
/// Longest time from the attempt to the CONNACK, after the name look-up. The second is for several
/// brokers.
inline constexpr std::chrono::seconds connect_timeout{10};
inline constexpr std::chrono::seconds connect_timeout_of_many{3};
/// Time given to the broker at shutdown to read what is still unsent.
inline constexpr std::chrono::milliseconds goodbye_timeout{500};

struct LastWill {
  std::string topic;  ///< empty: no will
  std::string payload;
  Qos qos = Qos::at_least_once;
  bool is_retained = true;
};

struct LinkOptions {
  BrokerSettings broker;
  WayToBroker way;
  MqttVersion version = MqttVersion::v5;
  LastWill will;
  std::chrono::seconds timeout = connect_timeout;
  unsigned attempt = 0;  ///< a host may have several addresses: each attempt tries the next
  /// Takes the broker's messages, as UpstreamListener::on_message(); called like MqttLinkListener.
  std::function<void(BrokerMessage, const UserProperties&)> on_message;
  std::uint32_t max_inbound_octets = max_inbound_packet_octets;
};

/// Why a connection could not be made: `code` is a CONNACK code of the version in use. Without a
/// CONNACK it is 0, and `text` and `answer` explain the failure.
struct ConnectFailure {
  int code = 0;
  std::string text{};
  ConnectAnswer answer = ConnectAnswer::other;
};

enum class LossCause : std::uint8_t {
  unknown,
  told,        ///< the broker's DISCONNECT has a reason
  taken_over,  ///< the broker says that another client has connected with our id
  misread,     ///< the library takes the broker's packet for an error of the protocol
};

/// Called on the loop's thread, never from inside a call to the link, and not after abandon().
class MqttLinkListener {
 public:
  virtual ~MqttLinkListener() = default;
  /// One of these two is called, once.
  virtual void on_connected(const BrokerLimits& limits) = 0;
  virtual void on_connect_failed(ConnectFailure failure) = 0;
  /// Called only after on_connected().
  virtual void on_lost(std::string why, LossCause cause) = 0;
  virtual void on_published(std::uint64_t sequence) = 0;
  /// `code`: the reason code of the PUBACK or PUBREC.
  virtual void on_publish_refused(std::uint64_t sequence, int code) = 0;
  virtual void on_subscribe_result(const std::string& filter, bool granted) = 0;
  /// The broker has answered an UNSUBSCRIBE.
  virtual void on_unsubscribed(const std::string& filter) = 0;
};

/// Called on the loop's thread; no call blocks.
class MqttLink {
 public:
  virtual ~MqttLink() = default;
  virtual void connect() = 0;

  // Between on_connected() and abandon():
  /// `message` must be within the broker's limits, and may be destroyed after the call.
  virtual void publish(std::uint64_t sequence, const BrokerMessage& message) = 0;
  /// Subscribes at QoS 0.
  virtual void subscribe(std::string filter) = 0;
  virtual void unsubscribe(std::string filter) = 0;

  /// Ends the connection and its events. `is_orderly`: published messages are written, and then
  /// DISCONNECT; that takes the lane a second at most. Else data that the kernel has not sent are
  /// discarded, because a broker that hangs must not get them later (SO_LINGER with no time, set
  /// before the socket is closed).
  virtual void abandon(bool is_orderly) = 0;

  /// Number of the broker's messages for which there was no room on the way to the loop.
  virtual std::uint64_t inbound_dropped() const { return 0; }
};

/// Makes a link; its connect() is called next. `lane` is for blocking calls.
using MakeLink = std::function<std::shared_ptr<MqttLink>(
    boost::asio::io_context& io, boost::asio::thread_pool& lane, LinkOptions options,
    MqttLinkListener& listener)>;

}  // namespace slamgw
