// SPDX-License-Identifier: Apache-2.0
// The broker link through Eclipse Paho. Each connection has a new client, which sheds Paho's
// tokens, retry state and lost wake-ups; Paho's own automatic reconnect reports nothing. Every Paho
// call is made on the lane, a separate thread, because connect resolves names under Paho's global
// lock. Paho's callbacks come on Paho's threads and do only one thing: post to the loop.
#pragma once

#include <mqtt/async_client.h>
#include <boost/asio/io_context.hpp>
#include <boost/asio/thread_pool.hpp>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "daemon/core/time.hpp"
#include "daemon/mqtt/mqtt_link.hpp"
#include "daemon/mqtt/paho/paho_message.hpp"
#include "daemon/runtime/timer.hpp"

namespace slamgw {

/// A queue from one thread to another, in order. Items that are given before the consumer takes
/// them cost it one wake-up together. The producer limits the length. May be called on any thread.
template <class Item>
class Handover {
 public:
  /// Returns the queue length. At 1, wake the consumer, which must then take().
  std::size_t give(Item item) {
    const std::lock_guard lock(mutex_);
    items_.push_back(std::move(item));
    return items_.size();
  }

  /// Removes and returns all items.
  std::vector<Item> take() {
    const std::lock_guard lock(mutex_);
    return std::exchange(items_, {});
  }

 private:
  std::mutex mutex_;
  std::vector<Item> items_;
};

/// Returns the sequence number with these lower 32 bits. It is at most `highest`, and less than
/// 2^32 below it.
constexpr std::uint64_t restore_sequence(std::uint32_t lower, std::uint64_t highest) {
  return highest - (static_cast<std::uint32_t>(highest) - lower);
}

/// Decides when to wake Paho's send thread with another request. The thread can miss its signal and
/// then sleeps for up to a second on a message (eclipse-paho/paho.mqtt.c 1.3.x). A request is due
/// when messages are in flight, and none was acknowledged or published for a while. Pure.
class SendNudge {
 public:
  /// The wait is this multiple of the usual time to an acknowledgement, within these limits. A
  /// broker on this host answers within a millisecond; a distant one needs more time.
  static constexpr int patience = 4;
  static constexpr std::chrono::milliseconds shortest_wait{3};
  static constexpr std::chrono::milliseconds first_wait{25};
  /// A broker that is only slow must not be flooded: each wait is twice the last one.
  static constexpr std::chrono::milliseconds longest_wait{1600};

  void on_publish(TimePoint now) {
    ++in_flight_;
    if (sample_left_ == 0) {
      sample_left_ = in_flight_;
      sample_begin_ = now;
    }
    on_progress(now);
  }
  void on_acknowledged(TimePoint now) {
    in_flight_ -= in_flight_ > 0 ? 1 : 0;
    if (sample_left_ > 0 && --sample_left_ == 0) usual_ += (now - sample_begin_ - usual_) / 8;
    on_progress(now);
  }

  /// Returns nothing when no message is in flight.
  std::optional<TimePoint> deadline() const {
    if (in_flight_ == 0) return std::nullopt;
    return last_progress_ + wait_;
  }
  /// Returns true when a nudge is due, and counts it as given.
  bool take(TimePoint now) {
    if (in_flight_ == 0 || now < last_progress_ + wait_) return false;
    last_progress_ = now;
    wait_ = std::min<Duration>(2 * wait_, longest_wait);
    return true;
  }

 private:
  void on_progress(TimePoint now) {
    last_progress_ = now;
    wait_ = std::clamp<Duration>(patience * usual_, shortest_wait, first_wait);
  }

  std::size_t in_flight_ = 0;
  TimePoint last_progress_{};
  Duration wait_ = first_wait;
  // One message at a time is watched from its publish to its acknowledgement, by counting.
  std::size_t sample_left_ = 0;  ///< acknowledgements until its own; 0: none is watched
  TimePoint sample_begin_{};
  Duration usual_ = Duration{first_wait} / patience;  ///< smoothed
};

/// Sets options of the socket of the broker's connection, which Paho does not expose.
class BrokerSocket {
 public:
  BrokerSocket() = default;
  ~BrokerSocket() { forget(); }
  BrokerSocket(const BrokerSocket&) = delete;
  BrokerSocket& operator=(const BrokerSocket&) = delete;

  /// Finds this process's connection to that port and sets TCP_NODELAY, which Paho does not. With
  /// Nagle's algorithm a message would wait until the broker has acknowledged the TCP segment
  /// before, at QoS 0 for up to 40 ms. Call once, on any thread.
  void adopt(std::uint16_t broker_port);
  /// Collects the data written from now on, until release() sends them together; the kernel waits
  /// 200 ms at most. Has no effect before adopt(). Call on any thread.
  void gather() { cork(1); }
  void release() { cork(0); }
  /// Has the kernel discard unsent data when the connection is closed.
  void discard_on_close();
  /// Closes the duplicate. Do not call while gather() or release() may run.
  void forget();

