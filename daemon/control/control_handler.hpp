// SPDX-License-Identifier: Apache-2.0
// The requests of the control socket to the daemon; `who` is the operator, for the audit trail.
// Implemented by App, and by a fake in tests. Events for `watch` go the other way, as TraceEvent
// (daemon/core/trace_event.hpp), through ControlServer::publish.
#pragma once

#include <functional>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>

#include "daemon/core/bytes.hpp"
#include "daemon/core/operator_order.hpp"

namespace slamgw {

class ControlHandler {
 public:
  virtual ~ControlHandler() = default;
  virtual nlohmann::json status() = 0;
  /// Returns an array with a row for each robot, or only for the robot with this id.
  virtual nlohmann::json robots(const std::optional<std::string>& robot) = 0;
  /// The gateways of this broker and what they serve: FleetMember::status.
  virtual nlohmann::json fleet() = 0;
  /// The sessions of MQTT-SN, or only this robot's: mqttsn::client_report().
  virtual OrderAnswer mqttsn_clients(const std::optional<std::string>& robot) = 0;
  /// Called when the first watcher has come, and when the last watcher has gone.
  virtual void on_watched(bool is_watched) = 0;
  /// Sends a command to a robot. `done` is called once, now or later, with `{"outcome",
  /// "after_ms", "why"}`.
  virtual void send(const std::string& who, const std::string& robot, const std::string& type,
                    Bytes payload, std::function<void(nlohmann::json)> done) = 0;
  /// Asks a robot for a sign of life. `done` is called once, within seconds.
  virtual void ping(const std::string& robot, OrderDone done) = 0;
  /// Carries out an order about the BLE mesh. `done` is called once, now or minutes later.
  virtual void manage_ble(const std::string& who, BleOrder order, OrderDone done) = 0;
  /// Carries out an order about dead letters. `done` is called once, now or minutes later.
  virtual void manage_store(const std::string& who, StoreOrder order, OrderDone done) = 0;
  /// Removes a robot that is offline from the registry and its presence from the broker.
  virtual OrderAnswer forget(const std::string& who, const std::string& robot) = 0;
  /// Reads the configuration again. Answers which changes took effect and which need a restart. If
  /// there are problems, answers these instead, one a line, and changes nothing.
  virtual OrderAnswer reload(const std::string& who) = 0;
};

}  // namespace slamgw
