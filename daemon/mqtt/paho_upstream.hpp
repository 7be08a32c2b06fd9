// SPDX-License-Identifier: Apache-2.0
// The broker link: one PahoSession at a time, reconnected for ever with back-off (Paho's own
// automatic reconnect is mute), MQTT 5 with fallback to 3.1.1. Knows nothing of robots; the outbox
// decides what is published again.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/thread_pool.hpp>
#include <functional>
#include <memory>
#include <optional>
#include <random>
#include <string>

#include "daemon/mqtt/backoff.hpp"
#include "daemon/mqtt/paho_session.hpp"
#include "daemon/mqtt/send_nudge.hpp"
#include "daemon/mqtt/upstream_link.hpp"

namespace slamgw {

class PahoUpstream final : public UpstreamLink, public PahoSessionListener {
 public:
  PahoUpstream(boost::asio::io_context& io, BrokerSettings settings, LastWill will,
               UpstreamListener& listener);
  ~PahoUpstream() override;

  /// Asked before each attempt to connect: what the credentials file says by now. May be empty.
  using ReadCredentials = std::function<std::optional<Credentials>()>;
  void read_credentials_with(ReadCredentials read) { read_credentials_ = std::move(read); }

  void start();
  /// The configuration was read again: connects anew when it differs.
  void reconfigure(const BrokerSettings& settings);
  /// The network has changed: does not wait out the back-off.
  void retry_now();
  /// Orderly: what was published before is written, then DISCONNECT. Blocks up to about a second;
  /// nothing comes after it.
  void stop();

  void publish(std::uint64_t sequence, BrokerMessage message) override;
  void subscribe(const std::string& filter, Qos qos, std::uint32_t id) override;
  void unsubscribe(const std::string& filter) override;

  MqttVersion version() const { return version_.version(); }

 private:
  void connect();
  void connect_in(Duration wait);
  void reconnect_later(const std::string& why);
  void drop_session(bool is_orderly);
  void watch_progress();
  bool adapt_will(int code);

  void on_connected(bool session_present, const BrokerLimits& limits) override;
  void on_connect_failed(ConnectFailure failure) override;
  void on_lost(std::string why) override;
  void on_published(std::uint64_t sequence) override;
  void on_publish_refused(std::uint64_t sequence, const Refusal& refusal) override;
  void on_subscribe_result(const std::string& filter, bool granted) override;
  void on_message(BrokerMessage message, std::vector<std::uint32_t> subscriptions) override;

  boost::asio::io_context& io_;
  boost::asio::thread_pool lane_{1};
  BrokerSettings settings_;
  LastWill will_;
  UpstreamListener& listener_;
  boost::asio::steady_timer reconnect_timer_;
  boost::asio::steady_timer nudge_timer_;
  Backoff backoff_;
  std::minstd_rand random_;
  VersionChoice version_;
  std::shared_ptr<PahoSession> session_;
  bool is_up_ = false;
  bool is_waiting_ = false;  ///< for reconnect_timer_
  unsigned attempt_ = 0;
  TimePoint up_since_{};
  unsigned short_lives_ = 0;  ///< connections in a row that did not last
  ReadCredentials read_credentials_;
  SendNudge nudge_;
  bool is_nudge_armed_ = false;
};

}  // namespace slamgw
