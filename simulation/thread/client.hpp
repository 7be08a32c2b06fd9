// SPDX-License-Identifier: Apache-2.0
// One Thread robot: the MQTT-SN client of Nordic's nRF5 SDK as the thesis's robots use it, with its
// timing and its quirks. No socket and no clock: after every input the caller sends the results of
// `next_datagram()` and calls `on_deadline` when `deadline()` has passed.
//
// Quirks kept: retransmission after 8 s, twice, byte-identical, DUP never set; at most 4 requests
// outstanding; return codes 02 and 03 are ignored, so that the request runs into its time-out; a
// CONNACK 01 strands the robot; command topics are recognized by their REGACK only; any inbound
// PUBLISH above QoS 0 gets a PUBACK; PINGREQ always names the client; an unexpected DISCONNECT and
// a PINGREQ from the gateway are ignored. Kinder than the original: MsgId wraps at 65535 instead of
// sticking at 1; registrations that timed out are tried again; after a ping time-out the robot
// searches again; the wait for the reply to its DISCONNECT is bounded. On request it has features
// that Nordic's client lacks or leaves to the application: sleep (section 6.14), resuming its
// session from a new address, changes of its will, publishing without a session.
#pragma once

#include <optional>
#include <string>

#include "simulation/thread/exchanges.hpp"

namespace slamgw::sim::sn {

class Client {
 public:
  Client(ClientSettings settings, const RobotBody& body);

  void on_start(TimePoint now);
  void on_datagram(ByteView datagram, TimePoint now);
  void on_deadline(TimePoint now);
  /// Sends DISCONNECT; `is_finished()` once the gateway has answered, or after 3 s.
  void on_stop(TimePoint now);
  /// Call when the robot has a new address, which it does not report to the gateway.
  void on_moved() { ++exchanges_.tally().roamed; }
  /// Call with the number of frames of this update that were sent again between two hops.
  void on_link_repeats(std::uint64_t number, unsigned count) {
    exchanges_.on_link_repeats(number, count);
  }
  /// Call when an unacknowledged update was dropped on purpose.
  void on_update_dropped() { ++exchanges_.tally().lost; }

  std::optional<TimePoint> deadline() const;
  std::optional<Outgoing> next_datagram() { return exchanges_.next_datagram(); }
  std::optional<UpdateEvent> next_event() { return exchanges_.next_event(); }

  /// Returns true if all `messages` are sent and, above QoS 0, acknowledged or given up, and for a
  /// stranded robot, which never sends again.
  bool has_sent_everything() const;
  bool is_finished() const { return state_ == State::finished; }
  bool is_stranded() const { return state_ == State::stranded; }
  bool was_connected() const { return was_connected_; }
  const Tally& tally() const { return exchanges_.tally(); }
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
  void on_active(const Packet& packet, TimePoint now);
  void on_awake(const Packet& packet, TimePoint now);

  void ping(TimePoint now);
  void fill(TimePoint now);
  void send(Bytes datagram) { exchanges_.send(std::move(datagram)); }

  ClientSettings settings_;
  Exchanges exchanges_;
  State state_ = State::waiting;
  bool was_connected_ = false;
  TimePoint state_due_{};  ///< when to repeat the request of this state, or to leave it
  unsigned state_sends_ = 0;
  TimePoint ping_due_{};
  unsigned ping_sends_ = 0;
};

}  // namespace slamgw::sim::sn
