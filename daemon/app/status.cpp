// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/status.hpp"

#include <nlohmann/json.hpp>

#include <fmt/format.h>

namespace slamgw {

NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(MissingRight, what, grant)  // names as in the JSON

namespace {

using nlohmann::json;

json to_json(const RefusedTopic& topic, TimePoint now) {
  return {{"topic", topic.topic},
          {"why", topic.refusal.why},
          {"code", topic.refusal.code},
          {"waiting", topic.waiting},
          {"tries", topic.tries},
          {"for_s", std::chrono::duration_cast<std::chrono::seconds>(now - topic.since).count()}};
}

std::string explain(const RefusedSummary& refused) {
  const RefusedTopic& first = refused.list.front();
  std::string why =
      fmt::format("{} on {} ({} messages wait)", first.refusal.why, first.topic, first.waiting);
  if (refused.topics > 1) why += fmt::format(", and {} more topics", refused.topics - 1);
  return why;
}

json to_json(const MeshPlaces::Crowd& crowd) {
  if (crowd.clients == 0) return nullptr;
  return {{"address", crowd.address}, {"clients", crowd.clients}};
}

json to_json(const MeshPlaces& places) {
  return {{"max", places.max},
          {"taken", places.taken},
          {"most", to_json(places.most)},
          {"unproven", places.unproven},
          {"most_unproven", to_json(places.most_unproven)}};
}

json to_json(const LatencyHistogram& latency) {
  json buckets = json::array();
  for (std::size_t i = 0; i < LatencyHistogram::bounds_us.size(); ++i)
    buckets.push_back({{"le_us", LatencyHistogram::bounds_us[i]}, {"count", latency.at_most()[i]}});
  return {{"count", latency.count()},
          {"sum_us", latency.sum().count()},
          {"buckets", std::move(buckets)}};
}

/// Returns the robot of the flow `<prefix>/robot/<id>`; the flow itself when it is not a robot's.
std::string robot_of(const std::string& flow) {
  constexpr std::string_view before = "/robot/";
  const std::size_t at = flow.rfind(before);
  const std::string id = at == std::string::npos ? "" : flow.substr(at + before.size());
  return id.empty() || id.find('/') != std::string::npos ? flow : id;
}

std::string_view to_string(Backlog::State state) {
  switch (state) {
    case Backlog::State::opening: return "opening";
    case Backlog::State::absent: return "absent";
    case Backlog::State::working: return "working";
    case Backlog::State::failing: return "failing";
  }
  return {};
}

/// Returns an entry for each mesh that the robot was on.
json to_json(const PerMesh<MeshPresence>& on_mesh) {
  json out = json::object();
  for (const Mesh mesh : all_meshes) {
    const MeshPresence& there = on_mesh[mesh];
    if (!there.was_used()) continue;
    out[std::string(to_string(mesh))] = {{"address", there.address},
                                         {"state", to_string(there.presence)},
                                         {"messages", there.up},
                                         {"commands", there.down},
                                         {"repeats", there.repeats}};
  }
  return out;
}

template <class Number>
json number_or_null(const std::optional<Number>& number) {
  return number ? json(*number) : json();
}

}  // namespace

json to_json(const Counters& counters) {
  json out = json::object();
  for (const Counter& counter : counters) out[std::string(counter.name)] = counter.value;
  return out;
}

json to_json(const MeshLink& mesh) {
  const char* state = mesh.is_up ? "up" : "down";
  json out{{"enabled", mesh.is_enabled},
           {"state", mesh.is_enabled ? state : "disabled"},
           {"detail", mesh.detail},
           {"counters", to_json(mesh.counters)}};
  if (mesh.is_enabled) out["latency"] = to_json(mesh.latency);
  if (mesh.is_enabled) out["messages"] = {{"up", mesh.up}, {"down", mesh.down}};
  if (mesh.places) out["places"] = to_json(*mesh.places);
  if (!mesh.role.empty()) out["role"] = mesh.role;
  return out;
}

json to_json(const PerMesh<MeshLink>& meshes) {
  json out;
  for (const Mesh mesh : all_meshes) out[std::string(to_string(mesh))] = to_json(meshes[mesh]);
  return out;
}

json broker_json(const std::string& uri, const BrokerLink& link, const RefusedSummary& refused,
                 const std::vector<MissingRight>& missing_rights, TimePoint now) {
  const bool is_refusing = link.is_up && refused.topics > 0;
  json list = json::array();
  for (const RefusedTopic& topic : refused.list) list.push_back(to_json(topic, now));
  const char* state = link.is_up ? "up" : "down";
  return {{"state", is_refusing ? "refusing" : state},
          {"uri", uri},
          {"since", to_iso8601(link.since)},
          {"why", is_refusing ? explain(refused) : link.why},
          {"missing_rights", missing_rights},
          {"refused", {{"topics", refused.topics}, {"list", std::move(list)}}}};
}

json store_json(const Outbox& outbox, std::uint64_t max_bytes, TimePoint now) {
  const Backlog& backlog = outbox.backlog();
  const bool is_failing = backlog.can_keep() && !outbox.store_trouble().empty();
  const SlotSums::Sum most = backlog.largest_share();
  json largest;
  if (!most.name.empty()) largest = {{"robot", robot_of(most.name)}, {"bytes", most.value}};
  const bool has_filled = backlog.is_nearly_full() && 2 * most.value >= backlog.taken();
  const Duration oldest_age = now - backlog.oldest().value_or(now);
  return {{"state", to_string(is_failing ? Backlog::State::failing : backlog.state())},
          {"why", outbox.store_trouble()},
          {"depth", backlog.rows()},
          {"bytes", backlog.bytes()},
          {"max_bytes", max_bytes},
          {"full", backlog.is_full()},
          {"largest", largest},
          {"filled_by", has_filled ? largest : json(nullptr)},
          {"oldest_age_s", std::chrono::duration_cast<std::chrono::seconds>(oldest_age).count()},
          {"dead_letters", backlog.dead_letters().count},
          {"dead_letter_bytes", backlog.dead_letters().bytes},
          {"dead_letters_nearly_full", backlog.has_little_room_for_letters()},
          {"failures", outbox.store_failures()}};
}

json retained_json(const RetainedTopics& retained) {
  json most;
  if (const auto [topics, robot] = retained.largest(); topics > 0)
    most = {{"robot", robot}, {"topics", topics}};
  return {{"topics", retained.count()}, {"max", RetainedTopics::max_in_all}, {"most", most}};
}

std::string why_absent(const Robot& robot, const RobotSurroundings& surroundings) {
  const MeshPresence& there = robot.presence();
  const MeshLink& link = surroundings.link;
  if (robot.is_contested())
    return "another client uses its name: are there two robots of that name?";
  if (there.is_deaf) return "the robot does not hear the gateway: it repeats acknowledged messages";
  if (there.presence != Presence::offline) return {};
  if (surroundings.is_banned) return "it is banned (slam-gatewayctl unban)";
  const std::string mesh(to_string(robot.mesh()));
  if (link.is_enabled && !link.is_up)
    return fmt::format("the {} link is down: {}", mesh, link.detail);
  if (robot.last_seen == WallTime{}) return "not heard since the daemon started";
  const auto silence =
      std::chrono::duration_cast<std::chrono::seconds>(there.since - robot.last_seen);
  if (robot.mesh() == Mesh::ble && silence + std::chrono::seconds{1} < surroundings.offline_after)
    return "it was removed from the mesh, or renamed";
  if (robot.mesh() == Mesh::ble)
    return fmt::format("the board had not heard it for {} s (presence.offline_after_s)",
                       silence.count());
  if (robot.mesh() != Mesh::thread)
    return fmt::format("had not been heard for {} s", silence.count());
  // A client that disconnects is heard at that moment.
  if (silence <= std::chrono::seconds{1})
    return "disconnected (DISCONNECT), was banned with its host, or lost its address to another "
           "client; it has not connected since";
  return fmt::format(
      "its keep-alive, or the time that it meant to sleep, ran out after {} s of silence; it has "
      "not connected since",
      silence.count());
}

json robot_row(const std::string& id, const Robot& robot, const RobotSurroundings& surroundings,
               TimePoint now) {
  const MeshPresence& there = robot.presence();
  const RobotNumbers& numbers = robot.numbers;
  const auto latency = numbers.latency(now);
  const RadioFacts radio = robot.radio_now();
  return {{"id", id},
          {"mesh", to_string(robot.mesh())},
          {"meshes", to_json(robot.on_mesh)},
          {"address", there.address},
          {"state", to_string(there.presence)},
          {"since", to_iso8601(there.since)},
          {"last_seen", to_iso8601(robot.last_seen)},
          {"last_type", robot.last_type},
          {"deaf", there.is_deaf},
          {"contested", robot.is_contested()},
          {"why", why_absent(robot, surroundings)},
          {"messages", numbers.up()},
          {"commands", numbers.down()},
          {"bytes_up", numbers.bytes_up()},
          {"bytes_down", numbers.bytes_down()},
          {"repeats", numbers.repeats()},
          {"gaps", numbers.gaps()},
          {"rate_hz", numbers.rate_hz(now)},
          {"latency_p50_us", latency ? json(latency->p50.count()) : json()},
          {"latency_p99_us", latency ? json(latency->p99.count()) : json()},
          {"rssi_dbm", number_or_null(radio.rssi_dbm)},
          {"ttl", number_or_null(radio.ttl)},
          {"hops", number_or_null(radio.hops)},
          {"queue", surroundings.queue}};
}

Counters counts_of(const RobotRegistry& robots) {
  return {{"online", robots.count(Presence::online)},
          {"asleep", robots.count(Presence::asleep)},
          {"offline", robots.count(Presence::offline)},
          {"known", robots.robots().size()},
          {"untracked", robots.untracked()},
          {"deaf", robots.deaf()},
          {"contested", robots.contested()}};
}

}  // namespace slamgw
