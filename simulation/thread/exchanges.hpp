// SPDX-License-Identifier: Apache-2.0
// The requests of a Thread robot within its session: registrations, subscriptions, updates and
// changes of its will, each repeated until it is answered, and its answers to the gateway. Client
// reports when the session begins, pauses and ends.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "simulation/robot_body.hpp"
#include "simulation/tally.hpp"
#include "simulation/thread/client_settings.hpp"
#include "simulation/thread/packet.hpp"
#include "simulation/update_record.hpp"

namespace slamgw::sim::sn {

/// `is_unacknowledged_update`: losing it loses an update that nothing repeats (QoS 0).
struct Outgoing {
  Bytes datagram;
  bool is_unacknowledged_update = false;
  std::uint64_t number = 0;  ///< of an update; else 0
};

class Exchanges {
 public:
  Exchanges(ClientSettings settings, const RobotBody& body);

  /// Call when the gateway has accepted a new session, whose topic ids are unknown.
  void begin(TimePoint now);
  /// Call when the gateway has resumed the session: topic ids stay, and unanswered requests are
  /// sent again.
  void resume(TimePoint now);
  /// Call when the session is lost, which drops unanswered requests.
  void abandon();

  /// Returns true for a request of the gateway, which it answers.
  bool on_gateway_request(const Packet& packet);
  void on_answer(const Packet& packet, TimePoint now);
  /// Call in an active session: sends repeats, and plans the change of the will.
  void on_deadline(TimePoint now);
  /// Returns the deadline of repeats and of the change of the will.
  std::optional<TimePoint> deadline() const;
  /// Sends as many messages as permitted; returns true when none waits and none is unanswered.
  bool fill(TimePoint now);

  /// Measures the next update when it is due, but never before the topics are registered or
  /// `start_producing` is called.
  void produce(TimePoint now);
  void start_producing(TimePoint now) { next_update_ = first_update_ = now; }
  void on_link_repeats(std::uint64_t number, unsigned count);
  std::optional<TimePoint> next_update() const { return next_update_; }
  bool has_updates() const { return !application_.empty(); }
  /// Sends all waiting messages at QoS -1.
  void publish_unconnected();

  void send(Bytes datagram) { outbox_.push_back({std::move(datagram), false}); }
  std::optional<Outgoing> next_datagram();
  std::optional<UpdateEvent> next_event();
  /// Returns true if all updates are sent and, above QoS 0, acknowledged or given up.
  bool has_sent_everything() const;

  std::string will_topic() const { return topic_name(will); }
  Tally& tally() { return tally_; }
  const Tally& tally() const { return tally_; }

 private:
  enum class Kind { register_topic, subscribe, publish, release, will_topic, will_message };
  enum Topic : std::uint8_t { adv, update, cmd, run, will, will_updated, others };
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

  static bool answers(Type answer, Kind request);
  void finish(const Request& request, std::uint16_t topic_id);
  void on_pubrec(const Packet& packet, TimePoint now);
  void on_publish(const Packet& packet);
  void on_register(const Packet& packet);
  void on_command(Topic topic, const Packet& packet);
  void on_heard(const std::string& sender, const Packet& packet);
  void repeat_requests(TimePoint now);
  void give_up(const Request& request);
  void plan_will_update(TimePoint now);
  void start_setup(Setup setup, TimePoint now);
  Bytes setup_request(const Setup& setup, std::uint16_t msg_id) const;
  void start_publish(TimePoint now);
  std::string topic_name(Topic topic) const;
  std::uint16_t next_msg_id();
  std::vector<Request>::iterator find_request(std::uint16_t msg_id);
  void record(UpdateEvent::Kind kind, std::uint64_t number, Bytes payload = {});

  ClientSettings settings_;
  RobotBody body_;
  std::optional<TimePoint> next_update_;
  TimePoint first_update_{};  ///< when the first was due
  std::uint64_t produced_ = 0;
  std::uint16_t last_msg_id_ = 0;
  std::optional<TimePoint> next_will_update_;
  std::optional<std::uint16_t> topic_ids_[registered_topics];
  std::map<std::uint16_t, std::string> senders_;  ///< other robots, by the topic id of `update`
  std::deque<Setup> setup_;                       ///< not yet sent; at most 7, and one for the will
  std::deque<Message> application_;               ///< at most max_application
  std::vector<Request> outstanding_;              ///< at most `settings_.outstanding`
  std::deque<Outgoing> outbox_;
  std::deque<UpdateEvent> events_;
  Tally tally_;
};

}  // namespace slamgw::sim::sn
