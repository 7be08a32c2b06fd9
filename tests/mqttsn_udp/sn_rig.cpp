// SPDX-License-Identifier: Apache-2.0
#include "tests/mqttsn_udp/sn_rig.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <utility>

namespace slamgw::mqttsn {

SnRig::SnRig(Settings settings, std::vector<RobotName> names,
             std::vector<std::string> extra_publish, std::vector<std::string> extra_subscribe,
             RandomSource random)
    : policy(TopicScheme("ntnu-slam", "gw"), std::move(extra_publish), std::move(extra_subscribe)),
      gateway(std::move(settings), policy, RobotNames(std::move(names)), std::move(random),
              [](std::string_view) { return lowest_topic_id; }) {
  broker_link(true);
  multicasts.clear();
}

Endpoint SnRig::address(unsigned n) {
  Endpoint endpoint;
  endpoint.address = {0xfd, 0x00};
  if (n >= first_ipv4) endpoint.address = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff, 10, 0};
  endpoint.address[14] = static_cast<std::uint8_t>(n >> 8);
  endpoint.address[15] = static_cast<std::uint8_t>(n);
  endpoint.port = 47193;
  return endpoint;
}

LocalAddress SnRig::local() {
  LocalAddress local;
  local.address = {0xfd, 0x00, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff};
  return local;
}

void SnRig::send(unsigned n, const Packet& packet) { send_octets(n, encode(packet)); }

void SnRig::send_octets(unsigned n, ByteView octets) {
  if (are_addresses_validated) gateway.validate(address(n).address);
  const auto identity = proven.find(n);
  gateway.on_datagram(address(n), local(), octets, now,
                      identity == proven.end() ? std::string() : identity->second);
  drain();
}

void SnRig::connect(unsigned n, const std::string& id, bool clean, std::uint16_t duration_s) {
  send(n, Connect{false, clean, protocol_id, duration_s, id});
  sent_to(n);
}

std::uint16_t SnRig::register_topic(unsigned n, const std::string& topic) {
  sent_to(n);
  send(n, Register{0, ++msg_id_, topic});
  const SendDatagram& answer = datagrams.back();
  sent_to(n);
  return std::get<Regack>(*decode(answer.bytes)).topic_id;
}

void SnRig::subscribe(unsigned n, const std::string& filter, unsigned qos) {
  Subscribe request;
  request.qos = static_cast<WireQos>(qos);
  request.msg_id = ++msg_id_;
  request.topic_name = filter;
  send(n, request);
  sent_to(n);
}

void SnRig::prove(unsigned n, const std::string& id, std::uint16_t duration_s) {
  connect(n, id, false, duration_s);
  subscribe(n, "a/" + id, 1);
  broker("a/" + id, "hi", 1);
  const std::string published = last_to(n);
  unsigned topic = 0;
  unsigned msg_id = 0;
  const std::size_t at = std::min(published.find(" id="), published.size());
  EXPECT_EQ(std::sscanf(published.c_str() + at, " id=%u msg=%u", &topic, &msg_id), 2) << published;
  send(n, Puback{static_cast<std::uint16_t>(topic), static_cast<std::uint16_t>(msg_id),
                 ReturnCode::accepted});
}

void SnRig::sleep(unsigned n, std::uint16_t duration_s) {
  send(n, Disconnect{duration_s});
  sent_to(n);
}

void SnRig::publish(unsigned n, std::uint16_t id, unsigned qos, std::uint16_t msg_id,
                    const std::string& payload) {
  send(n, Publish{false, static_cast<WireQos>(qos), false, TopicIdType::normal, id, msg_id,
                  to_bytes(payload)});
}

void SnRig::broker(const std::string& topic, const std::string& payload, unsigned qos,
                   bool retain) {
  drain();  // the requests of restored sessions
  const auto target = TopicScheme("ntnu-slam", "gw").parse_command_topic(topic);
  std::map<std::string, bool> robots;  // and whether it has subscribed
  if (target && !retain) robots[std::string(target->robot)] = false;
  for (const auto& [robot, all] : filters) {
    if (std::ranges::any_of(all, [&](const auto& filter) { return filter_matches(filter, topic); }))
      robots[robot] = true;
  }
  for (const auto& [robot, has_asked] : robots) {
    if (!gateway.presence_of(robot)) continue;
    const bool is_command = target && target->robot == robot;
    robot_message({robot,
                   {topic, to_bytes(payload), static_cast<Qos>(qos), retain},
                   is_command ? CommandId{++last_command_} : CommandId::none,
                   !has_asked});
  }
}

