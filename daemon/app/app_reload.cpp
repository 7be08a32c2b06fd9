// SPDX-License-Identifier: Apache-2.0
// SIGHUP: what of the configuration can change while the daemon runs, and words for what can't.
#include <fmt/format.h>

#include "adapters/ble_mesh_usb_cdc/io/ble_mesh_adapter.hpp"
#include "adapters/mqttsn_udp/io/mqttsn_adapter.hpp"
#include "daemon/app/app.hpp"
#include "daemon/config/load.hpp"
#include "daemon/observability/log.hpp"

namespace slamgw {
namespace {

/// The groups of keys that differ and are only read at start.
std::string needs_restart(const Config& now, const Config& wanted) {
  std::string keys;
  const auto note = [&](bool is_same, std::string_view key) {
    if (!is_same) keys += fmt::format("{}{}", keys.empty() ? "" : ", ", key);
  };
  note(now.gateway_id == wanted.gateway_id, "gateway.id");
  note(now.broker.max_inflight == wanted.broker.max_inflight, "broker.max_inflight");
  note(now.topics.prefix == wanted.topics.prefix, "topics.prefix");
  note(now.update_mode == wanted.update_mode, "payload.update");
  note(now.ble_mesh == wanted.ble_mesh, "ble_mesh.* or presence.*");
  note(now.mqttsn == wanted.mqttsn, "mqttsn.*");
  note(now.store == wanted.store, "store.*");
  note(now.control_socket == wanted.control_socket, "control.socket");
  return keys;
}

}  // namespace

OrderAnswer App::reload() {
  ParseResult result = load_config(config_file_);
  for (const Problem& problem : result.problems) log_event(Severity::error, to_string(problem));
  if (!result.problems.empty()) {
    const std::string refusal = "the configuration was not changed: fix the file, then reload";
    log_event(Severity::error, refusal);
    std::string error;
    for (const Problem& problem : result.problems) error += to_string(problem) + "\n";
    return {{}, error + refusal};
  }
  Config& wanted = result.config;
  const std::string restart = needs_restart(config_, wanted);
  config_.log = wanted.log;
  configure_log(config_.log.level);
  sampler_ = TrafficSampler(config_.log.traffic);
  reload_robots(wanted);
  wanted.broker.gateway_id = config_.gateway_id;
  wanted.broker.max_inflight = config_.broker.max_inflight;
  config_.broker = wanted.broker;
  broker_log_.rename(broker_uri(config_.broker));
  upstream_.reconfigure(config_.broker);
  log_event(Severity::notice,
            "configuration read again: log, broker, topics and robots are in force");
  if (!restart.empty())
    log_event(Severity::warning, fmt::format("only a restart changes: {}", restart));
  nlohmann::ordered_json told{{"in_force", "log, broker, topics, robots"}};
  if (!restart.empty()) told["needs_restart"] = restart;
  return {told.dump(), {}};
}

void App::reload_robots(const Config& wanted) {
  const bool has_same_robots = config_.robots == wanted.robots;
  const bool has_same_topics = config_.topics.extra_publish == wanted.topics.extra_publish &&
                               config_.topics.extra_subscribe == wanted.topics.extra_subscribe;
  config_.robots = wanted.robots;
  config_.topics.extra_publish = wanted.topics.extra_publish;
  config_.topics.extra_subscribe = wanted.topics.extra_subscribe;
  auto* thread = static_cast<mqttsn::MqttsnAdapter*>(mesh(Mesh::thread));
  if (thread && !(has_same_robots && has_same_topics)) {
    thread->reconfigure(
        TopicPolicy(scheme_, config_.topics.extra_publish, config_.topics.extra_subscribe),
        RobotNames(config_.robots));
  }
  if (ble_ && !has_same_robots) ble_->reconfigure(RobotNames(config_.robots));
}

}  // namespace slamgw
