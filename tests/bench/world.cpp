// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/world.hpp"

#include <thread>
#include <utility>

#include "tests/bench/raw_sender.hpp"
#include "tests/bench/swarm.hpp"
#include "tests/support/eventually.hpp"

namespace slamgw::bench {

using test::eventually;

namespace {

nlohmann::json with_broker(nlohmann::json configuration, const test::Mosquitto& broker) {
  configuration["broker"]["uri"] = broker.uri();
  return configuration;
}

}  // namespace

World::World(nlohmann::json extra)
    : gateway(with_broker(extra, broker)),
      path(extra == with_mosquitto ? "gateway mosquitto" : "gateway") {
  const bool is_ready = eventually([this] {
    auto status = gateway.ctl({"status"});
    return status.is_object() && status["broker"]["state"] == "up" &&
           status["meshes"]["thread"]["state"] == "up";
  });
  if (!is_ready) throw std::runtime_error(gateway.log());
}

std::uint16_t World::sn_port() const {
  const std::string address = gateway.mqttsn_address();
  return static_cast<std::uint16_t>(std::stoi(address.substr(address.rfind(':') + 1)));
}

Target World::target() {
  return {path, sn_address(), broker_address(), pid(), [this] { bench::settle(*this); }};
}

bool World::is_broker_up() const {
  auto status = gateway.ctl({"status"});
  return status.is_object() && status["broker"]["state"] == "up";
}

void settle(World& world) {
  constexpr std::chrono::milliseconds span{300};
  constexpr std::chrono::seconds limit{120};
  double last = -1;
  const bool is_quiet = eventually(
      [&] {
        std::this_thread::sleep_for(span);
        const double before = std::exchange(last, usage_of(world.pid()).cpu_s);
        if (last - before > 0.015) return false;
        auto status = world.gateway.ctl({"status"});
        return status.is_object() && status["queue"]["depth"] == 0 && status["store"]["depth"] == 0;
      },
      limit);
  if (!is_quiet) throw std::runtime_error("the daemon does not become idle");
}

RunResult through_gateway(const Target& target, const std::string& name, const Load& load,
                          const std::function<void()>& when_ready) {
  Run run(name, target.path, load, target.broker);
  Swarm swarm(target.gateway, load.clients, run.poller(), Run::first_sender_token);
  swarm.connect_all(connects_at_once);
  target.settle();
  if (when_ready) when_ready();
  return run.drive(swarm, target.process, target.gateway.port());
}

RunResult straight(const Target& target, const std::string& name, const Load& load,
                   const std::function<void()>& when_ready) {
  target.settle();
  Run run(name, "raw", load, target.broker);
  RawSender sender(target.broker, load.clients, run.poller(), Run::first_sender_token);
  if (when_ready) when_ready();
  return run.drive(sender, 0);
}

}  // namespace slamgw::bench
