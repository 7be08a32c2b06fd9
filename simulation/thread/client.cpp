// SPDX-License-Identifier: Apache-2.0
#include "simulation/thread/client.hpp"

#include <algorithm>
#include <utility>

namespace slamgw::sim::sn {
namespace {

constexpr std::string_view will_message = "Disconnected";

}  // namespace

Client::Client(ClientSettings settings, const RobotBody& body)
    : settings_(settings), exchanges_(std::move(settings), body) {}

void Client::on_start(TimePoint now) { state_due_ = now + settings_.start_delay; }

std::optional<TimePoint> Client::deadline() const {
  switch (state_) {
    case State::waiting:
    case State::searching:
    case State::connecting:
    case State::disconnecting: return state_due_;
    case State::falling_asleep:
    case State::asleep:
    case State::awake:
    case State::resuming: return first_of(state_due_, exchanges_.next_update());
    case State::unconnected: return exchanges_.next_update();
    case State::stranded:
    case State::finished: return std::nullopt;
    case State::active: break;
  }
  return first_of(first_of(ping_due_, exchanges_.next_update()), exchanges_.deadline());
}

void Client::on_deadline(TimePoint now) {
  const bool is_producing = has_session() || state_ == State::unconnected;
  if (is_producing) exchanges_.produce(now);
  if (state_ == State::unconnected) return exchanges_.publish_unconnected();
  if (state_ == State::active) {
    if (ping_due_ <= now) ping(now);
    exchanges_.on_deadline(now);
    fill(now);
  } else if (state_due_ <= now) {
    on_state_deadline(now);
  }
}

void Client::on_state_deadline(TimePoint now) {
  switch (state_) {
    case State::waiting:
      if (settings_.qos < 0) {
        state_ = State::unconnected;
        return exchanges_.start_producing(now);
      }
      return search(now);
    case State::searching: return search(now);
    case State::connecting:
    case State::falling_asleep:
    case State::awake:
    case State::resuming: return repeat_state_request(now);
    case State::asleep: ++exchanges_.tally().wakes; return begin(State::awake, now);
    case State::disconnecting: state_ = State::finished; return;
    case State::unconnected:
    case State::active:
    case State::stranded:
    case State::finished: return;
  }
}

/// Returns true if the gateway has a session of this client, as far as the client knows.
bool Client::has_session() const {
  switch (state_) {
    case State::active:
    case State::falling_asleep:
    case State::asleep:
    case State::awake:
    case State::resuming: return true;
    case State::waiting:
    case State::unconnected:
    case State::searching:
    case State::connecting:
    case State::stranded:
    case State::disconnecting:
    case State::finished: return false;
  }
  return false;
}

void Client::search(TimePoint now) {
  exchanges_.abandon();
  state_ = State::searching;
  send(searchgw(1));
  state_due_ = now + std::min<Duration>(search_time, settings_.retry_interval);
}

void Client::begin(State state, TimePoint now) {
  state_ = state;
  state_sends_ = 0;
  repeat_state_request(now);
}

/// After three requests without an answer, the gateway is gone or has lost the session.
void Client::repeat_state_request(TimePoint now) {
  if (state_sends_ >= transmissions) return search(now);
  send(state_request());
  ++state_sends_;
  state_due_ = now + state_interval();
}

Bytes Client::state_request() const {
  const auto keep_alive_s = static_cast<std::uint16_t>(settings_.keep_alive.count());
  switch (state_) {
    case State::falling_asleep:
      return disconnect(static_cast<std::uint16_t>(settings_.sleep.count()));
    case State::awake: return pingreq(settings_.client_id);
    case State::resuming: return connect(settings_.client_id, keep_alive_s, 0);  // section 6.14
    case State::waiting:
    case State::unconnected:
    case State::searching:
    case State::connecting:
    case State::active:
    case State::asleep:
    case State::stranded:
    case State::disconnecting:
    case State::finished: break;
  }
  const std::uint8_t clean = settings_.is_clean ? flag_clean_session : std::uint8_t{0};
  return connect(settings_.client_id, keep_alive_s, static_cast<std::uint8_t>(flag_will | clean));
}

/// A sleeping robot wakes after 4/5 of its duration, which leaves time for three tries within the
/// tolerance of section 7.2.
Duration Client::state_interval() const {
  if (state_ == State::connecting || settings_.sleep.count() == 0) return settings_.retry_interval;
  return std::min<Duration>(settings_.retry_interval, Duration(settings_.sleep) / 5);
}

void Client::fall_asleep(TimePoint now) {
  state_ = State::asleep;
  state_due_ = now + Duration(settings_.sleep) * 4 / 5;
}

void Client::on_connack(std::uint8_t return_code, TimePoint now) {
  if (return_code == congestion) state_ = State::stranded;
  if (return_code != accepted) return;  // only logged; CONNECT is repeated until it times out
  const bool is_resumed = std::exchange(state_, State::active) == State::resuming;
  was_connected_ = true;
  ping_due_ = now + settings_.keep_alive;
  ping_sends_ = 0;
  is_resumed ? exchanges_.resume(now) : exchanges_.begin(now);
}

void Client::ping(TimePoint now) {
  if (ping_sends_ >= transmissions) return search(now);
  send(pingreq(settings_.client_id));
  ++ping_sends_;
  ping_due_ = now + settings_.retry_interval;
}

/// Sends waiting messages; sleeps, if configured, when there are none.
void Client::fill(TimePoint now) {
  if (state_ != State::active) return;
  const bool is_idle = exchanges_.fill(now);
  if (is_idle && settings_.sleep.count() > 0) begin(State::falling_asleep, now);
}

void Client::on_datagram(ByteView datagram, TimePoint now) {
  const std::optional<Packet> packet = decode(datagram);
  if (!packet) return;
  const bool is_disconnect = packet->type == Type::disconnect;
  switch (state_) {
    case State::searching:
      // Gateway id 0 makes Nordic's connect fail; the address in GWINFO is ignored.
      if (packet->type == Type::gwinfo && packet->gateway_id != 0) begin(State::connecting, now);
      break;
    case State::connecting: on_will_request(*packet); [[fallthrough]];
    case State::resuming:
      if (packet->type == Type::connack) on_connack(packet->return_code, now);
      break;
    case State::active: on_active(*packet, now); break;
    case State::falling_asleep:
      if (!exchanges_.on_gateway_request(*packet) && is_disconnect) fall_asleep(now);
      break;
    case State::awake: on_awake(*packet, now); break;
    case State::disconnecting:
      if (is_disconnect) state_ = State::finished;
      break;
    case State::waiting:
    case State::unconnected:
    case State::asleep:  // its radio is off
    case State::stranded:
    case State::finished: return;
  }
  if (state_ == State::active) fill(now);
}

void Client::on_will_request(const Packet& packet) {
  if (packet.type == Type::willtopicreq) send(willtopic(exchanges_.will_topic(), 0));
  if (packet.type == Type::willmsgreq) send(willmsg(will_message));
}

void Client::on_active(const Packet& packet, TimePoint now) {
  if (packet.type == Type::disconnect && settings_.resumes) return begin(State::resuming, now);
  const bool is_unknown_topic =
      packet.type == Type::puback && packet.return_code == invalid_topic_id;
  if (is_unknown_topic && settings_.resumes) return search(now);  // its session is gone
  if (packet.type == Type::pingresp) {
    ping_due_ = now + settings_.keep_alive;
    ping_sends_ = 0;
    return;
  }
  if (!exchanges_.on_gateway_request(packet)) exchanges_.on_answer(packet, now);
}

/// PINGRESP ends the buffered messages; the robot publishes, or sleeps again.
void Client::on_awake(const Packet& packet, TimePoint now) {
  if (exchanges_.on_gateway_request(packet)) {
    state_sends_ = 1;  // the gateway answers, so the count of tries restarts
    state_due_ = now + state_interval();
  } else if (packet.type == Type::disconnect) {
    search(now);  // the gateway has lost the session
  } else if (packet.type == Type::pingresp) {
    exchanges_.has_updates() ? begin(State::resuming, now) : fall_asleep(now);
  }
}

/// A robot that vanishes sends nothing; others wait for the answer to their DISCONNECT.
void Client::on_stop(TimePoint now) {
  const bool is_polite = has_session() && !settings_.vanishes;
  state_ = is_polite ? State::disconnecting : State::finished;
  if (!is_polite) return;
  send(disconnect());
  state_due_ = now + goodbye_time;
}

bool Client::has_sent_everything() const {
  return is_stranded() || is_finished() || exchanges_.has_sent_everything();
}

}  // namespace slamgw::sim::sn
