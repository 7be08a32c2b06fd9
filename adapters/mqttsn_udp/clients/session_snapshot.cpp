// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/session_snapshot.hpp"

#include <algorithm>

#include "adapters/mqttsn_udp/limits.hpp"
#include "adapters/mqttsn_udp/name_rules.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::mqttsn {
namespace {

using std::chrono::milliseconds;

/// The age that a command of a damaged record may claim.
constexpr std::chrono::hours longest_command_age{1};
/// Assumed absence after a reboot of the host, whose length is unknown: longer than a command may
/// take.
constexpr std::chrono::seconds unknown_absence{31};

/// An earlier version took wildcards as short names.
TopicIdType type_for(std::string_view name, TopicIdType type) {
  const bool is_wrong = type == TopicIdType::short_name && !is_short_name(name);
  return is_wrong ? TopicIdType::normal : type;
}

MessageSnapshot to_snapshot(const Outgoing& waiting, TimePoint now) {
  MessageSnapshot out{*waiting.message, waiting.qos, waiting.topic_id_type, waiting.predefined_id,
                      waiting.msg_id};
  if (waiting.command && !waiting.command->is_reported)
    out.command_age = std::chrono::duration_cast<milliseconds>(now - waiting.command->came);
  return out;
}

void add_messages(const Delivery& delivery, std::vector<MessageSnapshot>& messages, TimePoint now) {
  if (delivery.publishing) messages.push_back(to_snapshot(delivery.publishing->what, now));
  for (const Outgoing& waiting : delivery.queue) {
    if (waiting.qos != Qos::at_most_once) messages.push_back(to_snapshot(waiting, now));
  }
}

void restore_messages(const SessionSnapshot& snapshot, ClientSession& session, TimePoint now) {
  Delivery& delivery = session.delivery;
  delivery.last_msg_id = snapshot.last_msg_id;
  if (delivery.last_msg_id != 0) skip_message_ids(delivery);
  delivery.abandoned = snapshot.abandoned;
  for (const std::uint16_t msg_id : snapshot.released)
    delivery.releasing.push_back({msg_id, TimePoint::min()});
  for (const MessageSnapshot& message : snapshot.messages) {
    delivery.queue.push_back({std::make_shared<const BrokerMessage>(message.message), message.qos,
                              type_for(message.message.topic, message.topic_id_type),
                              message.predefined_id, command_of(message, snapshot, now),
                              message.msg_id});
  }
}

}  // namespace

std::shared_ptr<Command> command_of(const MessageSnapshot& message, const SessionSnapshot& snapshot,
                                    TimePoint now) {
  const std::string& topic = message.message.topic;
  const std::string type = topic.substr(topic.rfind('/') + 1);
  if (!message.command_age || !is_valid_level(type) || !is_valid_level(snapshot.robot))
    return nullptr;
  const TimePoint saved_at = snapshot.saved_at.value_or(now);
  const bool has_rebooted = now < saved_at;
  const Duration away = has_rebooted ? Duration(unknown_absence) : now - saved_at;
  const Duration age = std::min<Duration>(*message.command_age + away, longest_command_age);
  return std::make_shared<Command>(
      Command{CommandId::none, snapshot.robot, type, now - age, false});
}

bool leave_out_young_commands(SessionSnapshot& snapshot) {
  return std::erase_if(snapshot.messages, [](const MessageSnapshot& message) {
           return message.command_age && *message.command_age < limits::stored_command_age;
         }) > 0;
}

SessionSnapshot to_snapshot(const ClientSession& session, TimePoint now) {
  SessionSnapshot out;
  static_cast<SessionTerms&>(out) = session;
  out.client_id = session.client_id;
  out.robot = session.robot;
  out.state = session.state() == ClientState::awake ? ClientState::asleep : session.state();
  out.peer = session.peer;
  out.has_answered = session.has_answered;
  if (session.will) out.will = *session.will;
  out.topics = session.topics.topics();
  for (const auto& [filter, s] : session.subscriptions)
    out.subscriptions.push_back({filter, s.qos, s.topic_id_type, s.topic_id});
  add_messages(session.delivery, out.messages, now);
  for (const Attempt& open : session.delivery.releasing) out.released.push_back(open.msg_id);
  out.abandoned = session.delivery.abandoned;
  for (const RepeatFilter::Entry& entry : session.repeats.entries()) {
    if (entry.receipt_id != 0) continue;
    const auto age = std::chrono::duration_cast<milliseconds>(now - entry.since);
    if (entry.awaits_pubrel)
      out.inbound_qos2.emplace_back(entry.msg_id, entry.fingerprint);
    else if (age <= limits::repeat_window)
      out.repeats.push_back({entry.msg_id, entry.topic_id, entry.fingerprint, age});
  }
  out.counts_ids = session.repeats.counts_ids();
  out.last_msg_id = session.delivery.last_msg_id;
  out.saved_at = now;
  return out;
}

SessionSnapshot to_note(const SessionSnapshot& snapshot) {
  SessionSnapshot note;
  note.client_id = snapshot.client_id;
  note.robot = snapshot.robot;
  note.is_clean = false;
  note.uses_client_id = snapshot.uses_client_id;
  note.keep_alive = snapshot.keep_alive;
  note.will = snapshot.will;
  note.subscriptions = snapshot.subscriptions;
  for (const TopicTable::Topic& topic : snapshot.topics) {
    if (topic.is_own) note.topics.push_back({topic.name, topic.id, false, true});
  }
  return note;
}

void apply(const SessionSnapshot& snapshot, ClientSession& session, TimePoint now) {
  static_cast<SessionTerms&>(session) = snapshot;
  // Interface indices may have changed; only link-local addresses are useless without one.
  if (!is_link_local(session.local.address)) session.local.interface = 0;
  session.last_heard = now;
  if (snapshot.will && is_valid_topic_name(snapshot.will->topic))
    session.will = std::make_unique<Will>(*snapshot.will);
  for (const TopicTable::Topic& topic : snapshot.topics) session.topics.restore(topic);
  for (const SubscriptionSnapshot& s : snapshot.subscriptions)
    session.subscriptions.emplace(
        s.filter, Subscription{s.qos, type_for(s.filter, s.topic_id_type), s.topic_id, 0, {}});
  for (const auto& [msg_id, mark] : snapshot.inbound_qos2)
    session.repeats.add({mark, now, 0, 0, msg_id, 0, /*awaits_pubrel=*/true});
  for (const RepeatSnapshot& repeat : snapshot.repeats)
    session.repeats.add({repeat.fingerprint, now - repeat.age, 0, repeat.topic_id, repeat.msg_id});
  if (snapshot.counts_ids) session.repeats.set_counts_ids();
  restore_messages(snapshot, session, now);
}

}  // namespace slamgw::mqttsn
