// SPDX-License-Identifier: Apache-2.0
#include "web/server/metrics.hpp"

#include <initializer_list>
#include <nlohmann/json.hpp>
#include <optional>

#include "daemon/core/broker_link.hpp"
#include "web/server/exposition.hpp"

namespace slamgw::web {
namespace {

using nlohmann::json;
using Path = std::initializer_list<const char*>;

const json* find(const json& document, Path path) {
  const json* here = &document;
  for (const char* key : path) {
    if (!here->is_object()) return nullptr;
    const auto found = here->find(key);
    if (found == here->end()) return nullptr;
    here = &*found;
  }
  return here;
}

std::optional<double> number(const json& document, Path path) {
  const json* value = find(document, path);
  if (value == nullptr || !value->is_number()) return std::nullopt;
  return value->get<double>();
}

std::string text(const json& document, Path path) {
  const json* value = find(document, path);
  const auto* found = value == nullptr ? nullptr : value->get_ptr<const std::string*>();
  return found == nullptr ? "" : *found;
}

/// One number of a document and the metric that it becomes.
struct Row {
  Path path;
  std::string_view name;
  std::string_view help;
  double scale = 1;
};

void add_rows(Exposition& out, const json& document, std::initializer_list<Row> rows,
              const Labels& labels) {
  for (const Row& row : rows) {
    const auto value = number(document, row.path);
    if (value) out.add(row.name, row.help, labels, *value * row.scale);
  }
}

void add_own(Exposition& out, const OwnNumbers& own) {
  const auto count = [](auto value) { return static_cast<double>(value); };
  out.add("slamgw_web_info", "The version of slam-gateway-web.", {{"version", own.version}}, 1);
  out.add("slamgw_web_broker_connected", "Whether slam-gateway-web is connected to the broker.", {},
          own.broker_is_connected ? 1 : 0);
  out.add("slamgw_web_pages", "Pages that are open.", {}, count(own.pages));
  out.add("slamgw_web_messages_total", "Messages that the broker sent.", {}, count(own.messages));
  out.add("slamgw_web_dropped_messages_total", "Messages that slow pages did not get.", {},
          count(own.messages_dropped));
  out.add("slamgw_web_commands_total", "Commands that pages sent.", {}, count(own.commands));
  out.add("slamgw_web_refused_requests_total",
          "Requests refused: wrong Host or Origin, no such page, or no room.", {},
          count(own.requests_refused));
  out.add("slamgw_web_wrong_tokens_total", "Wrong tokens that pages sent.", {},
          count(own.wrong_tokens));
  out.add("slamgw_web_cpu_seconds_total", "CPU time of slam-gateway-web.", {}, own.cpu_seconds);
  out.add("slamgw_web_resident_memory_bytes", "Memory of slam-gateway-web.", {},
          count(own.resident_bytes));
}

/// Reads the member "latency" of a mesh in `stats`. Returns nothing unless bounds rise and counts
/// do not fall.
std::optional<Histogram> histogram_of(const json& latency) {
  const json* buckets = find(latency, {"buckets"});
  const auto count = number(latency, {"count"});
  const auto sum_us = number(latency, {"sum_us"});
  if (buckets == nullptr || !buckets->is_array() || !count || !sum_us) return std::nullopt;
  Histogram histogram{{}, *count, *sum_us / 1e6};
  std::pair last(-1.0, 0.0);
  for (const json& bucket : *buckets) {
    const auto bound_us = number(bucket, {"le_us"});
    const auto at_most = number(bucket, {"count"});
    if (!bound_us || !at_most) return std::nullopt;
    const std::pair next(*bound_us / 1e6, *at_most);
    if (next.first <= last.first || next.second < last.second) return std::nullopt;
    histogram.at_most.push_back(last = next);
  }
  if (*count < last.second || *sum_us < 0) return std::nullopt;
  return histogram;
}

/// Adds the messages of each mesh, and without a mesh those that none carried, such as commands to
/// unknown robots. A gateway of release 0.1.0 counts no meshes.
void add_messages(Exposition& out, const std::string& gateway, const json& stats,
                  const char* direction) {
  const auto add = [&](const std::string& mesh, double value) {
    Labels labels{{"gateway", gateway}, {"direction", direction}};
    if (!mesh.empty()) labels.insert(labels.begin() + 1, {"mesh", mesh});
    out.add("slamgw_gateway_messages_total",
            "Messages from robots (up) and to them (down), refused commands too.", labels, value);
  };
  const json* meshes = find(stats, {"meshes"});
  double counted = 0;
  bool has_meshes = false;
  if (meshes != nullptr && meshes->is_object())
    for (const auto& [mesh, values] : meshes->items())
      if (const auto value = number(values, {"messages", direction})) {
        add(mesh, *value);
        counted += *value;
        has_meshes = true;
      }
  const auto all = number(stats, {"messages", direction});
  if (all && (!has_meshes || *all > counted)) add("", *all - counted);
}

void add_stats(Exposition& out, const std::string& gateway, const json& stats) {
  const Labels labels{{"gateway", gateway}};
  add_rows(
      out, stats,
      {
          {{"uptime_s"}, "slamgw_gateway_uptime_seconds", "Time since the gateway started."},
          {{"messages", "published"},
           "slamgw_gateway_published_messages_total",
           "Messages that the broker has acknowledged, and QoS 0 messages written to the network."},
          {{"messages", "dropped"},
           "slamgw_gateway_dropped_messages_total",
           "QoS 0 messages that were dropped."},
          {{"messages", "refused"},
           "slamgw_gateway_refused_messages_total",
           "Messages for which there was no room; robots were not acknowledged."},
          {{"messages", "rejected"},
           "slamgw_gateway_rejected_messages_total",
           "Updates that could not be read."},
          {{"messages", "set_aside"},
           "slamgw_gateway_set_aside_messages_total",
           "How often a message was kept as a dead letter, also the same one after a new try."},
          {{"messages", "lost"},
           "slamgw_gateway_lost_messages_total",
           "Stored messages that damage of the disk has taken."},
          {{"messages", "stored"},
           "slamgw_gateway_stored_messages_total",
           "Messages that were written to disk."},
          {{"store", "depth"}, "slamgw_gateway_store_messages", "Messages on disk."},
          {{"store", "bytes"}, "slamgw_gateway_store_bytes", "Size of the messages on disk."},
          {{"store", "max_bytes"},
           "slamgw_gateway_store_limit_bytes",
           "Limit of the size of the messages on disk (store.max_bytes)."},
          {{"store", "oldest_age_s"},
           "slamgw_gateway_store_oldest_seconds",
           "Age of the oldest message on disk."},
          {{"store", "dead_letters"}, "slamgw_gateway_dead_letters", "Dead letters on disk."},
          {{"store", "dead_letter_bytes"},
           "slamgw_gateway_dead_letter_bytes",
           "Size of the dead letters on disk; they may take a quarter of the limit."},
          {{"queue", "depth"}, "slamgw_gateway_queue_messages", "Messages in memory."},
          {{"robots", "deaf"},
           "slamgw_gateway_robots_deaf",
           "Robots that are online and do not hear the gateway."},
          {{"robots", "contested"},
           "slamgw_gateway_robots_contested",
           "Robots whose name another client uses too."},
          {{"queue", "bytes"}, "slamgw_gateway_queue_bytes", "Size of the messages in memory."},
          {{"memory_rss_bytes"}, "slamgw_gateway_resident_memory_bytes", "Memory of the daemon."},
      },
      labels);
  for (const char* direction : {"up", "down"}) add_messages(out, gateway, stats, direction);
  for (const char* state : {"online", "asleep", "offline"}) {
    if (const auto value = number(stats, {"robots", state}))
      out.add("slamgw_gateway_robots", "Robots by state.", {{"gateway", gateway}, {"state", state}},
              *value);
  }
  out.add("slamgw_gateway_broker_up",
          "Whether the gateway is connected to the broker, which may refuse some topics.", labels,
          is_broker_there(text(stats, {"broker", "state"})) ? 1 : 0);
  const json* meshes = find(stats, {"meshes"});
  if (meshes == nullptr || !meshes->is_object()) return;
  for (const auto& [mesh, value] : meshes->items()) {
    const std::string state = text(value, {"state"});
    if (state != "disabled")
      out.add("slamgw_gateway_mesh_up", "Whether the gateway's link to this mesh works.",
              {{"gateway", gateway}, {"mesh", mesh}}, state == "up" ? 1 : 0);
    const json* latency = find(value, {"latency"});
    if (const auto histogram = latency ? histogram_of(*latency) : std::nullopt)
      out.add_histogram(
          "slamgw_latency_seconds",
          "From a message's arrival at the gateway until it was with the broker or on "
          "disk, of messages that are acknowledged.",
          {{"gateway", gateway}, {"mesh", mesh}}, *histogram);
  }
}

/// Adds the counts of one mesh that the robot was on.
void add_counts(Exposition& out, const Labels& robot, const std::string& mesh, const json& counts) {
  Labels labels = robot;
  labels.emplace_back("mesh", mesh);
  add_rows(out, counts,
           {{{"repeats"}, "slamgw_robot_repeats_total", "Messages that the robot sent again."}},
           labels);
  labels.emplace_back("direction", "");
  for (const char* direction : {"up", "down"}) {
    labels.back().second = direction;
    if (const auto value = number(counts, {direction}))
      out.add("slamgw_robot_messages_total",
              "Messages from a robot (up) and to it (down), refused commands too.", labels, *value);
  }
}

void add_quantiles(Exposition& out, Labels labels, const json& numbers) {
  labels.emplace_back("quantile", "");
  for (const auto& [quantile, key] :
       {std::pair{"0.5", "latency_p50_us"}, std::pair{"0.99", "latency_p99_us"}}) {
    labels.back().second = quantile;
    if (const auto value = number(numbers, {key}))
      out.add("slamgw_robot_latency_seconds",
              "From a message's arrival at the gateway to its acknowledgement, of the last minute. "
              "To add up several robots: slamgw_latency_seconds.",
              labels, *value * 1e-6);
  }
}

void add_robot(Exposition& out, const Labels& robot, const json& numbers) {
  Labels labels = robot;
  labels.emplace_back("mesh", text(numbers, {"mesh"}));
  const json* meshes = find(numbers, {"meshes"});
  if (meshes != nullptr && meshes->is_object())
    for (const auto& [name, counts] : meshes->items()) add_counts(out, robot, name, counts);
  add_rows(out, numbers,
           {{{"rate_hz"}, "slamgw_robot_rate_hertz", "Messages a second."},
            {{"rssi_dbm"}, "slamgw_robot_rssi_dbm", "Strength of the robot's signal."}},
           labels);
  add_quantiles(out, labels, numbers);
}

json payload_of(const SharedText& message) {
  json document = json::parse(*message, nullptr, false);
  if (!document.is_object()) return {};
  const auto payload = document.find("payload");
  return payload == document.end() ? json() : std::move(*payload);
}

/// Adds the gateways' metrics; reads each document once.
class Gateways {
 public:
  Gateways(const Topics& topics, const LastKnown& known, const Roster& roster,
           const OutcomeCounts& outcomes)
      : topics_(topics), known_(known), roster_(roster), outcomes_(outcomes) {}

