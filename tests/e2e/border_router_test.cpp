// SPDX-License-Identifier: Apache-2.0
// State of the Thread mesh, from otbr-agent's bus to the broker and to operators.
#include <gtest/gtest.h>
#include <signal.h>

#include "tests/e2e/gateway_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/mosquitto.hpp"
#include "tests/support/private_bus.hpp"
#include "tests/thread_border_router/fake_otbr_agent.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

constexpr const char* thread_topic = "ntnu-slam/gateway/test/thread";

TEST(BorderRouter, RetainsDocumentWhileAgentRuns) {
  Mosquitto broker;
  TempDir directory;
  const PrivateBus bus(directory / "bus");
  FakeOtbrAgent agent(bus.address());
  agent.role = "detached";
  agent.come();
  const std::vector<std::string> launcher{"env", "DBUS_SYSTEM_BUS_ADDRESS=" + bus.address()};
  const json configuration = {{"broker", {{"uri", broker.uri()}}}};
  GatewayProcess gateway(configuration);
  gateway.process().send_signal(SIGTERM);
  ASSERT_TRUE(gateway.process().wait());
  gateway.start(launcher);
  const auto retained = [&](const std::string& words) {
    const Subscriber late(broker, thread_topic, "%p");
    return eventually([&] {
      agent.process();
      const auto lines = late.lines();
      return !lines.empty() && lines.back().find(words) != std::string::npos;
    });
  };
  ASSERT_TRUE(retained(R"("role":"detached")")) << gateway.log();
  EXPECT_EQ(gateway.ctl({"status"})["meshes"]["thread"]["role"], "detached");

  agent.neighbours = {{0x1122334455667788, 0x4401, 2, -71, false, true}};
  agent.change_role("leader");
  ASSERT_TRUE(retained(R"("extended_address":"1122334455667788")")) << gateway.log();

  gateway.process().send_signal(SIGKILL);
  ASSERT_TRUE(gateway.process().wait());
  agent.leave();
  const Subscriber subscriber(broker, thread_topic, "%r '%p'");
  ASSERT_TRUE(eventually([&] { return !subscriber.lines().empty(); }));
  gateway.start(launcher);
  ASSERT_TRUE(eventually([&] { return subscriber.lines().back() == "0 ''"; })) << gateway.log();
}

}  // namespace
}  // namespace slamgw::test
