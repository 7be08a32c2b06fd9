// SPDX-License-Identifier: Apache-2.0
// The broker link through libmosquitto, on the loop's own thread: the library is called when its
// socket can be read or written, and its callbacks become events that are told after each call.
// Only what blocks before (the name, the files of TLS) and the goodbye run on the lane.
#pragma once

#include <mosquitto.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/posix/stream_descriptor.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/thread_pool.hpp>
#include <chrono>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "daemon/core/time.hpp"
#include "daemon/mqtt/connection_probe.hpp"
#include "daemon/mqtt/mosquitto/publish_properties.hpp"
#include "daemon/mqtt/mqtt_link.hpp"
#include "daemon/mqtt/tls_client.hpp"

namespace slamgw {

class MosquittoLink final : public MqttLink, public std::enable_shared_from_this<MosquittoLink> {
 public:
  /// The library takes no shorter one; that is used in place of a shorter one in the settings.
  static constexpr std::chrono::seconds shortest_keep_alive{5};

  MosquittoLink(boost::asio::io_context& io, boost::asio::thread_pool& lane, LinkOptions options,
                MqttLinkListener& listener);
  ~MosquittoLink() override;

  void connect() override;
  void publish(std::uint64_t sequence, const BrokerMessage& message) override;
  void subscribe(std::string filter) override;
  void unsubscribe(std::string filter) override;
  void abandon(bool is_orderly) override;
  std::uint64_t inbound_dropped() const override { return 0; }

 private:
  struct Destroy {
    void operator()(mosquitto* client) const { mosquitto_destroy(client); }
  };
  using Client = std::unique_ptr<mosquitto, Destroy>;

  // What the callbacks leave:
  struct Answered {  ///< CONNACK
    int code;
    BrokerLimits limits;
  };
  struct Ended {
    int result;  ///< the library's error, or the reason code of the broker's DISCONNECT
    int error;   ///< errno
  };
  struct Published {
    int packet_id;
    int reason;
  };
  struct Subscribed {
    int packet_id;
    bool granted;
  };
  struct Arrived {
    BrokerMessage message;
    UserProperties said;
  };
  struct NotSendable {
    std::uint64_t sequence;
  };
  using Event = std::variant<Answered, Ended, Published, Subscribed, Arrived, NotSendable>;

  // On the lane:
  void prepare();
  void disconnect_and_wait();

  void open(const HostAddresses& addresses);
  int start_client(const std::string& address);
  void set_callbacks();
  void adopt_socket();
  bool duplicate(int descriptor, boost::asio::posix::stream_descriptor& to);
  void await_connection();
  void on_connection();
  void await_readable();
  void await_writable();
  template <class Then>
  void when_writable(Then then);
  void await_tick();
  void on_readable();
  void watch_handshake();
  void on_tick();
  void write_soon();
  void write();
  void cork(int on);

  /// After each call into the library: ends the connection when it says so.
  void after_call(int result, int error);
  void deliver();
  void handle(const Answered& answer);
  void handle(const Ended& end);
  void handle(const Published& published);
  void handle(const Subscribed& subscribed);
  void handle(Arrived& arrived);
  void handle(const NotSendable& not_sendable);
  void fail(ConnectFailure failure);
  ConnectFailure explain_failure(const Ended& end) const;
  std::string explain_loss(const Ended& end) const;

  boost::asio::io_context& io_;
  boost::asio::thread_pool& lane_;
  const LinkOptions options_;
  const BrokerSettings& settings_;  ///< of `options_`
  MqttLinkListener& listener_;
  boost::asio::steady_timer timeout_;
  boost::asio::steady_timer tick_;
  /// A duplicate: the library closes its own whenever it likes.
  boost::asio::posix::stream_descriptor socket_;
  /// Another duplicate, only while the socket is to be written: Asio would look for that at each
  /// later wait for reading too, and find it at once.
  boost::asio::posix::stream_descriptor writable_;
  bool is_abandoned_ = false;
  bool has_failed_ = false;  ///< told on_connect_failed()
  bool is_reached_ = false;  ///< by TCP
  bool is_open_ = false;     ///< told on_connected()
  bool is_over_ = false;     ///< the library has no connection any more
  bool is_write_due_ = false;
  std::size_t unwritten_ = 0;  ///< packets that the next write() sends
  std::vector<Event> events_;
  std::vector<Event> delivered_;                          ///< those of the present deliver()
  std::vector<std::pair<int, std::uint64_t>> in_flight_;  ///< packet ids and sequences, in order
  std::vector<std::pair<int, std::string>> subscribing_;  ///< packet ids and filters
  std::string last_error_;                                ///< the library's, while it connects
  PublishProperties properties_;
  std::unique_ptr<TlsClient> tls_;
  int goodbye_socket_ = -1;  ///< lane only
  Client client_;            ///< goes before what it uses
};

/// As MakeLink says.
std::shared_ptr<MqttLink> make_mosquitto_link(boost::asio::io_context& io,
                                              boost::asio::thread_pool& lane, LinkOptions options,
                                              MqttLinkListener& listener);

}  // namespace slamgw
