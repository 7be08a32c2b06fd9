// SPDX-License-Identifier: Apache-2.0
// One MQTT connection through Eclipse Paho, from connect to destroy; never reused (a fresh client
// sheds Paho's tokens, retry state and lost wake-ups). Every Paho call is made on the lane, a
// thread of its own, because connect resolves names under Paho's global lock. Paho's callbacks come
// on Paho's threads and do exactly one thing: post to the loop.
#pragma once

#include <mqtt/async_client.h>

#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/thread_pool.hpp>
#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/mqtt/broker_socket.hpp"
#include "daemon/mqtt/handover.hpp"
#include "daemon/mqtt/paho_message.hpp"
#include "daemon/mqtt/settings.hpp"

namespace slamgw {

struct LastWill {
  std::string topic;
  std::string payload;
  Qos qos = Qos::at_least_once;
  bool is_retained = true;
};

/// Why a connection could not be made. `code`: a CONNACK code of the version in use, or 0 when none
/// came.
struct ConnectFailure {
  int code = 0;
  std::string text;
  ConnectAnswer answer = ConnectAnswer::other;
  bool is_not_authorised = false;
};

/// All on the loop's thread; none after abandon().
class PahoSessionListener {
 public:
  virtual ~PahoSessionListener() = default;
  virtual void on_connected(bool session_present, const BrokerLimits& limits) = 0;
  virtual void on_connect_failed(ConnectFailure failure) = 0;
  virtual void on_lost(std::string why) = 0;
  virtual void on_published(std::uint64_t sequence) = 0;
  virtual void on_publish_refused(std::uint64_t sequence, const Refusal& refusal) = 0;
  virtual void on_subscribe_result(const std::string& filter, bool granted) = 0;
  virtual void on_message(BrokerMessage message, std::vector<std::uint32_t> subscriptions) = 0;
};

class PahoSession final : public std::enable_shared_from_this<PahoSession>, private mqtt::callback {
 public:
  /// What waits between Paho's receive thread and the loop; beyond it messages are dropped and
  /// counted.
  static constexpr std::size_t max_inbound_waiting = 10000;
  /// How long an MQTT 5 broker keeps our subscriptions, and commands that come for them, while we
  /// are away (a restart, a crash). Not longer: a robot must not obey yesterday's command. MQTT
  /// 3.1.1 knows no such limit, so there nothing is kept.
  static constexpr std::uint32_t session_expiry_s = 300;
  /// Cap on Paho's own queue; the outbox's windows stay well below it.
  static constexpr int max_buffered_in_paho = 512;

  PahoSession(boost::asio::io_context& io, boost::asio::thread_pool& lane,
              const BrokerSettings& settings, MqttVersion version, LastWill will, unsigned attempt,
              PahoSessionListener& listener);
  ~PahoSession() override;

  // On the loop's thread:
  void connect();
  void publish(std::uint64_t sequence, BrokerMessage message);
  void subscribe(std::string filter, Qos qos, std::uint32_t id);
  void unsubscribe(std::string filter);
  /// Wakes Paho's send thread when it sleeps on something to send: its signals get lost.
  void nudge();
  /// No more events; the connection is closed and destroyed on the lane, with a DISCONNECT when
  /// `is_orderly`.
  void abandon(bool is_orderly);
  std::uint64_t inbound_dropped() const { return inbound_dropped_; }

 private:
  /// QoS 0 that is written is told to the loop when nothing else is to be written, or in parts of
  /// so many; half of what the outbox hands over at once, so that it never waits for the rest.
  static constexpr std::size_t written_at_once = 16;

  struct Publication {
    std::uint64_t sequence;
    BrokerMessage message;
  };
  class PublishListener;
  class SubscribeListener;
  class ConnectListener;

  void connected(const std::string&) override {}
  void connection_lost(const std::string& cause) override;
  void message_arrived(mqtt::const_message_ptr message) override;
  void delivery_complete(mqtt::delivery_token_ptr) override {}

  // On the lane:
  void open();
  std::string host_of_attempt() const;
  void close(bool is_orderly);
  void set_connect_options();
  void set_tls_options();

  void publish_all();
  bool keep_to_limits(Publication& publication);
  // On Paho's threads:
  void on_written(std::uint64_t sequence);

  using Event = std::function<void(PahoSessionListener&)>;
  void post_to_loop(Event event);
  void post_to_lane(std::function<void(PahoSession&)> work);
  void report_failure(int code);
  ConnectFailure explain_failure(int code, bool is_in_time) const;
  void tell_lost(std::string why);
  void tell_ended(int reason);

  boost::asio::io_context& io_;
  boost::asio::thread_pool& lane_;
  const BrokerSettings settings_;
  const MqttVersion version_;
  const LastWill will_;
  const unsigned attempt_;  ///< a host may have several addresses: each attempt tries the next
  PahoSessionListener& listener_;
  std::chrono::steady_clock::time_point opened_{};
  bool is_abandoned_ = false;  // loop only
  bool has_answered_ = false;  // loop only: Paho may report one connect twice
  Handover<Event> events_;     // to the loop
  BrokerSocket socket_;
  Handover<Publication> publications_;     // to the lane
  std::atomic<std::size_t> unwritten_{0};  // QoS 0 that Paho has
  Handover<std::uint64_t> written_;        // of them
  std::atomic<std::size_t> inbound_waiting_{0};
  std::atomic<std::uint64_t> inbound_dropped_{0};

  // The tokens and options outlive the client, which is destroyed first.
  mqtt::ssl_options tls_options_;
  mqtt::connect_options connect_options_;
  std::unique_ptr<ConnectListener> connect_listener_;
  std::unique_ptr<PublishListener> publish_listener_;
  std::unique_ptr<SubscribeListener> subscribe_listener_;
  mqtt::token_ptr connect_token_;
  mqtt::token_ptr disconnect_token_;
  std::unique_ptr<mqtt::async_client> client_;  // lane only
  BrokerLimits limits_;                         // lane only
  /// Lane only. Goes before the client: with the last client Paho forgets what it has allocated,
  /// and does not free it any more.
  std::optional<PublishForm> publish_form_;
};

}  // namespace slamgw
