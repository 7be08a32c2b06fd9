// SPDX-License-Identifier: Apache-2.0
#include "simulation/thread/client.hpp"

#include <algorithm>
#include <utility>

namespace slamgw::sim::sn {
namespace {

constexpr std::string_view will_message = "Disconnected";
constexpr auto keep_alive_seconds = static_cast<std::uint16_t>(keep_alive.count());

bool is_stop_word(std::string_view word) {
  return word == "0" || word == "off" || word == "pause" || word == "stop";
}

}  // namespace

Client::Client(ClientSettings settings, RobotBody body)
    : settings_(std::move(settings)), body_(std::move(body)) {
  application_.push_back({adv, body_.introduction()});
}

void Client::on_start(TimePoint now) { handshake_due_ = now + settings_.start_delay; }

std::optional<Client::Outgoing> Client::next_datagram() {
  if (outbox_.empty()) return std::nullopt;
  Outgoing first = std::move(outbox_.front());
  outbox_.pop_front();
  return first;
}

std::optional<TimePoint> Client::deadline() const {
  switch (state_) {
    case State::waiting:
    case State::searching:
    case State::connecting:
    case State::disconnecting: return handshake_due_;
    case State::stranded:
    case State::finished: return std::nullopt;
    case State::active: break;
  }
  std::optional<TimePoint> next = first_of(ping_due_, next_update_);
  for (const Request& request : outstanding_) next = first_of(next, request.due);
  return next;
}

void Client::on_deadline(TimePoint now) {
  if (state_ == State::active) {
    if (ping_due_ <= now) ping(now);
    repeat_requests(now);
    if (next_update_ && *next_update_ <= now) produce(now);
    fill(now);
  } else if (handshake_due_ <= now) {
    on_handshake_deadline(now);
  }
}

void Client::on_handshake_deadline(TimePoint now) {
  switch (state_) {
    case State::waiting:
    case State::searching: search(now); return;
    case State::connecting:
      if (connect_sends_ >= transmissions) {
        search(now);
        return;
      }
      send(connect(settings_.client_id, keep_alive_seconds, flag_will | flag_clean_session));
      ++connect_sends_;
      handshake_due_ = now + retransmission_interval;
      return;
    case State::disconnecting: state_ = State::finished; return;
    case State::active:
    case State::stranded:
    case State::finished: return;
  }
}

void Client::search(TimePoint now) {
  for (const Request& request : std::exchange(outstanding_, {})) give_up(request);
  setup_.clear();
  state_ = State::searching;
  send(searchgw(1));
  handshake_due_ = now + search_time;
}

void Client::begin_connect(TimePoint now) {
  state_ = State::connecting;
  connect_sends_ = 0;
  on_handshake_deadline(now);
}

void Client::on_connack(std::uint8_t return_code, TimePoint now) {
  if (return_code == congestion) state_ = State::stranded;
  if (return_code != accepted) return;  // only logged; CONNECT is repeated until it times out
  state_ = State::active;
  was_connected_ = true;
  ping_due_ = now + keep_alive;
  ping_sends_ = 0;
  std::fill(std::begin(topic_ids_), std::end(topic_ids_), std::nullopt);
  for (const Topic topic : {adv, update, cmd, run}) setup_.push_back({Kind::register_topic, topic});
  for (const Topic topic : {cmd, run}) setup_.push_back({Kind::subscribe, topic});
}

void Client::on_datagram(ByteView datagram, TimePoint now) {
  const std::optional<Packet> packet = decode(datagram);
  if (!packet) return;
  if (state_ == State::disconnecting) {
    if (packet->type == Type::disconnect) state_ = State::finished;
    return;
  }
  if (state_ == State::searching) {
    // Gateway id 0 makes Nordic's connect fail; the address in GWINFO is ignored.
    if (packet->type == Type::gwinfo && packet->gateway_id != 0) begin_connect(now);
    return;
  }
  if (state_ == State::connecting) {
    if (packet->type == Type::willtopicreq) send(willtopic(topic_name(topic_count), 0));
    if (packet->type == Type::willmsgreq) send(willmsg(will_message));
    if (packet->type == Type::connack) on_connack(packet->return_code, now);
  } else if (state_ == State::active) {
    on_answer(*packet, now);
  }
  if (state_ == State::active) fill(now);
}

void Client::on_answer(const Packet& packet, TimePoint now) {
  if (packet.type == Type::pingresp) {
    ping_due_ = now + keep_alive;
    ping_sends_ = 0;
    return;
  }
  if (packet.type == Type::publish) return on_publish(packet);
  if (packet.type == Type::register_topic) {
    return send(regack(packet.topic_id, packet.msg_id, accepted));
  }
  if (packet.type == Type::pubrec) return on_pubrec(packet, now);
  const auto request = find_request(packet.msg_id);
  if (request == outstanding_.end() || !answers(packet.type, request->kind)) return;
  const bool is_setup = request->kind == Kind::register_topic || request->kind == Kind::subscribe;
  if (packet.return_code == congestion && !is_setup) {
    give_up(*request);  // Nordic's client forgets the message
  } else if (packet.return_code != accepted) {
    return;  // only logged: the request stays and runs into its time-out
  } else if (packet.type == Type::regack) {
    topic_ids_[request->topic] = packet.topic_id;
  } else if (request->topic == update && !is_setup) {
    ++tally_.acknowledged;
  }
  outstanding_.erase(request);
}

bool Client::answers(Type answer, Kind request) const {
  switch (request) {
    case Kind::register_topic: return answer == Type::regack;
    case Kind::subscribe: return answer == Type::suback;
    case Kind::publish: return answer == Type::puback;
    case Kind::release: return answer == Type::pubcomp;
  }
  return false;
}

void Client::on_pubrec(const Packet& packet, TimePoint now) {
  send(qos2_step(Type::pubrel, packet.msg_id));  // also for an unknown MsgId: a PUBREL got lost
  const auto request = find_request(packet.msg_id);
  if (request == outstanding_.end() || request->kind != Kind::publish) return;
  request->kind = Kind::release;
  request->datagram = qos2_step(Type::pubrel, packet.msg_id);
  request->due = now + retransmission_interval;
  request->sends = 1;
}

void Client::on_publish(const Packet& packet) {
  if (packet.qos() != 0) send(puback(packet.topic_id, packet.msg_id, accepted));
  for (const Topic topic : {cmd, run}) {
    if (topic_ids_[topic] == packet.topic_id) on_command(topic, packet.payload);
  }
}

void Client::on_command(Topic topic, ByteView payload) {
  ++tally_.commands_received;
  if (!settings_.obeys) return;
  if (topic == cmd && payload.size() == 4) {
    body_.head_for(get_i16_le(payload, 0), get_i16_le(payload, 2));
  }
  if (topic == run) body_.set_running(!is_stop_word(std::string(payload.begin(), payload.end())));
}

void Client::repeat_requests(TimePoint now) {
  for (auto request = outstanding_.begin(); request != outstanding_.end();) {
    if (request->due > now) {
      ++request;
    } else if (request->sends < transmissions) {
      send(request->datagram);
      ++request->sends;
      request->due = now + retransmission_interval;
      ++request;
    } else {
      give_up(*request);
      request = outstanding_.erase(request);
    }
  }
}

void Client::give_up(const Request& request) {
  switch (request.kind) {
    case Kind::register_topic:
    case Kind::subscribe: setup_.push_back({request.kind, request.topic}); return;
    case Kind::publish:
    case Kind::release:
      if (request.topic == update) ++tally_.lost;
      return;
  }
}

void Client::ping(TimePoint now) {
  if (ping_sends_ >= transmissions) return search(now);
  send(pingreq(settings_.client_id));
  ++ping_sends_;
  ping_due_ = now + retransmission_interval;
}

void Client::produce(TimePoint now) {
  const bool is_full = application_.size() >= max_application;
  if (settings_.messages && produced_ >= *settings_.messages) {
    next_update_.reset();
    return;
  }
  *next_update_ = std::max(*next_update_ + settings_.period, now);
  if (is_full && settings_.messages) return;  // nothing may be lost: the robot pauses
  ++produced_;
  Bytes payload = body_.next_update();
  if (is_full) {
    ++tally_.lost;
  } else {
    application_.push_back({update, std::move(payload)});
  }
}

void Client::fill(TimePoint now) {
  if (state_ != State::active) return;
  while (outstanding_.size() < max_outstanding && !setup_.empty()) {
    const Setup setup = setup_.front();
    setup_.pop_front();
    start_setup(setup, now);
  }
  if (!topic_ids_[adv] || !topic_ids_[update]) return;
  if (!next_update_ && produced_ == 0) next_update_ = now;
  while (!application_.empty() && (settings_.qos == 0 || outstanding_.size() < max_outstanding)) {
    start_publish(now);
  }
}

void Client::start_setup(Setup setup, TimePoint now) {
  const std::uint16_t msg_id = next_msg_id();
  const std::string name = topic_name(setup.topic);
  Bytes datagram = setup.kind == Kind::register_topic ? register_topic(msg_id, name)
                                                      : subscribe(1, msg_id, name);
  send(datagram);
  outstanding_.push_back(
      {setup.kind, setup.topic, msg_id, std::move(datagram), now + retransmission_interval});
}

void Client::start_publish(TimePoint now) {
  const Message message = std::move(application_.front());
  application_.pop_front();
  const bool is_update = message.topic == update;
  const std::uint16_t msg_id = settings_.qos == 0 ? std::uint16_t{0} : next_msg_id();
  Bytes datagram = publish(settings_.qos, *topic_ids_[message.topic], msg_id, message.payload);
  outbox_.push_back({datagram, is_update && settings_.qos == 0});
  if (is_update) ++tally_.sent;
  if (settings_.qos == 0) return;
  outstanding_.push_back(
      {Kind::publish, message.topic, msg_id, std::move(datagram), now + retransmission_interval});
}

void Client::on_stop(TimePoint now) {
  const bool has_session = state_ == State::active;
  state_ = has_session ? State::disconnecting : State::finished;
  if (!has_session) return;
  send(disconnect());
  handshake_due_ = now + goodbye_time;
}

bool Client::has_sent_everything() const {
  if (is_stranded() || is_finished()) return true;
  if (!settings_.messages || produced_ < *settings_.messages || !application_.empty()) return false;
  return std::none_of(outstanding_.begin(), outstanding_.end(), [](const Request& request) {
    return request.kind == Kind::publish || request.kind == Kind::release;
  });
}

/// `topic_count` names the will's topic: outside `update`, because old servers would draw its 12
/// octets as positions.
std::string Client::topic_name(Topic topic) const {
  static constexpr std::string_view name_list[] = {"adv", "update", "cmd", "run", "will"};
  const std::string_view branch = topic == cmd || topic == run ? "/server/" : "/robot/";
  return settings_.topic_prefix + std::string(branch) + settings_.client_id + "/" +
         std::string(name_list[topic]);
}

/// One counter for all requests; skips 0 and what is outstanding.
std::uint16_t Client::next_msg_id() {
  do {
    ++last_msg_id_;
  } while (last_msg_id_ == 0 || find_request(last_msg_id_) != outstanding_.end());
  return last_msg_id_;
}

std::vector<Client::Request>::iterator Client::find_request(std::uint16_t msg_id) {
  return std::find_if(outstanding_.begin(), outstanding_.end(),
                      [&](const Request& request) { return request.msg_id == msg_id; });
}

}  // namespace slamgw::sim::sn