 private:
  void cork(int on);

  /// A duplicate: Paho may close its own at any time, and the number may then be another file's.
  std::atomic<int> descriptor_{-1};
};

class PahoLink final : public MqttLink,
                       public std::enable_shared_from_this<PahoLink>,
                       private mqtt::callback,
                       private mqtt::iaction_listener {
 public:
  /// Limits of messages that wait between Paho's receive thread and the loop; beyond them, messages
  /// are dropped and counted.
  static constexpr std::size_t max_inbound_waiting = 10000;
  static constexpr std::size_t max_inbound_waiting_octets = std::size_t{32} * 1024 * 1024;
  /// Cap on Paho's own queue; the outbox's windows stay well below it.
  static constexpr int max_buffered_in_paho = 512;

  PahoLink(boost::asio::io_context& io, boost::asio::thread_pool& lane, LinkOptions options,
           MqttLinkListener& listener);
  ~PahoLink() override;

  void connect() override;
  void publish(std::uint64_t sequence, const BrokerMessage& message) override;
  void subscribe(std::string filter) override;
  void unsubscribe(std::string filter) override;
  void abandon(bool is_orderly) override;
  std::uint64_t inbound_dropped() const override { return inbound_dropped_; }

 private:
  /// Batch size for reporting written QoS 0 messages to the loop; fewer are reported when nothing
  /// else waits to be written. Half of what the outbox hands over at once, so that the outbox never
  /// waits for the rest of a batch.
  static constexpr std::size_t written_at_once = 16;

  /// Paho checks every four seconds for a connect that takes too long.
  static constexpr std::chrono::seconds connect_grace{5};

  struct Publication {
    std::uint64_t sequence;
    BrokerMessage message;
  };

  // On the loop's thread:
  void on_acknowledged();
  void watch_progress();
  /// Wakes Paho's send thread if it sleeps on an unsent message, because its signal was lost.
  void nudge();
  /// Reports a connect that takes too long. Paho 1.3.12 waits by the wall clock between its checks:
  /// when that is set back by an hour, Paho would not notice a silent broker for an hour.
  void watch_connect();

  // On Paho's threads; the link destroys the client before its own end, which ends all callbacks:
  void on_success(const mqtt::token& token) override;
  void on_failure(const mqtt::token& token) override;
  void connection_lost(const std::string& cause) override;
  void message_arrived(mqtt::const_message_ptr message) override;

  // On the lane:
  void open();
  std::string host_of_attempt() const;
  void close(bool is_orderly);
  void set_connect_options();
  void set_tls_options();

  void publish_all();
  // On Paho's threads:
  void on_connack(const mqtt::token& token);
  void report_answer(const mqtt::token& token, std::optional<int> refusal);
  void report_suback(const mqtt::token& token, bool is_granted);
  void report_unsuback(const mqtt::token& token);
  std::uint64_t sequence_of(const mqtt::token& token) const;
  void on_written(std::uint64_t sequence);

  using Event = std::function<void(MqttLinkListener&)>;
  void post_to_loop(Event event);
  void post_to_lane(std::function<void(PahoLink&)> work);
  void report_failure(int code);
  ConnectFailure explain_failure(int code, bool is_in_time) const;
  void report_lost(std::string why, LossCause cause = LossCause::unknown);
  void report_ended(int reason);

  boost::asio::io_context& io_;
  boost::asio::thread_pool& lane_;
  const LinkOptions options_;
  const BrokerSettings& settings_;  ///< of `options_`
  MqttLinkListener& listener_;
  Timer nudge_timer_;
  Timer connect_timer_;
  SendNudge nudge_;
  bool is_nudge_armed_ = false;
  std::chrono::steady_clock::time_point opened_{};
  bool is_abandoned_ = false;  // loop only
  bool has_answered_ = false;  // loop only: Paho may report one connect twice
  Handover<Event> events_;     // to the loop
  BrokerSocket socket_;
  Handover<Publication> publications_;     // to the lane
  std::atomic<std::uint64_t> highest_{0};  // sequence number that Paho was given; they rise
  std::atomic<std::size_t> unwritten_{0};  // QoS 0 messages that Paho has
  Handover<std::uint64_t> written_;        // QoS 0 messages that were written, to the loop
  std::atomic<std::size_t> inbound_waiting_{0};
  std::atomic<std::size_t> inbound_octets_{0};
  std::atomic<std::uint64_t> inbound_dropped_{0};

  // The tokens and options outlive the client, which is destroyed first.
  mqtt::ssl_options tls_options_;
  mqtt::connect_options connect_options_;
  mqtt::token_ptr connect_token_;
  mqtt::token_ptr disconnect_token_;
  std::unique_ptr<mqtt::async_client> client_;  // lane only
  /// Lane only. Destroyed before the client: with the last client Paho forgets its allocations, and
  /// no longer frees them.
  std::optional<PublishForm> publish_form_;
};

}  // namespace slamgw
