// SPDX-License-Identifier: Apache-2.0
// One Thread robot: the MQTT-SN client of Nordic's nRF5 SDK as the thesis's robots use it, with its
// timing and its quirks. No socket and no clock: after every input the caller sends what
// `next_datagram()` gives and calls `on_deadline` when `deadline()` has passed.
//
// Quirks kept: retransmission after 8 s, twice, byte-identical, DUP never set; at most 4 requests
// outstanding; return codes 02 and 03 are ignored, so that the request runs into its time-out; a
// CONNACK 01 strands the robot; command topics are known by their REGACK only; any inbound PUBLISH
// above QoS 0 gets a PUBACK; PINGREQ always names the client; an unasked DISCONNECT and a PINGREQ
// from the gateway are ignored.
// Kinder than the original: MsgId wraps at 65535 instead of sticking at 1; registrations that timed
// out are tried again; after a ping time-out the robot searches again; it does not wait for ever
// for the reply to its DISCONNECT.
// On request it does what Nordic's client leaves to the application or can't do: sleep (section
// 6.14), take up its session from a new address, change its will, publish without a session.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "simulation/robot_body.hpp"
#include "simulation/tally.hpp"
#include "simulation/thread/packet.hpp"
#include "simulation/time.hpp"
#include "simulation/update_record.hpp"

namespace slamgw::sim::sn {

constexpr std::chrono::seconds retransmission_interval{8};
constexpr unsigned transmissions = 3;        // the first and two repeats
constexpr std::size_t max_outstanding = 4;   // Nordic's queue; the specification has 1
constexpr std::size_t max_application = 25;  // the robots' FIFO of 512 bytes (thesis 6.2.2)
constexpr std::chrono::seconds search_time{5};
constexpr std::chrono::seconds goodbye_time{3};

struct ClientSettings {
  std::string client_id;
  std::string topic_prefix = "ntnu-slam";
  int qos = 1;                            ///< -1: on `predefined_id`, without ever connecting
  std::optional<std::uint64_t> messages;  ///< updates to send; nothing: no end
  Duration period = std::chrono::milliseconds{200};
  Duration start_delay{0};  ///< the client's random wait before SEARCHGW
  bool obeys = false;       ///< commands steer the robot
  std::chrono::seconds keep_alive{60};
  bool is_clean = true;           ///< CleanSession of the CONNECT that begins a session
  std::chrono::seconds sleep{0};  ///< duration in DISCONNECT; 0: it never sleeps
  Duration will_interval{0};      ///< between changes of the will; 0: none
  bool resumes = false;   ///< takes up its session when told DISCONNECT; Nordic's client does not
  bool vanishes = false;  ///< ends without DISCONNECT
  Duration retry_interval = retransmission_interval;
  std::size_t outstanding = max_outstanding;
  bool is_recorded = false;         ///< leaves events
  std::uint16_t predefined_id = 0;  ///< of the topic `update`, for QoS -1
};

class Client {
 public:
  /// `is_unacknowledged_update`: losing it loses an update that nothing repeats (QoS 0).
  struct Outgoing {
    Bytes datagram;
    bool is_unacknowledged_update = false;
  };

  Client(ClientSettings settings, const RobotBody& body);

  void on_start(TimePoint now);
  void on_datagram(ByteView datagram, TimePoint now);
  void on_deadline(TimePoint now);
  /// Says goodbye; `is_finished()` once the gateway has answered, or has not for 3 s.
  void on_stop(TimePoint now);
  /// The robot has a new address, which it does not tell the gateway by itself.
  void on_moved() { ++tally_.roamed; }
  /// An unacknowledged update was dropped on purpose.
  void on_update_dropped() { ++tally_.lost; }

  std::optional<TimePoint> deadline() const;
  std::optional<Outgoing> next_datagram();
  std::optional<UpdateEvent> next_event();

