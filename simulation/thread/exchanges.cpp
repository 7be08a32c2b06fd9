// SPDX-License-Identifier: Apache-2.0
#include "simulation/thread/exchanges.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace slamgw::sim::sn {
namespace {

constexpr unsigned will_update_qos = 1;  // Nordic's WILLTOPICUPD

bool is_stop_word(std::string_view word) {
  return word == "0" || word == "off" || word == "pause" || word == "stop";
}

}  // namespace

Exchanges::Exchanges(ClientSettings settings, const RobotBody& body)
    : settings_(std::move(settings)), body_(body) {
  if (settings_.qos >= 0 && body_.introduces_itself()) {
    application_.push_back({adv, body_.introduction()});
  }
}

void Exchanges::begin(TimePoint now) {
  std::fill(std::begin(topic_ids_), std::end(topic_ids_), std::nullopt);
  for (const Topic topic : {adv, update, cmd, run}) setup_.push_back({Kind::register_topic, topic});
  for (const Topic topic : {cmd, run}) setup_.push_back({Kind::subscribe, topic});
  senders_.clear();
  if (settings_.hears) setup_.push_back({Kind::subscribe, others});
  if (settings_.will_interval > Duration::zero()) next_will_update_ = now + settings_.will_interval;
}

void Exchanges::resume(TimePoint now) {
  for (Request& request : outstanding_) {
    request.due = now;
    request.sends = 0;
  }
  repeat_requests(now);
}

void Exchanges::abandon() {
  for (const Request& request : std::exchange(outstanding_, {})) give_up(request);
  setup_.clear();
}

std::optional<Outgoing> Exchanges::next_datagram() {
  if (outbox_.empty()) return std::nullopt;
  Outgoing first = std::move(outbox_.front());
  outbox_.pop_front();
  return first;
}

std::optional<UpdateEvent> Exchanges::next_event() {
  if (events_.empty()) return std::nullopt;
  UpdateEvent first = std::move(events_.front());
  events_.pop_front();
  return first;
}

std::optional<TimePoint> Exchanges::deadline() const {
  std::optional<TimePoint> next = next_will_update_;
  for (const Request& request : outstanding_) next = first_of(next, request.due);
  return next;
}

void Exchanges::on_deadline(TimePoint now) {
  repeat_requests(now);
  plan_will_update(now);
}

bool Exchanges::has_sent_everything() const {
  if (!settings_.messages || produced_ < *settings_.messages || !application_.empty()) return false;
  return std::none_of(outstanding_.begin(), outstanding_.end(), [](const Request& request) {
    return request.kind == Kind::publish || request.kind == Kind::release;
  });
}

bool Exchanges::on_gateway_request(const Packet& packet) {
  if (packet.type == Type::publish) {
    on_publish(packet);
  } else if (packet.type == Type::register_topic) {
    on_register(packet);
  } else {
    return false;
  }
  return true;
}

void Exchanges::on_answer(const Packet& packet, TimePoint now) {
  if (packet.type == Type::pubrec) return on_pubrec(packet, now);
  const auto request = find_request(packet.msg_id);
  if (request == outstanding_.end() || !answers(packet.type, request->kind)) return;
  const bool is_message = request->kind == Kind::publish || request->kind == Kind::release;
  if (packet.return_code == congestion && is_message) {
    give_up(*request);  // Nordic's client forgets the message
  } else if (packet.return_code != accepted) {
    return;  // only logged: the request stays and runs into its time-out
  } else {
    finish(*request, packet.topic_id);
  }
  outstanding_.erase(request);
}

bool Exchanges::answers(Type answer, Kind request) {
  switch (request) {
    case Kind::register_topic: return answer == Type::regack;
    case Kind::subscribe: return answer == Type::suback;
    case Kind::publish: return answer == Type::puback;
    case Kind::release: return answer == Type::pubcomp;
    case Kind::will_topic: return answer == Type::willtopicresp;
    case Kind::will_message: return answer == Type::willmsgresp;
  }
  return false;
}

void Exchanges::finish(const Request& request, std::uint16_t topic_id) {
  switch (request.kind) {
    case Kind::register_topic: topic_ids_[request.topic] = topic_id; return;
    case Kind::subscribe: return;
    case Kind::publish:
    case Kind::release:
      if (request.topic != update) return;
      ++tally_.acknowledged;
      return record(UpdateEvent::Kind::acknowledged, request.number);
    case Kind::will_topic: setup_.push_front({Kind::will_message, will_updated}); return;
    case Kind::will_message: ++tally_.will_updates; return;
  }
}

