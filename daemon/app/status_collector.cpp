// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/status_collector.hpp"

#include <fstream>
#include <nlohmann/json.hpp>
#include <utility>

namespace slamgw {
namespace {

constexpr std::size_t most_refused_listed = 10;

std::uint64_t resident_bytes() {
  std::uint64_t total_pages = 0;
  std::uint64_t resident_pages = 0;
  std::ifstream("/proc/self/statm") >> total_pages >> resident_pages;
  return resident_pages * static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE));
}

Counters counts_of(const Gateway& gateway, const Outbox& outbox, const Upstream& upstream) {
  const Gateway::Traffic& passed = gateway.traffic();
  const Outbox::Statistics& sent = outbox.statistics();
  return {{"up", passed.up},
          {"down", gateway.commands().counts().down},
          {"published", sent.published},
          {"dropped", sent.dropped},
          {"refused", sent.refused},
          {"set_aside", sent.dead_letters},
          {"lost", sent.lost},
          {"rejected", passed.rejected},
          {"not_retained", passed.not_retained},
          {"stored", outbox.backlog().stored_total()},
          {"inbound_dropped", upstream.inbound_dropped()}};
}

}  // namespace

std::string broker_uri(const BrokerSettings& broker) { return broker.addresses().front().uri(); }

nlohmann::json StatusCollector::status(const PerMesh<MeshLink>& links, const Counters& control,
                                       TimePoint now) const {
  return {
      {"version", SLAMGW_VERSION},
      {"uptime_s", std::chrono::duration_cast<std::chrono::seconds>(now - started).count()},
      {"gateway", config.gateway_id},
      {"broker",
       broker_json(broker.is_up ? broker.uri : broker_uri(config.broker), broker,
                   {outbox.refused_topics().count(), outbox.list_refused(most_refused_listed)},
                   gateway.missing_rights(), now)},
      {"meshes", to_json(links)},
      {"robots", to_json(counts_of(gateway.registry()))},
      {"messages", to_json(counts_of(gateway, outbox, upstream))},
      {"commands",
       {{"open", gateway.commands().open()}, {"late", gateway.commands().counts().late_outcomes}}},
      {"store", store_json(outbox, config.store.max_bytes, now)},
      {"retained", retained_json(gateway.retained())},
      {"queue",
       {{"depth", outbox.unsaved()},
        {"bytes", outbox.queued_bytes()},
        {"max_bytes", Outbox::max_queued_bytes}}},
      {"control", to_json(control)},
      {"fleet", to_json(fleet.counters())},
      {"memory_rss_bytes", resident_bytes()}};
}

PerMesh<MeshLink> StatusCollector::mesh_links() const {
  PerMesh<MeshLink> links;
  for (const Mesh mesh : all_meshes) {
    const MeshAdapter* adapter = meshes.find(mesh);
    const Gateway::LinkState& link = gateway.mesh_link(mesh);
    const bool is_starting = adapter && link.detail.empty();
    links[mesh] = {adapter != nullptr,
                   link.is_up,
                   is_starting ? "is being set up" : link.detail,
                   adapter ? adapter->counters() : Counters{},
                   adapter ? adapter->places() : std::nullopt,
                   gateway.latencies(mesh),
                   gateway.traffic().up_on[mesh],
                   gateway.commands().counts().down_on[mesh]};
  }
  return links;
}

nlohmann::json StatusCollector::robots(const std::optional<std::string>& only,
                                       TimePoint now) const {
  auto rows = nlohmann::json::array();
  const auto add = [&](const std::string& id, const Robot& robot) {
    const MeshAdapter* adapter = meshes.find(robot.mesh());
    const Gateway::LinkState& link = gateway.mesh_link(robot.mesh());
    rows.push_back(robot_row(id, robot,
                             {gateway.is_banned(id),
                              adapter ? adapter->queued_for(id) : 0,
                              {adapter != nullptr, link.is_up, link.detail, {}},
                              config.ble_mesh.offline_after},
                             now));
  };
  const RobotRegistry& registry = gateway.registry();
  if (!only) {
    for (const auto& [id, known] : registry.robots()) add(id, known);
  } else if (const Robot* known = registry.find(*only)) {
    add(*only, *known);
  }
  return rows;
}

ServiceState StatusCollector::service_state() const {
  ServiceState state{broker.is_up,
                     {},
                     gateway.registry().count(Presence::online),
                     gateway.traffic().up + gateway.commands().counts().down};
  for (const Mesh mesh : all_meshes)
    if (meshes.find(mesh)) state.mesh_is_up[mesh] = gateway.mesh_link(mesh).is_up;
  return state;
}

}  // namespace slamgw
