// SPDX-License-Identifier: Apache-2.0
// One connection with a robot's client id, from its CONNECT to its end; never reused. Part of
// SessionHost.
#pragma once

#include <list>
#include <memory>
#include <string>
#include <utility>

#include "daemon/core/time.hpp"
#include "daemon/mqtt/connection_probe.hpp"
#include "daemon/mqtt/mosquitto/mosquitto_client.hpp"
#include "daemon/sessions/session_action.hpp"

namespace slamgw::sessions {

class SessionHost;

/// Shared and kept alive by all connections to one broker.
struct RobotBroker {
  BrokerSettings settings;
  WayToBroker way;
  MqttVersion version = MqttVersion::v5;
};

class RobotLink final : public MosquittoClient {
 public:
  /// The time for which the gateway keeps an absent client's session, too.
  static constexpr std::uint32_t session_expiry_s = 86400;
  /// Limit of commands that the broker sends without an acknowledgement. Mosquitto 2.0 exceeds it
  /// for QoS 2, which is accepted (MosquittoClient::start).
  static constexpr std::uint16_t receive_maximum = 16;
  /// Longest time from OpenSession to CONNACK.
  static constexpr std::chrono::seconds connect_timeout{10};

  using MosquittoClient::end;
  using MosquittoClient::Farewell;

  RobotLink(boost::asio::io_context& io, SessionHost& host,
            std::shared_ptr<const RobotBroker> broker, std::string robot);

  /// `address`: a literal of the broker's host.
  void open(const std::string& client_id, bool is_clean, const std::string& address);
  /// Refuses a filter that libmosquitto does not take: its packet exceeds the broker's limit.
  void subscribe(const SubscribeSession& wanted);
  /// A filter that libmosquitto does not take does not stand at the broker.
  void unsubscribe(const std::string& filter) { MosquittoClient::unsubscribe(filter); }
  /// The fences of one turn are one request: its answer stands for the lower numbers, too.
  void ask_fence(std::uint64_t number, const std::string& own_topic);
  void publish(const std::string& topic, const std::string& text);
  void on_tick();

 private:
  /// Ends the connection when a request could not be sent: a session that lacks it is of no use.
  std::optional<int> must_be_sent(std::optional<int> packet_id);

  void on_connack(const Connack& connack) override;
  void on_ended(const Ended& ended) override;
  void on_confirmed(const Confirmed& confirmed) override;
  void on_subscribed(const std::string& filter, bool is_granted) override;
  void on_arrived(Arrived& arrived) override;
  void before_write() override;

  SessionHost& host_;
  const std::shared_ptr<const RobotBroker> broker_;
  const std::string robot_;
  TimePoint give_up_at_{};
  std::optional<std::pair<std::uint64_t, std::string>> due_fence_;  ///< number and topic
  std::list<std::pair<int, std::uint64_t>> fences_;                 ///< packet ids and numbers
};

}  // namespace slamgw::sessions
