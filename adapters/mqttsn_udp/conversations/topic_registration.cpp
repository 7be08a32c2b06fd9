// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/topic_registration.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "adapters/mqttsn_udp/clients/delivery.hpp"
#include "adapters/mqttsn_udp/conversations/own_names.hpp"
#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {
namespace {

/// Returns `delivery.set_aside.end()` when the topic was never set aside.
auto find_set_aside(Delivery& delivery, const std::string& topic) {
  return std::ranges::find(delivery.set_aside, topic, &SetAside::topic);
}

/// Forgets one topic if there are too many: one whose pause is over, else the oldest.
void make_room(std::vector<SetAside>& set_aside) {
  if (set_aside.size() < limits::max_set_aside) return;
  const auto is_over = [](const SetAside& entry) { return !entry.until; };
  const auto over = std::ranges::find_if(set_aside, is_over);
  set_aside.erase(over != set_aside.end() ? over : set_aside.begin());
}

Duration pause_after(unsigned failures) {
  Duration pause = limits::first_set_aside;
  for (unsigned i = 1; i < failures && pause < limits::longest_set_aside; ++i) pause *= 2;
  return std::min<Duration>(pause, limits::longest_set_aside);
}

}  // namespace

bool TopicRegistration::is_needed(const ClientSession& session, const Outgoing& outgoing) {
  if (outgoing.topic_id_type != TopicIdType::normal) return false;
  const auto id = session.topics.id_of(outgoing.message->topic);
  return !id || !session.topics.find(*id)->is_known;
}

TopicRegistration::Readiness TopicRegistration::prepare(ClientSession& session,
                                                        const Outgoing& outgoing, TimePoint now) {
  Delivery& delivery = session.delivery;
  if (is_set_aside(delivery, outgoing.message->topic)) return Readiness::waits;
  if (!is_needed(session, outgoing)) return Readiness::ready;
  const std::string& topic = outgoing.message->topic;
  const auto known = session.topics.id_of(topic);
  const auto open = std::ranges::find_if(
      delivery.registering, [&](const Registering& other) { return other.topic_id == known; });
  if (open != delivery.registering.end())
    return open->attempt.is_fresh() ? Readiness::waits_shortly : Readiness::waits;
  const bool is_busy = std::ranges::any_of(
      delivery.registering, [](const Registering& other) { return other.attempt.is_fresh(); });
  if (is_busy) return Readiness::waits_shortly;  // R66
  if (!output_.may_send(session, 6 + topic.size())) return Readiness::is_held;
  if (delivery.registering.size() >= limits::max_open_registers) {
    if (!outgoing.command) return Readiness::waits;
    delivery.registering.erase(delivery.registering.begin());
  }
  const auto id = session.assign_topic(topic);
  if (!id) return Readiness::impossible;
  begin(session, *id, now);
  return Readiness::waits_shortly;
}

void TopicRegistration::probe(ClientSession& session, TimePoint now) {
  const std::string topic = probe_topic();
  if (is_set_aside(session.delivery, topic)) return;
  if (!output_.may_send(session, probe_octets())) return;
  if (const auto id = session.assign_topic(topic)) begin(session, *id, now);
}

std::size_t TopicRegistration::probe_octets() const { return 6 + probe_topic().size(); }

/// Returns the first level of all topics. An address that has sent a full topic name has enough
/// allowance for this one.
std::string TopicRegistration::probe_topic() const {
  const std::string& root = rules_.policy.scheme().robot_root();
  return root.substr(0, root.find('/'));
}

void TopicRegistration::begin(ClientSession& session, std::uint16_t topic_id, TimePoint now) {
  Delivery& delivery = session.delivery;
  delivery.registering.push_back(
      {topic_id, begin_attempt(settings_, delivery, next_message_id(delivery), now)});
  transmit(session, delivery.registering.back());
}

void TopicRegistration::transmit(const ClientSession& session, Registering& registering) {
  const std::string* name = session.topics.name_of(registering.topic_id);
  if (!name) return;
  std::string sent_name = to_client_name(rules_.policy.scheme(), session, *name);
  registering.attempt.is_withheld = !output_.may_send(session, 6 + sent_name.size());
  output_.send(session, Register{registering.topic_id, registering.attempt.msg_id, sent_name});
}

void TopicRegistration::resume_withheld(ClientSession& session) {
  for (Registering& open : session.delivery.registering) {
    if (open.attempt.is_withheld) transmit(session, open);
  }
}

std::optional<std::uint16_t> TopicRegistration::topic_id(ClientSession& session,
                                                         const Outgoing& outgoing) {
  const std::string& topic = outgoing.message->topic;
  switch (outgoing.topic_id_type) {
    case TopicIdType::predefined: return outgoing.predefined_id;
    case TopicIdType::short_name: return short_name_id(topic);
    case TopicIdType::normal:
    case TopicIdType::reserved: break;
  }
  const auto id = session.topics.id_of(topic);
  if (id) session.topics.touch(*id);
  return id;
}