void SnRig::robot_message(RobotMessage message) {
  gateway.on_broker_message(message, now);
  drain();
}

void SnRig::receipt(std::uint64_t id, ReceiptOutcome outcome) {
  gateway.on_receipt(id, outcome, now);
  drain();
}

void SnRig::subscribe_result(const std::string& filter, bool granted) {
  for (auto& [robot, all] : filters) {
    if (!all.contains(filter)) continue;
    if (!granted) all.erase(filter);
    gateway.on_subscribe_result(robot, filter, granted, now);
  }
  drain();
}

void SnRig::note(const std::string& robot, std::optional<ByteView> note) {
  gateway.on_note(robot, note, now);
  drain();
}

void SnRig::session_held(const std::string& robot) {
  gateway.on_session_held(robot);
  drain();
}

std::vector<WaitingMessage> SnRig::give_up(const std::string& robot) {
  auto unsent = gateway.give_up(robot, now);
  drain();
  return unsent;
}

void SnRig::broker_link(bool is_up) {
  gateway.on_broker_link(is_up, now);
  drain();
}

void SnRig::ping(std::uint64_t id, const std::string& robot) {
  gateway.ping(id, robot, now);
  drain();
}

void SnRig::stop() {
  gateway.on_stop(now);
  drain();
}

void SnRig::rename(std::vector<RobotName> names) {
  gateway.reconfigure(policy, RobotNames(std::move(names)), identities_, now);
  drain();
}

void SnRig::use_keys(Identities of) {
  identities_ = std::move(of);
  rename({});
}

void SnRig::pass(Duration time) {
  const TimePoint end = now + time;
  while (gateway.deadline() && *gateway.deadline() <= end) {
    now = std::max(now, *gateway.deadline());
    gateway.on_deadline(now);
    drain();
  }
  now = end;
}

std::vector<std::string> SnRig::sent_to(unsigned n) {
  return std::exchange(outbox_[address(n)], {});
}

std::string SnRig::last_to(unsigned n) {
  const auto lines = sent_to(n);
  return lines.empty() ? "nothing" : lines.back();
}

std::uint64_t SnRig::counter(std::string_view name) const {
  for (const Counter& counter : gateway.counters()) {
    if (counter.name == name) return counter.value;
  }
  return 0;
}

void SnRig::drain() {
  while (auto action = gateway.next_action()) {
    if (auto* datagram = std::get_if<SendDatagram>(&*action)) {
      take(*datagram);
    } else if (auto* multicast = std::get_if<SendMulticast>(&*action)) {
      multicasts.push_back(describe_octets(multicast->bytes));
    } else if (auto* ended = std::get_if<PingEnded>(&*action)) {
      pings.push_back(std::move(*ended));
    } else {
      take(std::get<MeshEvent>(*action));
    }
  }
  while (!to_answer_.empty()) {
    const SubscribeRequest request = std::move(to_answer_.front());
    to_answer_.pop_front();
    gateway.on_subscribe_result(request.robot, request.filter, true, now);
    drain();
  }
}

void SnRig::take(SendDatagram& action) {
  outbox_[action.to].push_back(describe_octets(action.bytes));
  datagrams.push_back(std::move(action));
}

void SnRig::take(MeshEvent& event) {
  std::visit(overloaded{
                 [&](Report& e) { reports.push_back(std::move(e)); },
                 [&](PresenceChange& e) { presence.push_back(std::move(e)); },
                 [&](SubscribeRequest& e) {
                   filters[e.robot].insert(e.filter);
                   if (answers_subscribes && !e.is_standing) to_answer_.push_back(e);
                   subscribes.push_back(std::move(e));
                 },
                 [&](UnsubscribeRequest& e) {
                   filters[e.robot].erase(e.filter);
                   unsubscribes.push_back(std::move(e));
                 },
                 [&](SessionCleaned& e) {
                   filters.erase(e.robot);
                   cleaned.push_back(std::move(e));
                 },
                 [&](SessionEvicted& e) { evicted.push_back(std::move(e)); },
                 [&](NoteChanged& e) { notes.push_back(std::move(e)); },
                 [&](NoteRequest& e) { note_requests.push_back(std::move(e)); },
                 [&](CommandOutcome& e) { outcomes.push_back(std::move(e)); },
                 [&](SignOfLife&) { ++signs_of_life; },
                 [](LinkChange&) {},
                 [&](MessageStep& e) { steps.push_back(std::move(e)); },
                 [&](Notice& e) { notices.push_back(std::move(e)); },
             },
             event);
}

}  // namespace slamgw::mqttsn
