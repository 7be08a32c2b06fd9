// SPDX-License-Identifier: Apache-2.0
// The measured system: the built daemon between load and a real Mosquitto, all on loopback; or any
// other gateway on any host.
#pragma once

#include <functional>
#include <nlohmann/json.hpp>
#include <string>

#include "tests/bench/load.hpp"
#include "tests/e2e/gateway_process.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::bench {

/// Any MQTT-SN gateway, and the broker behind it.
struct Target {
  std::string path = "gateway";  ///< its row in the table
  Address gateway;
  Address broker;
  pid_t process = 0;               ///< 0: its use is not measured
  std::function<void()> settle{};  ///< returns when it is at rest
};

/// `broker.client` of the configuration.
inline const nlohmann::json with_mosquitto{{"broker", {{"client", "mosquitto"}}}};

/// A broker, and the daemon in front of it with defaults and `extra`.
struct World {
  explicit World(nlohmann::json extra = nlohmann::json::object());

  Address sn_address() const { return loopback(sn_port()); }
  Address broker_address() const { return loopback(broker.port()); }
  std::uint16_t sn_port() const;
  Target target();
  pid_t pid() { return gateway.process().pid(); }
  bool is_broker_up() const;

  test::Mosquitto broker;
  test::GatewayProcess gateway;
  const std::string path;
};

/// Waits until earlier messages have reached the broker (presence, perhaps by way of the disk) and
/// the processor is idle.
void settle(World& world);

/// Side by side: many at once would fill the kernel's receive buffer.
constexpr std::size_t connects_at_once = 50;

/// `when_ready`: called when all clients are connected and at rest, before the first message.
RunResult through_gateway(const Target& target, const std::string& name, const Load& load,
                          const std::function<void()>& when_ready = {});
/// The raw floor of the same load.
RunResult straight(const Target& target, const std::string& name, const Load& load,
                   const std::function<void()>& when_ready = {});

}  // namespace slamgw::bench