  /// All `messages` are sent and, above QoS 0, acknowledged or given up. True for a stranded robot
  /// too: it will never send again.
  bool has_sent_everything() const;
  bool is_finished() const { return state_ == State::finished; }
  bool is_stranded() const { return state_ == State::stranded; }
  bool was_connected() const { return was_connected_; }
  const Tally& tally() const { return tally_; }
  const std::string& id() const { return settings_.client_id; }

 private:
  enum class State {
    waiting,
    unconnected,  ///< QoS -1
    searching,
    connecting,
    active,
    falling_asleep,
    asleep,
    awake,
    resuming,  ///< CONNECT without CleanSession: from sleep or a new address
    stranded,
    disconnecting,
    finished
  };
  enum class Kind { register_topic, subscribe, publish, release, will_topic, will_message };
  enum Topic : std::uint8_t { adv, update, cmd, run, will, will_updated };
  static constexpr std::size_t registered_topics = 4;  // adv .. run

  struct Setup {
    Kind kind;
    Topic topic;
  };
  struct Message {
    Topic topic;
    Bytes payload;
    std::uint64_t number = 0;  ///< of an update
  };
  struct Request {
    Kind kind;
    Topic topic;
    std::uint16_t msg_id;
    Bytes datagram;
    TimePoint due;
    unsigned sends = 1;
    std::uint64_t number = 0;  ///< of an update
  };

  // client.cpp: the session
  bool has_session() const;
  void search(TimePoint now);
  void begin(State state, TimePoint now);
  Bytes state_request() const;
  void repeat_state_request(TimePoint now);
  Duration state_interval() const;
  void fall_asleep(TimePoint now);
  void on_state_deadline(TimePoint now);
  void on_will_request(const Packet& packet);
  void on_connack(std::uint8_t return_code, TimePoint now);
  void start_session(TimePoint now);
  void resume_session(TimePoint now);
  void on_active(const Packet& packet, TimePoint now);
  void on_awake(const Packet& packet, TimePoint now);

  // client_requests.cpp: what it asks and says in its session
  bool on_gateway_request(const Packet& packet);
  void on_answer(const Packet& packet, TimePoint now);
  bool answers(Type answer, Kind request) const;
  void finish(const Request& request, std::uint16_t topic_id);
  void on_pubrec(const Packet& packet, TimePoint now);
  void on_publish(const Packet& packet);
  void on_register(const Packet& packet);
  void on_command(Topic topic, ByteView payload);

  void repeat_requests(TimePoint now);
  void give_up(const Request& request);
  void ping(TimePoint now);
  void produce(TimePoint now);
  void fill(TimePoint now);
  void plan_will_update(TimePoint now);
  void start_setup(Setup setup, TimePoint now);
  Bytes setup_request(const Setup& setup, std::uint16_t msg_id) const;
  void start_publish(TimePoint now);
  void publish_unconnected();

  std::string topic_name(Topic topic) const;
  std::uint16_t next_msg_id();
  std::vector<Request>::iterator find_request(std::uint16_t msg_id);
  void record(bool is_acknowledged, std::uint64_t number, Bytes payload);
  void send(Bytes datagram) { outbox_.push_back({std::move(datagram), false}); }

  ClientSettings settings_;
  RobotBody body_;
  State state_ = State::waiting;
  bool was_connected_ = false;
  TimePoint state_due_{};  ///< when to repeat the request of this state, or to leave it
  unsigned state_sends_ = 0;
  TimePoint ping_due_{};
  unsigned ping_sends_ = 0;
  std::optional<TimePoint> next_update_;  ///< nothing until the topics are registered
  std::uint64_t produced_ = 0;
  std::uint16_t last_msg_id_ = 0;
  std::optional<TimePoint> next_will_update_;
  std::optional<std::uint16_t> topic_ids_[registered_topics];
  std::deque<Setup> setup_;           ///< not yet sent; at most 6, and one for the will
  std::deque<Message> application_;   ///< at most max_application
  std::vector<Request> outstanding_;  ///< at most `settings_.outstanding`
  std::deque<Outgoing> outbox_;
  std::deque<UpdateEvent> events_;
  Tally tally_;
};

}  // namespace slamgw::sim::sn
