// SPDX-License-Identifier: Apache-2.0
// An ordinary MQTT client (libmosquitto) on a thread of its own, because resolving names waits.
// What happens there comes to the loop in batches; a loop that is behind loses messages, and they
// are counted. MQTT 5, or 3.1.1 where the broker knows no better. Connects again by itself.
#pragma once

#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <condition_variable>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <thread>
#include <variant>
#include <vector>

#include "daemon/mqtt/settings.hpp"
#include "web/server/mirror.hpp"

struct mosquitto;
struct mqtt5__property;

namespace slamgw::web {

class BrokerLink {
 public:
  /// Called on the loop's thread.
  struct Listener {
    std::function<void(const BrokerMessage&)> on_message;
    std::function<void(bool is_up, const std::string& why)> on_state;
    std::function<void(int message_id, const std::string& why)> on_refused;
    /// Until the next connection nothing of this filter comes.
    std::function<void(const std::string& filter, const std::string& why)> on_unreadable;
  };
  /// What waits for the loop: two seconds of a busy broker.
  static constexpr std::size_t max_waiting = 20'000;
  static constexpr std::size_t max_waiting_bytes = 32 << 20;
  static constexpr std::uint32_t max_packet = 4 << 20;  ///< twice max_gateway_payload
  /// What comes within so much reaches the loop together. A page draws a frame each 16 ms.
  static constexpr std::chrono::milliseconds gathering{10};

  BrokerLink(boost::asio::io_context& io, BrokerSettings settings, std::vector<std::string> filters,
             Listener listener);
  ~BrokerLink();
  BrokerLink(const BrokerLink&) = delete;
  BrokerLink& operator=(const BrokerLink&) = delete;

  /// At QoS 1. The message id, or nothing when the broker is away.
  std::optional<int> publish(const CommandRequest& command);
  std::uint64_t overruns() const { return overruns_; }  ///< messages that the loop did not get

 private:
  struct StateChange {
    bool is_up;
    std::string why;
  };
  struct Refusal {
    int message_id;
    std::string why;
  };
  struct Unreadable {
    std::string filter;
    std::string why;
  };
  using Happening = std::variant<BrokerMessage, StateChange, Refusal, Unreadable>;

  void set_up_client();
  void set_up_tls();
  void run();
  int stay_connected();
  int start_connection();
  void choose_version(int failure);
  void report_failure(int failure);
  bool wait(std::chrono::milliseconds time);
  void hand_over(Happening happening);
  void deliver();

  void go_to_next_broker();

  static BrokerLink& of(void* object) { return *static_cast<BrokerLink*>(object); }
  void on_connected(int reason);
  void on_subscribed(int message_id, int answer);
  void on_message(std::string topic, std::string payload, bool is_retained,
                  const mqtt5__property* properties);

  boost::asio::io_context& io_;
  const BrokerSettings settings_;
  const std::vector<BrokerAddress> places_;  ///< `broker.uri`, in its order
  std::size_t at_ = 0;                       ///< in `places_`; on the link's thread
  const std::vector<std::string> filters_;
  Listener listener_;

  std::mutex client_mutex_;  ///< held while `client_` is replaced or published with
  mosquitto* client_ = nullptr;
  bool is_version_5_ = true;
  int connack_ = 0;                   ///< the last reason code; on the link's thread
  std::string last_failure_;          ///< that the listener has
  std::string library_error_;         ///< of this connection, as libmosquitto logs it
  std::map<int, std::string> asked_;  ///< filters by message id; on the link's thread
  std::atomic<bool> is_up_ = false;
  std::atomic<std::uint64_t> overruns_ = 0;

  std::mutex mutex_;
  std::condition_variable wake_;
  bool is_stopping_ = false;
  std::vector<Happening> waiting_;
  std::size_t waiting_bytes_ = 0;
  bool is_delivery_due_ = false;      ///< deliver() is posted, or its timer runs
  boost::asio::steady_timer gather_;  ///< on the loop
  std::thread thread_;
};

}  // namespace slamgw::web