void Exchanges::on_pubrec(const Packet& packet, TimePoint now) {
  send(qos2_step(Type::pubrel, packet.msg_id));  // also for an unknown MsgId: a PUBREL got lost
  const auto request = find_request(packet.msg_id);
  if (request == outstanding_.end() || request->kind != Kind::publish) return;
  request->kind = Kind::release;
  request->datagram = qos2_step(Type::pubrel, packet.msg_id);
  request->due = now + settings_.retry_interval;
  request->sends = 1;
}

void Exchanges::on_publish(const Packet& packet) {
  if (packet.qos() != 0) send(puback(packet.topic_id, packet.msg_id, accepted));
  for (const Topic topic : {cmd, run}) {
    if (topic_ids_[topic] == packet.topic_id) on_command(topic, packet);
  }
  const auto sender = senders_.find(packet.topic_id);
  if (sender != senders_.end()) on_heard(sender->second, packet);
}

/// Nordic's client ignores a REGISTER; one that resumes sessions must not (section 6.10).
void Exchanges::on_register(const Packet& packet) {
  send(regack(packet.topic_id, packet.msg_id, accepted));
  const std::string name(packet.payload.begin(), packet.payload.end());
  const std::string root = settings_.topic_prefix + "/robot/";
  if (settings_.hears && name.starts_with(root) && name != topic_name(update))
    senders_[packet.topic_id] = name.substr(root.size(), name.rfind('/') - root.size());
  if (!settings_.resumes) return;
  for (const Topic topic : {cmd, run}) {
    if (topic_name(topic) == name) topic_ids_[topic] = packet.topic_id;
  }
}

void Exchanges::on_heard(const std::string& sender, const Packet& packet) {
  ++tally_.heard[sender];
  if (settings_.is_recorded)
    events_.push_back({UpdateEvent::Kind::heard,
                       packet.msg_id,
                       Bytes(packet.payload.begin(), packet.payload.end()),
                       {},
                       sender});
}

void Exchanges::on_command(Topic topic, const Packet& packet) {
  const ByteView payload = packet.payload;
  ++tally_.commands_received;
  if (settings_.is_recorded) {
    events_.push_back({UpdateEvent::Kind::command, packet.msg_id,
                       Bytes(payload.begin(), payload.end()), topic == cmd ? "cmd" : "run"});
  }
  if (!settings_.obeys) return;
  if (topic == cmd && payload.size() == 4) {
    body_.head_for(get_i16_le(payload, 0), get_i16_le(payload, 2));
  }
  if (topic == run) body_.set_running(!is_stop_word(std::string(payload.begin(), payload.end())));
}

void Exchanges::repeat_requests(TimePoint now) {
  for (auto request = outstanding_.begin(); request != outstanding_.end();) {
    if (request->due > now) {
      ++request;
    } else if (request->sends < transmissions) {
      const bool is_update = request->kind == Kind::publish && request->topic == update;
      outbox_.push_back({request->datagram, false, is_update ? request->number : 0});
      if (is_update) record(UpdateEvent::Kind::repeated, request->number);
      ++request->sends;
      request->due = now + settings_.retry_interval;
      ++request;
    } else {
      give_up(*request);
      request = outstanding_.erase(request);
    }
  }
}

void Exchanges::give_up(const Request& request) {
  switch (request.kind) {
    case Kind::register_topic:
    case Kind::subscribe: setup_.push_back({request.kind, request.topic}); return;
    case Kind::publish:
    case Kind::release:
      if (request.topic != update) return;
      ++tally_.lost;
      return record(UpdateEvent::Kind::given_up, request.number);
    case Kind::will_topic:
    case Kind::will_message: return;  // the next change repeats both
  }
}

void Exchanges::produce(TimePoint now) {
  if (!next_update_ || *next_update_ > now) return;
  const bool is_full = application_.size() >= max_application;
  if (settings_.messages && produced_ >= *settings_.messages) {
    next_update_.reset();
    return;
  }
  *next_update_ = std::max(*next_update_ + settings_.period, now);
  if (is_full && settings_.messages) return;  // no update may be lost: the robot pauses
  ++produced_;
  Bytes payload = body_.next_message(produced_, now - first_update_);
  if (is_full) {
    ++tally_.lost;
    record(UpdateEvent::Kind::refused, produced_, std::move(payload));
  } else {
    application_.push_back({update, std::move(payload), produced_});
  }
}

bool Exchanges::fill(TimePoint now) {
  while (outstanding_.size() < settings_.outstanding && !setup_.empty()) {
    const Setup setup = setup_.front();
    setup_.pop_front();
    start_setup(setup, now);
  }
  if (!topic_ids_[adv] || !topic_ids_[update]) return false;
  if (!next_update_ && produced_ == 0) start_producing(now);
  while (!application_.empty() &&
         (settings_.qos == 0 || outstanding_.size() < settings_.outstanding)) {
    start_publish(now);
  }
  return setup_.empty() && outstanding_.empty() && application_.empty();
}

