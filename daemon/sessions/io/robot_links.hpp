// SPDX-License-Identifier: Apache-2.0
// The connections of robots' sessions, through libmosquitto on the loop's own thread: thousands
// share one tick and one TLS context. Only the look-up of the broker's name and the files of TLS
// run on a thread of their own. Decides nothing: RobotSessions says what to open.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <cstdint>
#include <memory>
#include <string>
#include <unordered_map>
#include <vector>

#include "daemon/mqtt/connection_probe.hpp"
#include "daemon/mqtt/settings.hpp"
#include "daemon/mqtt/tls_client.hpp"
#include "daemon/mqtt/version_choice.hpp"
#include "daemon/sessions/session_action.hpp"

namespace slamgw::sessions {

struct AttachFailure {
  std::string why;
  bool is_id_refused = false;     ///< the broker does not let this gateway use the client id
  bool is_without_files = false;  ///< the process may not open more
};

/// On the loop's thread, never from inside a call to RobotLinks, and for a robot none after
/// close().
class RobotLinksListener {
 public:
  virtual ~RobotLinksListener() = default;
  /// The gateway's own broker is known by name and address: sessions may be opened.
  virtual void on_ready() = 0;
  virtual void on_attached(const std::string& robot, bool is_present) = 0;
  virtual void on_attach_failed(const std::string& robot, const AttachFailure& failure) = 0;
  virtual void on_detached(const std::string& robot) = 0;
  virtual void on_subscribed(const std::string& robot, const std::string& filter,
                             bool is_granted) = 0;
  virtual void on_message(const std::string& robot, BrokerMessage message,
                          std::vector<std::uint32_t> ids) = 0;
  virtual void on_fence(const std::string& robot, std::uint64_t number) = 0;
};

class RobotLink;

class RobotLinks {
 public:
  /// As long as the gateway keeps an absent client's session.
  static constexpr std::uint32_t session_expiry_s = 86400;
  /// Unacknowledged commands that the broker sends ahead.
  static constexpr std::uint16_t receive_maximum = 16;
  /// From OpenSession to CONNACK.
  static constexpr std::chrono::seconds connect_timeout{10};

  RobotLinks(boost::asio::io_context& io, RobotLinksListener& listener);
  ~RobotLinks();
  RobotLinks(const RobotLinks&) = delete;
  RobotLinks& operator=(const RobotLinks&) = delete;

  /// The gateway's own connection has found this broker, with this version. Answered by
  /// on_ready(). Connections to another one are closed.
  void use(const BrokerSettings& broker, MqttVersion version);

  void open(const std::string& robot, const std::string& client_id, bool is_clean);
  void close(const std::string& robot, bool is_forgotten);
  void subscribe(const std::string& robot, const std::string& filter, Qos qos, std::uint32_t id,
                 bool wants_retained);
  void unsubscribe(const std::string& robot, const std::string& filter);
  void ask_fence(const std::string& robot, std::uint64_t number, const std::string& own_topic);
  void publish(const std::string& robot, const std::string& topic, const std::string& text);
  /// Closes all; waits for nothing.
  void stop();

 private:
  friend class RobotLink;

  /// What all connections share, and keep while they last.
  struct Broker {
    BrokerSettings settings;
    MqttVersion version = MqttVersion::v5;
    HostAddresses addresses;
    std::unique_ptr<TlsClient> tls;
  };

  /// What the thread that resolves knows of this object, which does not wait for it:
  /// getaddrinfo() may hang.
  struct Asker;

  void on_resolved(std::shared_ptr<Broker> broker);
  RobotLink* find(const std::string& robot);
  void remove(const std::string& robot);
  void await_tick();

  boost::asio::io_context& io_;
  RobotLinksListener& listener_;
  boost::asio::steady_timer tick_;
  const std::shared_ptr<Asker> asker_;
  std::shared_ptr<const Broker> broker_;
  std::uint64_t resolving_ = 0;  ///< the last use()
  std::uint64_t attempts_ = 0;   ///< a host may have several addresses: each attempt tries the next
  bool is_stopped_ = false;
  std::unordered_map<std::string, std::shared_ptr<RobotLink>> links_;
};

}  // namespace slamgw::sessions
