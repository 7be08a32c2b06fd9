// SPDX-License-Identifier: Apache-2.0
// What is measured: the built daemon between load and a real Mosquitto, all on loopback.
#pragma once

#include <functional>

#include "tests/bench/load.hpp"
#include "tests/e2e/gateway_process.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::bench {

/// A broker, and the daemon in front of it with nothing but defaults, and `extra`.
struct World {
  explicit World(nlohmann::json extra = nlohmann::json::object());

  std::uint16_t sn_port() const;
  pid_t pid() { return gateway.process().pid(); }
  bool is_broker_up() const;

  test::Mosquitto broker;
  test::GatewayProcess gateway;
};

/// Until what was done before has reached the broker (presence messages, perhaps by way of the
/// disk) and the processor rests. Nothing is measured meanwhile.
void settle(World& world);

/// Side by side: many at once would fill the kernel's receive buffer.
constexpr std::size_t connects_at_once = 50;

/// `when_ready`: called when all clients are connected and at rest, before the first message.
RunResult through_gateway(World& world, const std::string& name, const Load& load,
                          const std::function<void()>& when_ready = {});
/// The raw floor of the same load.
RunResult straight(World& world, const std::string& name, const Load& load,
                   const std::function<void()>& when_ready = {});

}  // namespace slamgw::bench