/// Allows one change at a time, as WILLTOPICRESP and WILLMSGRESP have no MsgId.
void Exchanges::plan_will_update(TimePoint now) {
  if (!next_will_update_ || *next_will_update_ > now) return;
  *next_will_update_ = now + settings_.will_interval;
  const auto is_of_will = [](const auto& one) {
    return one.kind == Kind::will_topic || one.kind == Kind::will_message;
  };
  if (std::any_of(setup_.begin(), setup_.end(), is_of_will) ||
      std::any_of(outstanding_.begin(), outstanding_.end(), is_of_will)) {
    return;
  }
  setup_.push_back({Kind::will_topic, will_updated});
}

void Exchanges::start_setup(Setup setup, TimePoint now) {
  const bool has_msg_id = setup.kind == Kind::register_topic || setup.kind == Kind::subscribe;
  const std::uint16_t msg_id = has_msg_id ? next_msg_id() : std::uint16_t{0};
  Bytes datagram = setup_request(setup, msg_id);
  send(datagram);
  outstanding_.push_back(
      {setup.kind, setup.topic, msg_id, std::move(datagram), now + settings_.retry_interval});
}

Bytes Exchanges::setup_request(const Setup& setup, std::uint16_t msg_id) const {
  switch (setup.kind) {
    case Kind::register_topic: return register_topic(msg_id, topic_name(setup.topic));
    case Kind::subscribe: return subscribe(1, msg_id, topic_name(setup.topic));
    case Kind::will_topic: return willtopicupd(topic_name(setup.topic), will_update_qos);
    case Kind::will_message:
      return willmsgupd(fmt::format("Disconnected after {}", tally_.will_updates + 1));
    case Kind::publish:
    case Kind::release: break;
  }
  return {};
}

void Exchanges::start_publish(TimePoint now) {
  Message message = std::move(application_.front());
  application_.pop_front();
  const bool is_update = message.topic == update;
  const auto qos = static_cast<unsigned>(settings_.qos);
  const std::uint16_t msg_id = qos == 0 ? std::uint16_t{0} : next_msg_id();
  Bytes datagram = publish(qos, *topic_ids_[message.topic], msg_id, message.payload);
  outbox_.push_back({datagram, is_update && qos == 0, message.number});
  if (is_update) {
    ++tally_.sent;
    record(UpdateEvent::Kind::sent, message.number, std::move(message.payload));
  }
  if (qos == 0) return;
  outstanding_.push_back({Kind::publish, message.topic, msg_id, std::move(datagram),
                          now + settings_.retry_interval, 1, message.number});
}

void Exchanges::publish_unconnected() {
  for (; !application_.empty(); application_.pop_front()) {
    Message& message = application_.front();
    outbox_.push_back(
        {sn::publish_unconnected(settings_.predefined_id, message.payload), true, message.number});
    ++tally_.sent;
    record(UpdateEvent::Kind::sent, message.number, std::move(message.payload));
  }
}

void Exchanges::record(UpdateEvent::Kind kind, std::uint64_t number, Bytes payload) {
  if (settings_.is_recorded) events_.push_back({kind, number, std::move(payload)});
}

void Exchanges::on_link_repeats(std::uint64_t number, unsigned count) {
  for (unsigned i = 0; i < count; ++i) record(UpdateEvent::Kind::link_repeated, number);
}

/// The wills are outside `update`, because old servers would draw their octets as positions.
std::string Exchanges::topic_name(Topic topic) const {
  if (topic == others) return settings_.topic_prefix + "/robot/+/update";
  static constexpr std::string_view name_list[] = {"adv", "update", "cmd",
                                                   "run", "will",   "will-updated"};
  const std::string_view branch = topic == cmd || topic == run ? "/server/" : "/robot/";
  const bool is_probe = topic == update && !body_.introduces_itself();
  return settings_.topic_prefix + std::string(branch) + settings_.client_id + "/" +
         std::string(is_probe ? "probe" : name_list[topic]);
}

/// Returns the next MsgId of all requests; skips 0 and outstanding ones.
std::uint16_t Exchanges::next_msg_id() {
  do {
    ++last_msg_id_;
  } while (last_msg_id_ == 0 || find_request(last_msg_id_) != outstanding_.end());
  return last_msg_id_;
}

std::vector<Exchanges::Request>::iterator Exchanges::find_request(std::uint16_t msg_id) {
  return std::find_if(outstanding_.begin(), outstanding_.end(),
                      [&](const Request& request) { return request.msg_id == msg_id; });
}

}  // namespace slamgw::sim::sn
