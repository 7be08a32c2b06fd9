// SPDX-License-Identifier: Apache-2.0
// The session of a client: finding the gateway, connecting, sleeping, coming back, leaving.
#include "simulation/thread/client.hpp"

#include <algorithm>
#include <utility>

namespace slamgw::sim::sn {
namespace {

constexpr std::string_view will_message = "Disconnected";

}  // namespace

Client::Client(ClientSettings settings, const RobotBody& body)
    : settings_(std::move(settings)), body_(body) {
  if (settings_.qos >= 0) application_.push_back({adv, body_.introduction()});
}

void Client::on_start(TimePoint now) { state_due_ = now + settings_.start_delay; }

std::optional<Client::Outgoing> Client::next_datagram() {
  if (outbox_.empty()) return std::nullopt;
  Outgoing first = std::move(outbox_.front());
  outbox_.pop_front();
  return first;
}

std::optional<UpdateEvent> Client::next_event() {
  if (events_.empty()) return std::nullopt;
  UpdateEvent first = std::move(events_.front());
  events_.pop_front();
  return first;
}

std::optional<TimePoint> Client::deadline() const {
  switch (state_) {
    case State::waiting:
    case State::searching:
    case State::connecting:
    case State::disconnecting: return state_due_;
    case State::falling_asleep:
    case State::asleep:
    case State::awake:
    case State::resuming: return first_of(state_due_, next_update_);
    case State::unconnected: return next_update_;
    case State::stranded:
    case State::finished: return std::nullopt;
    case State::active: break;
  }
  std::optional<TimePoint> next = first_of(ping_due_, first_of(next_update_, next_will_update_));
  for (const Request& request : outstanding_) next = first_of(next, request.due);
  return next;
}

void Client::on_deadline(TimePoint now) {
  const bool is_producing = has_session() || state_ == State::unconnected;
  if (is_producing && next_update_ && *next_update_ <= now) produce(now);
  if (state_ == State::unconnected) return publish_unconnected();
  if (state_ == State::active) {
    if (ping_due_ <= now) ping(now);
    repeat_requests(now);
    plan_will_update(now);
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
        next_update_ = now;
        return;
      }
      return search(now);
    case State::searching: return search(now);
    case State::connecting:
    case State::falling_asleep:
    case State::awake:
    case State::resuming: return repeat_state_request(now);
    case State::asleep: ++tally_.wakes; return begin(State::awake, now);
    case State::disconnecting: state_ = State::finished; return;
    case State::unconnected:
    case State::active:
    case State::stranded:
    case State::finished: return;
  }
}

/// The gateway holds state for it, as far as it knows.
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
  for (const Request& request : std::exchange(outstanding_, {})) give_up(request);
  setup_.clear();
  state_ = State::searching;
  send(searchgw(1));
  state_due_ = now + std::min<Duration>(search_time, settings_.retry_interval);
}

void Client::begin(State state, TimePoint now) {
  state_ = state;
  state_sends_ = 0;
  repeat_state_request(now);
}

/// Three times without an answer: the gateway is gone or does not know it any more.
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

/// A sleeping robot wakes after 4/5 of its duration and has the rest for three tries, within the
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
  is_resumed ? resume_session(now) : start_session(now);
}

void Client::start_session(TimePoint now) {
  std::fill(std::begin(topic_ids_), std::end(topic_ids_), std::nullopt);
  for (const Topic topic : {adv, update, cmd, run}) setup_.push_back({Kind::register_topic, topic});
  for (const Topic topic : {cmd, run}) setup_.push_back({Kind::subscribe, topic});
  if (settings_.will_interval > Duration::zero()) next_will_update_ = now + settings_.will_interval;
}

/// Topic ids stay; what was not answered at the old address is said again at once.
void Client::resume_session(TimePoint now) {
  for (Request& request : outstanding_) {
    request.due = now;
    request.sends = 0;
  }
  repeat_requests(now);
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
      if (!on_gateway_request(*packet) && is_disconnect) fall_asleep(now);
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
  if (packet.type == Type::willtopicreq) send(willtopic(topic_name(will), 0));
  if (packet.type == Type::willmsgreq) send(willmsg(will_message));
}

void Client::on_active(const Packet& packet, TimePoint now) {
  if (packet.type == Type::disconnect && settings_.resumes) return begin(State::resuming, now);
  const bool is_unknown_topic =
      packet.type == Type::puback && packet.return_code == invalid_topic_id;
  if (is_unknown_topic && settings_.resumes) return search(now);  // its session is gone
  if (!on_gateway_request(packet)) on_answer(packet, now);
}

/// PINGRESP ends what the gateway has kept; the robot goes on to publish, or back to sleep.
void Client::on_awake(const Packet& packet, TimePoint now) {
  if (on_gateway_request(packet)) {
    state_sends_ = 1;  // the gateway is there: patience anew
    state_due_ = now + state_interval();
  } else if (packet.type == Type::disconnect) {
    search(now);  // the gateway does not know it any more
  } else if (packet.type == Type::pingresp) {
    application_.empty() ? fall_asleep(now) : begin(State::resuming, now);
  }
}

/// A robot that vanishes says nothing; others wait for the answer to their DISCONNECT.
void Client::on_stop(TimePoint now) {
  const bool is_polite = has_session() && !settings_.vanishes;
  state_ = is_polite ? State::disconnecting : State::finished;
  if (!is_polite) return;
  send(disconnect());
  state_due_ = now + goodbye_time;
}

bool Client::has_sent_everything() const {
  if (is_stranded() || is_finished()) return true;
  if (!settings_.messages || produced_ < *settings_.messages || !application_.empty()) return false;
  return std::none_of(outstanding_.begin(), outstanding_.end(), [](const Request& request) {
    return request.kind == Kind::publish || request.kind == Kind::release;
  });
}

}  // namespace slamgw::sim::sn