  void add_to(Exposition& out) const {
    for (const auto& entry : known_.topics()) {
      const auto [name, rest] = topics_.gateway_topic(entry.first);
      if (rest == "state") add_life(out, std::string(name));
    }
    for (const auto& entry : known_.topics()) add_presence(out, entry.first);
    for (const auto& [topic, message] : known_.topics()) add_document(out, topic, message);
  }

 private:
  void add_life(Exposition& out, const std::string& gateway) const {
    const GatewayLife life = roster_.gateway(gateway);
    out.add("slamgw_gateway_up", "Whether the gateway is online.", {{"gateway", gateway}},
            life.state == "online" ? 1 : 0);
    out.add("slamgw_gateway_clock_ahead_seconds",
            "How far the gateway's clock is ahead of that of slam-gateway-web; 0 within a minute.",
            {{"gateway", gateway}}, static_cast<double>(life.clock_ahead_ms) / 1000);
    const OutcomeCounts::Counts counts = outcomes_.of(gateway);
    for (std::size_t i = 0; i < counts.size(); ++i)  // from 0, so that increase() sees the first
      out.add("slamgw_commands_total",
              "Commands by how they ended, since slam-gateway-web started.",
              {{"gateway", gateway},
               {"outcome", std::string(to_string(static_cast<CommandResult>(i)))}},
              static_cast<double>(counts[i]));
  }

