// SPDX-License-Identifier: Apache-2.0
// One connection with a robot's client id, from its CONNECT to its end; never reused. Part of
// RobotLinks.
#pragma once

#include <mosquitto.h>

#include <boost/asio/posix/stream_descriptor.hpp>
#include <deque>
#include <memory>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "daemon/core/time.hpp"
#include "daemon/sessions/io/robot_links.hpp"

namespace slamgw::sessions {

class RobotLink : public std::enable_shared_from_this<RobotLink> {
 public:
  RobotLink(RobotLinks& links, std::shared_ptr<const RobotLinks::Broker> broker, std::string robot);
  ~RobotLink();

  void open(const std::string& client_id, bool is_clean, const std::string& address,
            TimePoint give_up_at);
  void subscribe(const std::string& filter, Qos qos, std::uint32_t id, bool wants_retained);
  void unsubscribe(const std::string& filter);
  void ask_fence(std::uint64_t number, const std::string& own_topic);
  void publish(const std::string& topic, const std::string& text);
  void on_tick(TimePoint now);
  /// DISCONNECT; `forget` also ends the session at the broker (MQTT 5).
  enum class Farewell : std::uint8_t { none, disconnect, forget };
  /// No event comes after it.
  void end(Farewell farewell);

 private:
  struct Destroy {
    void operator()(mosquitto* client) const { mosquitto_destroy(client); }
  };
  // What the callbacks leave:
  struct Answered {
    int code;
    bool is_present;
  };
  struct Subscribed {
    int packet_id;
    bool is_granted;
  };
  /// An UNSUBACK or a PUBACK.
  struct Confirmed {
    int packet_id;
  };
  struct Arrived {
    BrokerMessage message;
    std::vector<std::uint32_t> ids;
  };
  using Event = std::variant<Answered, Subscribed, Confirmed, Arrived>;

  static RobotLink& of(void* object) { return *static_cast<RobotLink*>(object); }
  void set_callbacks();
  bool duplicate(int descriptor, boost::asio::posix::stream_descriptor& to) const;
  void fail_to_open(int error);
  void await_connection();
  void await_readable();
  void on_readable();
  void watch_handshake();
  void write_soon();
  void write();
  void after_call(int result);
  void deliver();
  void handle(const Answered& answer);
  void handle(const Subscribed& subscribed);
  void handle(const Confirmed& confirmed);
  void handle(Arrived& arrived);

  RobotLinks& links_;
  const std::shared_ptr<const RobotLinks::Broker> broker_;
  const std::string robot_;
  /// Duplicates: the library closes its own socket whenever it likes. The second is there while
  /// something is to be written only.
  boost::asio::posix::stream_descriptor socket_;
  boost::asio::posix::stream_descriptor writable_;
  std::unique_ptr<mosquitto, Destroy> client_;
  TimePoint give_up_at_{};
  bool is_open_ = false;   ///< CONNACK has come
  bool is_over_ = false;   ///< the library has no connection any more
  bool is_ended_ = false;  ///< nothing is reported any more
  bool is_write_due_ = false;
  int error_ = 0;  ///< why it was not opened, if the system says
  std::vector<Event> events_;
  std::vector<std::pair<int, std::string>> subscribing_;  ///< packet ids and filters
  std::deque<std::pair<int, std::uint64_t>> fences_;      ///< packet ids and numbers
};

}  // namespace slamgw::sessions