std::optional<std::string> TopicRegistration::on_regack(ClientSession& session,
                                                        const Regack& regack, TimePoint now) {
  Delivery& delivery = session.delivery;
  const auto answered =
      std::ranges::find(delivery.registering, regack.msg_id,
                        [](const Registering& open) { return open.attempt.msg_id; });
  if (answered == delivery.registering.end()) return std::nullopt;
  on_answered(delivery, answered->attempt, now);
  if (regack.code == ReturnCode::congestion) return std::nullopt;
  const std::uint16_t id = answered->topic_id;
  delivery.registering.erase(answered);
  TopicTable::Topic* topic = session.topics.find(id);
  if (!topic) return std::nullopt;
  on_delivered(delivery, topic->name);
  if (regack.code == ReturnCode::accepted) topic->is_known = true;
  return topic->name;
}

std::vector<TopicRegistration::Unanswered> TopicRegistration::on_time(ClientSession& session,
                                                                      TimePoint now) {
  Delivery& delivery = session.delivery;
  for (SetAside& entry : delivery.set_aside) {
    if (entry.until && *entry.until <= now) entry.until.reset();
  }
  std::vector<Unanswered> given_up;
  for (std::size_t i = 0; i < delivery.registering.size();) {
    Registering& open = delivery.registering[i];
    const auto due = check_attempt(settings_, open.attempt, now);
    if (due == Due::repeat) {
      output_.count(Count::retransmitted);
      transmit(session, open);
    }
    if (due != Due::give_up) {
      ++i;
      continue;
    }
    const std::string* name = session.topics.name_of(open.topic_id);
    const TimePoint begun = open.attempt.begun;
    delivery.registering.erase(delivery.registering.begin() + static_cast<std::ptrdiff_t>(i));
    if (!name) continue;
    set_aside(session, *name, begun, now);
    given_up.push_back({*name, session.last_heard > begun});
  }
  return given_up;
}

std::optional<TimePoint> TopicRegistration::next_time(const Delivery& delivery) {
  std::optional<TimePoint> next;
  for (const Registering& open : delivery.registering) next = earlier(next, open.attempt.repeat_at);
  for (const SetAside& entry : delivery.set_aside) {
    if (!entry.ends_when_heard) next = earlier(next, entry.until);
  }
  return next;
}

void TopicRegistration::set_aside(ClientSession& session, const std::string& topic, TimePoint begun,
                                  TimePoint now) {
  Delivery& delivery = session.delivery;
  auto entry = find_set_aside(delivery, topic);
  if (entry == delivery.set_aside.end()) {
    make_room(delivery.set_aside);
    delivery.set_aside.push_back({topic});
    entry = std::prev(delivery.set_aside.end());
  }
  ++entry->failures;
  entry->ends_when_heard = entry->failures == 1 && session.last_heard <= begun;
  const Duration pause = pause_after(entry->failures);
  entry->until = entry->ends_when_heard ? TimePoint::max() : now + pause;
  output_.count(Count::topics_set_aside);
  if (!entry->ends_when_heard) notify_set_aside(session, topic, pause);
}

bool TopicRegistration::is_set_aside(const Delivery& delivery, const std::string& topic) {
  return std::ranges::any_of(delivery.set_aside, [&](const SetAside& entry) {
    return entry.until && entry.topic == topic;
  });
}

bool TopicRegistration::has_failed(const Delivery& delivery, const std::string& topic) {
  return std::ranges::count(delivery.set_aside, topic, &SetAside::topic) > 0;
}

void TopicRegistration::on_delivered(Delivery& delivery, const std::string& topic) {
  std::erase_if(delivery.set_aside, [&](const SetAside& entry) { return entry.topic == topic; });
}

void TopicRegistration::on_heard(Delivery& delivery) {
  for (SetAside& entry : delivery.set_aside) {
    if (std::exchange(entry.ends_when_heard, false)) entry.until.reset();
  }
}

void TopicRegistration::notify_set_aside(ClientSession& session, const std::string& topic,
                                         Duration pause) {
  if (std::exchange(session.delivery.is_set_aside_reported, true)) return;
  output_.emit(Notice{
      .severity = Severity::notice,
      .text = fmt::format("{} does not answer messages on '{}': messages on this topic pause, "
                          "first for {:.0f} s, then longer; other topics go on",
                          session.robot, topic, std::chrono::duration<double>(pause).count()),
      .robot = session.robot,
      .is_proven = session.has_answered});
}

}  // namespace slamgw::mqttsn
