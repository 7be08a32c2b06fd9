// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <nlohmann/json.hpp>
#include <vector>

#include "adapters/mqttsn_udp/clients/client_table.hpp"

namespace slamgw::mqttsn {
namespace {

using nlohmann::json;

constexpr const char* word_of(ClientState state) {
  switch (state) {
    case ClientState::active: return "active";
    case ClientState::asleep: return "asleep";
    case ClientState::awake: return "awake";
    case ClientState::disconnected: return "disconnected";
    case ClientState::lost: break;
  }
  return "lost";
}

constexpr const char* word_of(TopicIdType type) {
  switch (type) {
    case TopicIdType::normal: return "normal";
    case TopicIdType::predefined: return "predefined";
    case TopicIdType::short_name:
    case TopicIdType::reserved: break;
  }
  return "short";
}

std::int64_t ms(Duration time) {
  return std::chrono::duration_cast<std::chrono::milliseconds>(time).count();
}

json row_of(const ClientSession& session, Duration longest_wait, TimePoint now) {
  const Delivery& delivery = session.delivery;
  const bool is_in_flight = delivery.publishing != nullptr;
  json row{{"robot", session.robot},
           {"client_id", session.client_id},
           {"state", word_of(session.state())},
           {"address", session.peer ? json(to_string(*session.peer)) : json()},
           {"clean_session", session.is_clean},
           {"has_answered", session.has_answered},
           {"keep_alive_s", session.keep_alive.count()},
           {"heard_ms_ago", ms(now - session.last_heard)},
           {"topics", session.topics.topics().size()},
           {"subscriptions", session.subscriptions.size()},
           {"waiting", delivery.queue.size()},
           {"in_flight", is_in_flight ? 1 : 0},
           {"repeats", is_in_flight ? delivery.publishing->attempt.repeats : 0},
           {"repeat_after_ms", ms(delivery.timeout.first(longest_wait))},
           {"unacknowledged_up", session.open_receipts},
           {"will", session.will ? json(session.will->topic) : json()}};
  if (presence_of(session.state()) == Presence::asleep)
    row["sleep_s"] = session.sleep_duration.count();
  return row;
}

json detailed(const ClientSession& session, Duration longest_wait, TimePoint now) {
  json row = row_of(session, longest_wait, now);
  row["topics"] = json::array();
  for (const TopicTable::Topic& topic : session.topics.topics())
    row["topics"].push_back({{"id", topic.id}, {"name", topic.name}, {"told", topic.is_known}});
  row["subscriptions"] = json::array();
  for (const auto& [filter, subscription] : session.subscriptions)
    row["subscriptions"].push_back({{"filter", filter},
                                    {"qos", static_cast<int>(subscription.qos)},
                                    {"topic_id_type", word_of(subscription.topic_id_type)}});
  row["waiting"] = json::array();
  for (const Outgoing& outgoing : session.delivery.queue)
    row["waiting"].push_back(outgoing.message->topic);
  return row;
}

}  // namespace

json client_report(const ClientTable& clients, const std::optional<std::string>& robot,
                   Duration longest_wait, TimePoint now) {
  json rows = json::array();
  if (robot) {
    if (const ClientSession* session = clients.find_robot(*robot))
      rows.push_back(detailed(*session, longest_wait, now));
    return rows;
  }
  std::vector<const ClientSession*> sessions;
  for (const auto& [id, session] : clients.all()) sessions.push_back(session.get());
  std::ranges::sort(sessions, {}, &ClientSession::robot);
  for (const ClientSession* session : sessions) rows.push_back(row_of(*session, longest_wait, now));
  return rows;
}

}  // namespace slamgw::mqttsn
