// SPDX-License-Identifier: Apache-2.0
// One connection through libmosquitto, from its attempt to its end, on the loop's own thread. The
// library is called when its socket can be read or written; its callbacks become events, which are
// reported after each call. Derived classes know the purpose of the connection: MosquittoLink (the
// gateway's and the page's own) and RobotLink (a robot's session).
#pragma once

#include <mosquitto.h>

#include <algorithm>
#include <boost/asio/io_context.hpp>
#include <boost/asio/posix/stream_descriptor.hpp>
#include <boost/asio/thread_pool.hpp>
#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "daemon/core/freed_by.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/mqtt/broker_limits.hpp"
#include "daemon/mqtt/mqtt_link.hpp"
#include "daemon/mqtt/tls_client.hpp"
#include "daemon/mqtt/user_properties.hpp"
#include "daemon/mqtt/version_choice.hpp"

namespace slamgw {

class MosquittoClient : public std::enable_shared_from_this<MosquittoClient> {
 public:
  /// The shortest that libmosquitto takes; replaces a shorter keep-alive in the settings.
  static constexpr std::chrono::seconds shortest_keep_alive{5};
  /// Time between calls of tick(). libmosquitto's unit of time is the whole second.
  static constexpr std::chrono::seconds tick_interval{1};
  /// Reason codes of the broker begin here; smaller numbers are libmosquitto's errors.
  static constexpr int first_reason = 0x80;

  MosquittoClient(const MosquittoClient&) = delete;
  MosquittoClient& operator=(const MosquittoClient&) = delete;
  virtual ~MosquittoClient();

 protected:
  struct Opening {
    const BrokerSettings& broker;
    const std::string& client_id;
    const std::string& address;  ///< a literal of the broker's host
    MqttVersion version = MqttVersion::v5;
    bool is_clean = true;
    const LastWill* will = nullptr;
    std::uint32_t max_inbound_octets = max_inbound_packet_octets;  ///< MQTT 5 only
    std::optional<std::uint16_t> receive_maximum{};
    std::uint32_t session_expiry_s = 0;  ///< MQTT 5 only
    /// Fails rather than use one of the last descriptors that the process may have.
    bool spares_descriptors = false;
  };
  struct Connack {
    int code;
    bool is_session_present;
    BrokerLimits limits;
  };
  struct Ended {
    int result;  ///< the library's error, or the reason code of the broker's DISCONNECT
    int error;   ///< errno
  };
  /// PUBACK, PUBCOMP, UNSUBACK, or a QoS 0 message that was written.
  struct Confirmed {
    int packet_id;
    int reason;
  };
  struct Arrived {
    BrokerMessage message;
    UserProperties said;
    std::vector<std::uint32_t> subscriptions;  ///< subscription identifiers; MQTT 5 only
  };
  enum class Farewell : std::uint8_t {
    none,
    abort,       ///< discards data that the kernel has not sent yet
    disconnect,  ///< DISCONNECT
    forget,      ///< DISCONNECT that also ends the session at the broker (MQTT 5)
  };

  explicit MosquittoClient(boost::asio::io_context& io);

  /// `tls` is null without TLS. Answered by on_connack() or on_ended().
  void open(const Opening& opening, std::shared_ptr<const TlsClient> tls);
  /// Does the keep-alive. Call every tick_interval, or every second one.
  void tick();
  /// Ends the connection with this errno; on_ended() comes after the present call.
  void give_up(int error) { after_call(MOSQ_ERR_ERRNO, error); }
  /// Ends the connection; no event comes after it.
  void end(Farewell farewell);
  /// As end(), but waits on `lane` until the broker has read all, for goodbye_timeout at most.
  void leave(boost::asio::thread_pool& lane);

  // Each returns the packet id; nothing when libmosquitto does not take the topic, or the
  // connection is over (is_over()).
  std::optional<int> publish(const std::string& topic, ByteView payload, Qos qos, bool is_retained,
                             const mosquitto_property* properties = nullptr);
  std::optional<int> subscribe(const std::string& filter, Qos qos, int options = 0,
                               const mosquitto_property* properties = nullptr);
  std::optional<int> unsubscribe(const std::string& filter);

