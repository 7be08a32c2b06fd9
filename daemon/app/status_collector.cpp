// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/status_collector.hpp"

#include <fstream>
#include <nlohmann/json.hpp>
#include <utility>

namespace slamgw {
namespace {

using std::chrono::duration_cast;
using std::chrono::seconds;

constexpr std::size_t most_refused_listed = 10;

std::uint64_t resident_bytes() {
  std::uint64_t total_pages = 0;
  std::uint64_t resident_pages = 0;
  std::ifstream("/proc/self/statm") >> total_pages >> resident_pages;
  return resident_pages * static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE));
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

Status StatusCollector::status(Counters control, TimePoint now) const {
  Status status;
  status.now = now;
  status.version = SLAMGW_VERSION;
  status.uptime = duration_cast<seconds>(now - started);
  status.gateway = config.gateway_id;
  status.broker = {broker.is_up ? broker.uri : broker_uri(config.broker), broker,
                   outbox.refused_topics().count(), gateway.missing_rights(),
                   outbox.list_refused(most_refused_listed)};
  status.meshes = mesh_links();
  status.robots = counts_of(gateway.registry());
  status.messages = counts_of(gateway, outbox, upstream);
  status.commands = {{"open", gateway.commands().open()},
                     {"late", gateway.commands().counts().late_outcomes}};
  status.store = store_state(now);
  auto [most, robot] = gateway.retained().largest();
  status.retained = {gateway.retained().count(), std::move(robot), most};
  status.queue = {{"depth", outbox.unsaved()},
                  {"bytes", outbox.queued_bytes()},
                  {"max_bytes", Outbox::max_queued_bytes}};
  status.control = std::move(control);
  status.fleet = fleet.counters();
  status.memory_rss_bytes = resident_bytes();
  return status;
}

PerMesh<Status::MeshLink> StatusCollector::mesh_links() const {
  PerMesh<Status::MeshLink> links;
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

Status::Store StatusCollector::store_state(TimePoint now) const {
  const Backlog& backlog = outbox.backlog();
  SlotSums::Sum largest = backlog.largest_share();
  const bool has_filled = backlog.is_nearly_full() && 2 * largest.value >= backlog.taken();
  const bool is_failing = backlog.can_keep() && !outbox.store_trouble().empty();
  return {to_string(is_failing ? Backlog::State::failing : backlog.state()),
          outbox.store_trouble(),
          backlog.rows(),
          backlog.bytes(),
          config.store.max_bytes,
          backlog.is_full(),
          std::move(largest),
          has_filled,
          duration_cast<seconds>(now - backlog.oldest().value_or(now)),
          backlog.dead_letters().count,
          backlog.dead_letters().bytes,
          backlog.has_little_room_for_letters(),
          outbox.store_failures()};
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
