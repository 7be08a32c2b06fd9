// SPDX-License-Identifier: Apache-2.0
// The connection to the broker, or to one of several: one MqttLink at a time, reconnected for ever.
// Tries the list once without a pause, and then with back-off; MQTT 5 with fallback to 3.1.1. Keeps
// to the broker's limits. Knows nothing of robots; the outbox decides which messages are published
// again.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/thread_pool.hpp>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "daemon/core/recycling_allocator.hpp"
#include "daemon/mqtt/backoff.hpp"
#include "daemon/mqtt/mqtt_link.hpp"
#include "daemon/mqtt/stall_watch.hpp"
#include "daemon/mqtt/upstream_listener.hpp"
#include "daemon/runtime/timer.hpp"

namespace slamgw {

/// Properties of a program's connections that are not in its configuration.
struct ConnectionTraits {
  MakeLink make_link;
  LastWill will{};
  std::uint32_t max_inbound_octets = max_inbound_packet_octets;
  /// The broker has forgotten a message that is unanswered for this time, while it answers others:
  /// Upstream connects again, and the outbox publishes the message again.
  std::chrono::seconds longest_answer{60};
  /// The packaged service's file, to correct when the broker refuses the user. Empty: the user was
  /// typed.
  std::string credentials_file = "/etc/slam-gateway/credentials.json";
  /// Explanation when the broker wants a user and none is configured.
  std::string without_credentials =
      "(no user name was sent): give one in broker.credentials_file, for the packaged service in "
      "/etc/slam-gateway/credentials.json, and restart";
};

class Upstream final : private MqttLinkListener {
 public:
  Upstream(boost::asio::io_context& io, BrokerSettings settings, ConnectionTraits traits,
           UpstreamListener& listener);
  ~Upstream() override;

  /// Called before each attempt to connect: returns the present contents of the credentials file.
  /// May be empty.
  using ReadCredentials = std::function<std::optional<Credentials>()>;
  void read_credentials_with(ReadCredentials read) { read_credentials_ = std::move(read); }

  void start();
  /// Call when the configuration was read again. Reconnects when it differs.
  void reconfigure(const BrokerSettings& settings);
  /// Call when the network has changed. Does not wait for the end of the back-off.
  void retry_now();
  /// Writes the published messages, then DISCONNECT. Blocks up to about a second; no event comes
  /// after it.
  void stop();

  // No effect while the link is down:
  /// `is_trial`: the broker may close the connection for the message. Then the back-off starts
  /// again from its first step; the outbox makes sure that such messages are rare.
  void publish(std::uint64_t sequence, const BrokerMessage& message, bool is_trial = false);
  /// Subscribes at QoS 0.
  void subscribe(const std::string& filter);
  void unsubscribe(const std::string& filter);

  MqttVersion version() const { return place().version.version(); }
  /// The settings of the broker that is connected, or tried now.
  BrokerSettings broker() const;
  /// Returns the address of that broker; the nodes of a cluster have one in common.
  std::string common_uri() const;
  /// The addresses and TLS files of the broker that is connected, or tried now.
  const WayToBroker& way() const { return way_; }
  /// Number of the broker's messages for which there was no room on the way to the loop.
  std::uint64_t inbound_dropped() const;

 private:
  /// One broker of the list, and what was learnt about it.
  struct Place {
    BrokerAddress address;
    VersionChoice version;
    LastWill will;
    /// Over MQTT 3.1.1 a broker announces no limit, and one that takes QoS 2 for QoS 1 answers with
    /// PUBACK, at which libmosquitto ends the connection.
    Qos max_qos = Qos::exactly_once;
    unsigned attempt = 0;
  };

  Place& place() { return places_[at_]; }
  const Place& place() const { return places_[at_]; }
  void make_places();
  void connect();
  void connect_by(WayToBroker way);
  void connect_in(Duration wait);
  void go_on(const std::string& why, Duration least);
  void drop_link(bool is_orderly);
  std::chrono::seconds keep_alive_in_use() const;
  void come_up();
  void probe_first_broker_in(Duration wait);
  void probe_first_broker();
  void publish_will();
  void return_to_first();
  double random_jitter();
  void watch_for_stall();
  void on_stall_deadline(TimePoint now);
  bool has_forgotten_a_message(TimePoint now) const;
  void on_answered(std::uint64_t sequence);
  bool fits_packet(std::uint64_t sequence, const BrokerMessage& message);
  bool adapt_will(int code);

  void on_connected(const BrokerLimits& limits) override;
  void on_connect_failed(ConnectFailure failure) override;
  void on_lost(std::string why, LossCause cause) override;
  void on_published(std::uint64_t sequence) override;
  void on_publish_refused(std::uint64_t sequence, int code) override;
  void on_subscribe_result(const std::string& filter, bool granted) override;
  void on_unsubscribed(const std::string& filter) override;

  boost::asio::io_context& io_;
  boost::asio::thread_pool lane_{1};  ///< for blocking calls of a link
  BrokerSettings settings_;
  const ConnectionTraits traits_;
  UpstreamListener& listener_;
  Timer reconnect_timer_;
  Timer stall_timer_;
  Timer return_timer_;
  /// For probing the first broker, which blocks; made when it is needed.
  std::optional<boost::asio::thread_pool> scout_;
  Backoff return_backoff_;
  StallWatch stall_watch_;
  Backoff backoff_;
  std::minstd_rand random_;
  std::vector<Place> places_;
  std::size_t at_ = 0;                   ///< in `places_`
  std::size_t tried_ = 0;                ///< places tried in a row, without success or pause
  std::shared_ptr<const bool> look_up_;  ///< null when none is under way
  WayToBroker way_;
  std::shared_ptr<MqttLink> link_;
  BrokerLimits limits_;  ///< of the connection
  bool is_up_ = false;
  bool is_waiting_ = false;  ///< for reconnect_timer_
  TimePoint up_since_{};
  /// QoS 1 and 2 messages on the present connection, and when each was handed over.
  std::map<std::uint64_t, TimePoint, std::less<>,
           RecyclingAllocator<std::pair<const std::uint64_t, TimePoint>>>
      unanswered_;
  std::uint64_t last_answered_ = 0;     ///< the highest that the broker has answered
  TimePoint answered_at_{};             ///< when the broker last answered one
  std::optional<std::uint64_t> trial_;  ///< a publish that is not answered yet
  bool has_sent_qos_2_ = false;         ///< on the present connection
  TimePoint refused_at_{};              ///< when the broker last refused a publish
  RivalWatch rivals_;
  ReadCredentials read_credentials_;
  std::uint64_t inbound_dropped_ = 0;  ///< of former links
};

}  // namespace slamgw
