// SPDX-License-Identifier: Apache-2.0
// The adapter over a D-Bus daemon of its own, with a fake bluetooth-meshd at the other end.
#include "adapters/ble_mesh_bluez/io/meshd_adapter.hpp"

#include <gtest/gtest.h>

#include <fstream>
#include <set>

#include "tests/ble_mesh_bluez/io/fake_meshd_service.hpp"
#include "tests/ble_mesh_usb_cdc/event_log.hpp"
#include "tests/ble_mesh_usb_cdc/hex.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/memory_session_store.hpp"
#include "tests/support/private_bus.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::ble {
namespace {

using test::PrivateBus;

/// Returns the recorded calls between a real meshd and the gateway.
std::set<std::string> recorded_calls() {
  std::set<std::string> calls;
  std::ifstream file(SLAMGW_VECTORS "/bluez_mesh/calls.txt");
  for (std::string line; std::getline(file, line);) calls.insert(line);
  return calls;
}

class Listener : public MeshListener, public EventLog {
 public:
  void on_mesh_event(MeshEvent event) override { events.push_back(std::move(event)); }
};

class MeshdAdapterTest : public ::testing::Test {
 protected:
  MeshdAdapterTest() { bus.emplace(directory / "bus"); }
  ~MeshdAdapterTest() override {
    if (adapter) adapter->stop();
    io.poll();
  }

  void start() {
    adapter = std::make_unique<MeshdAdapter>(io, settings, TopicScheme("ntnu-slam", "gw"),
                                             RobotNames(), directory.path(), sessions, listener,
                                             PrivateBus::address_of(directory / "bus"));
    adapter->start();
  }
  bool eventually(const std::function<bool()>& condition) {
    return test::eventually(io, [&] {
      fake.process();
      return condition();
    });
  }
  bool comes_up() {
    return eventually([this] { return listener.is_up(); });
  }
  bool is_configured() const {
    const std::string file = test::read_file(directory / "mesh.json");
    return file.find("\"configured\"") != file.npos;
  }

