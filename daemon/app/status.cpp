// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/status.hpp"

#include <nlohmann/json.hpp>

#include <fmt/format.h>

#include "daemon/core/retained_topics.hpp"

namespace slamgw {

NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(MissingRight, what, grant)  // names as in the JSON

namespace {

using nlohmann::json;

json to_json(const Counters& counters) {
  json out = json::object();
  for (const Counter& counter : counters) out[std::string(counter.name)] = counter.value;
  return out;
}

json to_json(const RefusedTopic& topic, TimePoint now) {
  return {{"topic", topic.topic},
          {"why", topic.refusal.why},
          {"code", topic.refusal.code},
          {"waiting", topic.waiting},
          {"tries", topic.tries},
          {"for_s", std::chrono::duration_cast<std::chrono::seconds>(now - topic.since).count()}};
}

std::string explain_refused(const Status::Broker& broker) {
  const RefusedTopic& first = broker.refused.front();
  std::string why =
      fmt::format("{} on {} ({} messages wait)", first.refusal.why, first.topic, first.waiting);
  if (broker.refused_topics > 1)
    why += fmt::format(", and {} more topics", broker.refused_topics - 1);
  return why;
}

json to_json(const Status::Broker& broker, TimePoint now) {
  json refused = json::array();
  for (const RefusedTopic& topic : broker.refused) refused.push_back(to_json(topic, now));
  const char* state = broker.link.is_up ? "up" : "down";
  return {{"state", broker.is_refusing() ? "refusing" : state},
          {"uri", broker.uri},
          {"since", to_iso8601(broker.link.since)},
          {"why", broker.is_refusing() ? explain_refused(broker) : broker.link.why},
          {"missing_rights", broker.missing_rights},
          {"refused", {{"topics", broker.refused_topics}, {"list", std::move(refused)}}}};
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

json to_json(const Status::MeshLink& mesh) {
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

json to_json(const PerMesh<Status::MeshLink>& meshes) {
  json out;
  for (const Mesh mesh : all_meshes) out[std::string(to_string(mesh))] = to_json(meshes[mesh]);
  return out;
}

json to_json(const Status::Retained& retained) {
  json most;
  if (retained.most > 0) most = {{"robot", retained.most_by}, {"topics", retained.most}};
  return {
      {"topics", retained.topics}, {"max", RetainedTopics::max_in_all}, {"most", std::move(most)}};
}

/// Returns the robot of the flow `<prefix>/robot/<id>`; the flow itself when it is not a robot's.
std::string robot_of(const std::string& flow) {
  constexpr std::string_view before = "/robot/";
  const std::size_t at = flow.rfind(before);
  const std::string id = at == std::string::npos ? "" : flow.substr(at + before.size());
  return id.empty() || id.find('/') != std::string::npos ? flow : id;
}

json to_json(const Status::Store& store) {
  json largest;
  if (const std::string& flow = store.largest.name; !flow.empty())
    largest = {{"robot", robot_of(flow)}, {"bytes", store.largest.value}};
  return {{"state", store.state},
          {"why", store.why},
          {"depth", store.depth},
          {"bytes", store.bytes},
          {"max_bytes", store.max_bytes},
          {"full", store.is_full},
          {"largest", largest},
          {"filled_by", store.is_nearly_full ? largest : json(nullptr)},
          {"oldest_age_s", store.oldest_age.count()},
          {"dead_letters", store.dead_letters},
          {"dead_letter_bytes", store.dead_letter_bytes},
          {"dead_letters_nearly_full", store.has_little_room_for_letters},
          {"failures", store.failures}};
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

json to_json(const Status& status) {
  return {{"version", status.version},
          {"uptime_s", status.uptime.count()},
          {"gateway", status.gateway},
          {"configuration", status.configuration},
          {"broker", to_json(status.broker, status.now)},
          {"meshes", to_json(status.meshes)},
          {"robots", to_json(status.robots)},
          {"messages", to_json(status.messages)},
          {"commands", to_json(status.commands)},
          {"store", to_json(status.store)},
          {"retained", to_json(status.retained)},
          {"queue", to_json(status.queue)},
          {"control", to_json(status.control)},
          {"fleet", to_json(status.fleet)},
          {"memory_rss_bytes", status.memory_rss_bytes}};
}

std::string why_absent(const Robot& robot, const RobotSurroundings& surroundings) {
  const MeshPresence& there = robot.presence();
  const Status::MeshLink& link = surroundings.link;
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