  /// Adds the robot's state, but only for the gateway that the roster has chosen for it.
  void add_presence(Exposition& out, std::string_view topic) const {
    constexpr std::string_view robots = "robots/";
    const auto [gateway, rest] = topics_.gateway_topic(topic);
    if (!rest.starts_with(robots) || roster_.gateway(gateway).state != "online") return;
    const std::string_view robot = rest.substr(robots.size());
    const RobotLife life = roster_.robot(robot);
    if (life.gateway != gateway) return;
    const Labels labels{
        {"gateway", std::string(gateway)}, {"robot", std::string(robot)}, {"mesh", life.mesh}};
    out.add("slamgw_robot_online", "Whether the robot is online (1), or asleep or offline (0).",
            labels, life.state == "online" ? 1 : 0);
    if (const std::int64_t heard_ms = roster_.last_heard_ms(robot); heard_ms > 0)
      out.add(
          "slamgw_robot_last_heard_timestamp_seconds",
          "When the robot was heard last: its last message here, or a later sign of life that its "
          "gateway reports every 10 s.",
          labels, static_cast<double>(heard_ms) / 1000);
  }

  void add_document(Exposition& out, std::string_view topic, const SharedText& message) const {
    const auto [name, rest] = topics_.gateway_topic(topic);
    if (roster_.gateway(name).state != "online") return;
    const std::string gateway(name);
    if (rest == "stats") add_stats(out, gateway, payload_of(message));
    if (rest == "numbers") add_robots(out, gateway, payload_of(message));
  }