  boost::asio::io_context io;
  test::TempDir directory;
  test::MemorySessionStore sessions;
  Settings settings;
  Listener listener;
  std::optional<PrivateBus> bus;
  FakeMeshdService fake{PrivateBus::address_of(directory / "bus")};
  std::unique_ptr<MeshdAdapter> adapter;
};

TEST_F(MeshdAdapterTest, ProvisionsRobotAndCarriesMessagesBothWays) {
  fake.meshd.robots.add(1);
  fake.come();
  start();
  ASSERT_TRUE(comes_up());
  ASSERT_TRUE(eventually([&] { return is_configured(); }));
  EXPECT_TRUE(fake.capabilities.empty());

  fake.meshd.say(0x0100, hex("c9 59 00 0a 00 ec ff"));
  ASSERT_TRUE(eventually([&] { return !listener.all<Report>().empty(); }));
  EXPECT_EQ(listener.all<Report>()[0].payload, hex("0a 00 ec ff"));
  adapter->on_receipt(listener.all<Report>()[0].receipt.id, ReceiptOutcome::safe);
  ASSERT_TRUE(eventually([&] { return !fake.meshd.sent.empty(); }));
  EXPECT_EQ(fake.meshd.sent[0].payload, hex("cc 59 00 00"));

  adapter->on_broker_message(
      {"ble-0100",
       {"ntnu-slam/server/ble-0100/cmd", hex("01 00 02 00"), Qos::at_least_once, false},
       CommandId{1}});
  ASSERT_TRUE(eventually([&] { return fake.meshd.sent.size() == 2; }));
  EXPECT_EQ(fake.meshd.sent[1].payload, hex("cd 59 00 01 00 02 00"));
  fake.meshd.say(0x0100, hex("d0 59 00 00"));
  ASSERT_TRUE(eventually([&] { return !listener.all<CommandOutcome>().empty(); }));
  EXPECT_EQ(listener.all<CommandOutcome>()[0].result, CommandResult::delivered);
  EXPECT_EQ(fake.meshd.broken_rules, std::set<std::string>{});
  const std::set<std::string> recorded = recorded_calls();
  for (const std::string& call : fake.calls) EXPECT_TRUE(recorded.contains(call)) << call;
}

TEST_F(MeshdAdapterTest, GivesTheStaticOobWhereADeviceAsksForIt) {
  settings.provisioning.static_oob = "00112233445566778899aabbccddeeff";
  fake.meshd.robots.add(1).static_oob = hex("00112233445566778899aabbccddeeff");
  fake.come();
  start();
  ASSERT_TRUE(eventually([&] { return is_configured(); }));
  EXPECT_EQ(fake.capabilities, std::set<std::string>{"static-oob"});
  EXPECT_EQ(fake.prompted, fake.meshd.robots.devices[0].static_oob);
}

TEST_F(MeshdAdapterTest, ProvisionsNoDeviceWithoutStaticOob) {
  settings.provisioning.static_oob = "00112233445566778899aabbccddeeff";
  fake.meshd.robots.add(1);
  fake.come();
  start();
  ASSERT_TRUE(eventually([&] { return listener.has_notice("says that it has no static OOB"); }));
  EXPECT_EQ(fake.meshd.robots.devices[0].address, 0);
}

TEST_F(MeshdAdapterTest, ReconnectsAfterMeshdOrDaemonRestarts) {
  fake.come();
  start();
  ASSERT_TRUE(comes_up());
  fake.leave();
  ASSERT_TRUE(eventually([&] { return !listener.is_up(); }));
  EXPECT_NE(listener.all<LinkChange>().back().detail.find("is not running"), std::string::npos);
  fake.come();
  ASSERT_TRUE(comes_up());

  adapter->stop();
  adapter.reset();
  ASSERT_TRUE(eventually([&] { return fake.meshd.attached() == nullptr; }));
  listener.events.clear();
  start();
  ASSERT_TRUE(comes_up());
  EXPECT_EQ(fake.meshd.imports, 1);
  EXPECT_EQ(fake.meshd.attached()->address, settings.address);
}

TEST_F(MeshdAdapterTest, AttachesOnNewConnectionAfterMeshdFailed) {
  fake.come();
  start();
  ASSERT_TRUE(comes_up());
  const std::string before = fake.name_of_application();
  fake.meshd.is_without_controller = true;  // so the next call takes the link down
  adapter->manage(ResetBoardOrder{}, [](const OrderAnswer&) {});
  ASSERT_TRUE(eventually([&] {
    return listener.all<LinkChange>().back().detail.find("waits for") != std::string::npos;
  }));
  fake.meshd.is_without_controller = false;
  ASSERT_TRUE(comes_up());
  EXPECT_NE(fake.name_of_application(), before);
  EXPECT_EQ(fake.meshd.imports, 1);
}

TEST_F(MeshdAdapterTest, WaitsForABus) {
  bus.reset();
  start();
  ASSERT_TRUE(eventually([&] { return !listener.all<LinkChange>().empty(); }));
  EXPECT_NE(listener.all<LinkChange>()[0].detail.find("the system bus is not available"),
            std::string::npos);
  bus.emplace(directory / "bus");
  fake.come();
  EXPECT_TRUE(comes_up());
}

TEST_F(MeshdAdapterTest, ReconnectsAfterBusRestarts) {
  fake.come();
  start();
  ASSERT_TRUE(comes_up());
  bus.reset();
  ASSERT_TRUE(eventually([&] { return !listener.is_up(); }));
  fake.leave();
  bus.emplace(directory / "bus");
  fake.come();
  EXPECT_TRUE(comes_up());
}

TEST_F(MeshdAdapterTest, AcceptsCallsOnlyFromMeshd) {
  fake.come();
  start();
  ASSERT_TRUE(comes_up());
  FakeMeshdService stranger{PrivateBus::address_of(directory / "bus")};
  const std::string error =
      stranger.try_to_speak(fake.name_of_application(), fake.element, [&] { io.poll(); });
  EXPECT_EQ(error, "org.freedesktop.DBus.Error.AccessDenied");
  EXPECT_TRUE(listener.all<Report>().empty());
}

TEST_F(MeshdAdapterTest, StopsAtOnceWhenMeshdDoesNotAnswer) {
  fake.meshd.does_not_answer = true;
  fake.come();
  start();
  ASSERT_TRUE(eventually([&] { return !fake.element.empty() || !listener.events.empty(); }));
  adapter->stop();
  const std::size_t events = listener.events.size();
  io.poll();
  fake.process();
  io.poll();
  EXPECT_EQ(listener.events.size(), events);
}

}  // namespace
}  // namespace slamgw::ble
