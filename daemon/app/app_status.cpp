// SPDX-License-Identifier: Apache-2.0
// What the control socket and the `stats` topic tell; the rest of App is in app.cpp.
#include <fmt/format.h>
#include <unistd.h>

#include <fstream>

#include "daemon/app/app.hpp"

namespace slamgw {
namespace {

using nlohmann::json;

std::uint64_t resident_bytes() {
  std::uint64_t total_pages = 0;
  std::uint64_t resident_pages = 0;
  std::ifstream("/proc/self/statm") >> total_pages >> resident_pages;
  return resident_pages * static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE));
}

json counters_json(const Counters& counters) {
  json out = json::object();
  for (const Counter& counter : counters) out[std::string(counter.name)] = counter.value;
  return out;
}

json mesh_json(const MeshAdapter* adapter, const Gateway::LinkState& link) {
  const char* state = link.is_up ? "up" : "down";
  return {{"enabled", adapter != nullptr},
          {"state", adapter ? state : "disabled"},
          {"detail", link.detail},
          {"counters", counters_json(adapter ? adapter->counters() : Counters{})}};
}

json count_robots(const RobotRegistry& registry) {
  return {{"online", registry.count(Presence::online)},
          {"asleep", registry.count(Presence::asleep)},
          {"offline", registry.count(Presence::offline)},
          {"known", registry.robots().size()},
          {"untracked", registry.untracked()}};
}

/// Topics that the broker does not take for now.
json refused_json(const HeldTopics& held, TimePoint now) {
  constexpr std::size_t most_listed = 10;
  json list = json::array();
  for (const HeldTopic& topic : held.list(most_listed)) {
    list.push_back(
        {{"topic", topic.topic},
         {"why", topic.refusal.why},
         {"code", topic.refusal.code},
         {"waiting", topic.waiting},
         {"tries", topic.tries},
         {"for_s", std::chrono::duration_cast<std::chrono::seconds>(now - topic.since).count()}});
  }
  return {{"topics", held.size()}, {"list", std::move(list)}};
}

std::string explain_refused(const HeldTopics& held) {
  const HeldTopic first = held.list(1).front();
  return fmt::format("{} on {} ({} messages wait){}", first.refusal.why, first.topic, first.waiting,
                     held.size() > 1 ? fmt::format(", and {} more topics", held.size() - 1) : "");
}

std::string_view to_string(Backlog::State state) {
  switch (state) {
    case Backlog::State::opening: return "opening";
    case Backlog::State::absent: return "absent";
    case Backlog::State::working: return "working";
    case Backlog::State::failing: return "failing";
  }
  return "absent";
}

json store_json(const Outbox& outbox, const StoreSettings& settings, TimePoint now) {
  const Backlog& backlog = outbox.backlog();
  const auto age = now - backlog.oldest().value_or(now);
  return {{"state", to_string(backlog.state())},
          {"why", outbox.store_trouble()},
          {"depth", backlog.rows()},
          {"bytes", backlog.bytes()},
          {"max_bytes", settings.max_bytes},
          {"full", backlog.is_full()},
          {"oldest_age_s", std::chrono::duration_cast<std::chrono::seconds>(age).count()},
          {"dead_letters", backlog.dead_letters().count},
          {"failures", outbox.statistics().store_failures}};
}

json robot_json(const std::string& id, const Robot& robot, std::size_t queued, TimePoint now) {
  const MeshPresence& presence = robot.presence();
  json row{{"id", id},
           {"mesh", to_string(robot.mesh())},
           {"address", presence.address},
           {"state", to_string(presence.presence)},
           {"since", to_iso8601(presence.since)},
           {"last_seen", to_iso8601(robot.last_seen)},
           {"messages", robot.messages_up},
           {"commands", robot.messages_down},
           {"rate_hz", robot.rate.per_second(now)},
           {"rssi_dbm", nullptr},
           {"ttl", nullptr},
           {"hops", nullptr},
           {"queue", queued}};
  if (robot.radio) row["rssi_dbm"] = robot.radio->rssi_dbm;
  if (robot.radio) row["ttl"] = robot.radio->ttl;
  if (robot.radio && robot.radio->hops) row["hops"] = *robot.radio->hops;
  return row;
}

}  // namespace

ServiceState App::service_state() const {
  ServiceState state{broker_log_.is_up(),
                     {},
                     gateway_.registry().count(Presence::online),
                     gateway_.traffic().up + gateway_.traffic().down};
  for (const Mesh each : all_meshes)
    if (mesh(each)) state.mesh_is_up[each] = gateway_.mesh_link(each).is_up;
  return state;
}

json App::status() {
  const Now now = read_clocks();
  const auto uptime = std::chrono::duration_cast<std::chrono::seconds>(now.mono - started_.mono);
  const Outbox::Statistics& sent = outbox_.statistics();
  json meshes;
  for (const Mesh each : all_meshes)
    meshes[std::string(to_string(each))] = mesh_json(mesh(each), gateway_.mesh_link(each));
  const HeldTopics& held = outbox_.held_topics();
  const bool is_refusing = broker_log_.is_up() && !held.empty();
  return {{"version", SLAMGW_VERSION},
          {"uptime_s", uptime.count()},
          {"gateway", config_.gateway_id},
          {"broker",
           {{"state", is_refusing           ? "refusing"
                      : broker_log_.is_up() ? "up"
                                            : "down"},
            {"uri", broker_log_.uri()},
            {"since", to_iso8601(broker_log_.since())},
            {"why", is_refusing ? explain_refused(held) : broker_log_.why()},
            {"refused", refused_json(held, now.mono)}}},
          {"meshes", std::move(meshes)},
          {"robots", count_robots(gateway_.registry())},
          {"messages",
           {{"up", gateway_.traffic().up},
            {"down", gateway_.traffic().down},
            {"published", sent.published},
            {"dropped", sent.dropped},
            {"refused", sent.refused},
            {"set_aside", sent.set_aside},
            {"rejected", gateway_.traffic().rejected},
            {"stored", outbox_.backlog().stored_total()}}},
          {"store", store_json(outbox_, config_.store, now.mono)},
          {"queue",
           {{"depth", outbox_.unsaved()},
            {"bytes", outbox_.queued_bytes()},
            {"max_bytes", Outbox::max_queued_bytes}}},
          {"control", counters_json(control_ ? control_->counters() : Counters{})},
          {"memory_rss_bytes", resident_bytes()}};
}

json App::robots() {
  const TimePoint now = read_clocks().mono;
  json rows = json::array();
  for (const auto& [id, robot] : gateway_.registry().robots()) {
    const MeshAdapter* adapter = mesh(robot.mesh());
    rows.push_back(robot_json(id, robot, adapter ? adapter->queued_for(id) : 0, now));
  }
  return rows;
}

}  // namespace slamgw