  void add_robots(Exposition& out, const std::string& gateway, const json& numbers) const {
    const json* robots = find(numbers, {"robots"});
    if (robots == nullptr || !robots->is_object()) return;
    for (const auto& [robot, values] : robots->items())
      add_robot(out, {{"gateway", gateway}, {"robot", robot}}, values);
  }

  const Topics& topics_;
  const LastKnown& known_;
  const Roster& roster_;
  const OutcomeCounts& outcomes_;
};

}  // namespace

void OutcomeCounts::add(std::string_view gateway, std::string_view payload) {
  const std::string outcome = text(json::parse(payload, nullptr, false), {"outcome"});
  for (std::size_t i = 0; i < command_result_count; ++i)
    if (to_string(static_cast<CommandResult>(i)) == outcome &&
        (counts_.size() < max_gateways || counts_.contains(gateway)))
      ++counts_[std::string(gateway)][i];
}

OutcomeCounts::Counts OutcomeCounts::of(std::string_view gateway) const {
  const auto found = counts_.find(gateway);
  return found == counts_.end() ? Counts{} : found->second;
}

std::string metrics_text(const OwnNumbers& own, const Topics& topics, const LastKnown& known,
                         const Roster& roster, const OutcomeCounts& outcomes) {
  Exposition gateways;
  Gateways(topics, known, roster, outcomes).add_to(gateways);
  Exposition out;
  add_own(out, own);
  out.add("slamgw_web_left_out_samples", "Samples left out here because there are too many.", {},
          static_cast<double>(gateways.left_out()));
  return out.text() + gateways.text();
}

}  // namespace slamgw::web