  /// Removes the packet's entry from a list of packet ids and values, and returns its value.
  template <class Value>
  static std::optional<Value> take(std::vector<std::pair<int, Value>>& from, int packet_id) {
    const auto found = std::ranges::find(from, packet_id, &std::pair<int, Value>::first);
    if (found == from.end()) return std::nullopt;
    Value value = std::move(found->second);
    from.erase(found);
    return value;
  }

  bool is_reached() const { return is_reached_; }  ///< by TCP
  bool is_open() const { return is_open_; }        ///< CONNACK has come, and was good
  bool is_over() const { return is_over_; }        ///< the connection has ended or failed
  bool is_ended() const { return is_ended_; }      ///< end() or leave() was called
  /// The library's last error text, until the connection is open; with TLS only.
  const std::string& last_error() const { return last_error_; }

  const TlsClient* tls() const { return tls_.get(); }  ///< null: without TLS

  boost::asio::io_context& io_;

 protected:
  /// Writes at the end of the turn, so that its packets are sent together.
  void write_soon();

 private:
  struct Suback {
    int packet_id;
    bool is_granted;
  };
  using Event = std::variant<Connack, Ended, Confirmed, Suback, Arrived>;

  // Called on the loop's thread, never from inside a call to this object.
  virtual void on_connack(const Connack& connack) = 0;
  virtual void on_ended(const Ended& ended) = 0;
  virtual void on_confirmed(const Confirmed& confirmed) = 0;
  virtual void on_subscribed(const std::string& filter, bool is_granted) = 0;
  virtual void on_arrived(Arrived& arrived) = 0;
  /// Requests made here go out with what is about to be written.
  virtual void before_write() {}

  static MosquittoClient& of(void* object) { return *static_cast<MosquittoClient*>(object); }
  int start(const Opening& opening);
  void set_callbacks();
  void adopt_socket(bool spares_descriptors);
  bool duplicate(int descriptor, boost::asio::posix::stream_descriptor& to);
  template <class Then>
  void when_writable(Then then);
  void on_connection();
  void await_readable();
  void on_readable();
  void watch_handshake();
  void write();
  void cork(int on);
  std::optional<int> sent(int result, int packet_id);
  /// Call after each call into the library: ends the connection when `result` is an error.
  void after_call(int result, int error);
  void deliver();
  void report(Connack& connack);
  void report(Ended& ended) { on_ended(ended); }
  void report(Confirmed& confirmed) { on_confirmed(confirmed); }
  void report(Suback& suback) {
    if (const auto filter = take(subscribing_, suback.packet_id))
      on_subscribed(*filter, suback.is_granted);
  }
  void report(Arrived& arrived) { on_arrived(arrived); }
  void disconnect_and_wait();

  /// A duplicate, because the library may close its own socket at any time.
  boost::asio::posix::stream_descriptor socket_;
  /// Another duplicate, only while this object waits for writing: with one descriptor for both,
  /// Asio would also wake at once in each later wait for reading.
  boost::asio::posix::stream_descriptor writable_;
  bool is_v5_ = true;
  bool is_reached_ = false;
  bool is_open_ = false;
  Qos max_qos_ = Qos::exactly_once;  ///< the broker's; libmosquitto refuses a higher one
  bool is_over_ = false;
  bool is_ended_ = false;
  bool is_write_due_ = false;
  std::size_t unwritten_ = 0;  ///< packets that the next write() sends
  std::vector<Event> events_;
  std::vector<std::pair<int, std::string>> subscribing_;  ///< packet ids and filters
  std::string last_error_;
  int goodbye_socket_ = -1;               ///< lane only
  std::shared_ptr<const TlsClient> tls_;  ///< null: without TLS
  std::unique_ptr<mosquitto, FreedBy<mosquitto_destroy>> client_;
};

}  // namespace slamgw
