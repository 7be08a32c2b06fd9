// SPDX-License-Identifier: Apache-2.0
// The radio alone: its queue for meshd, the order of messages, and the effect of refusals.
#include "adapters/ble_mesh_bluez/meshd_radio.hpp"

#include <gtest/gtest.h>

#include "tests/ble_mesh_bluez/fake_meshd.hpp"
#include "tests/ble_mesh_usb_cdc/hex.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

constexpr std::uint16_t destination = 0x0100;

struct RadioRig {
  explicit RadioRig(FakeMeshd first = {}) : meshd(std::move(first)) {
    feed(MeshdCame{});
    EXPECT_NE(is_up, meshd.does_not_complete || meshd.has_other_keys);
  }
  void feed(MeshdEvent event) {
    radio.on_event(event, now);
    settle();
  }
  void settle() {
    while (true) {
      while (auto action = radio.next_action(now)) on_action(std::get<RadioEvent>(*action));
      if (auto request = radio.next_request()) {
        if (const auto* call = std::get_if<CallMeshd>(&*request)) {
          last_call = call->number;
          sends += std::holds_alternative<Send>(call->call) ? 1 : 0;
          meshd.call(*call);
        }
        if (std::holds_alternative<AcceptToken>(*request)) meshd.accept_token();
        if (std::holds_alternative<Reconnect>(*request)) {
          meshd.detach();
          meshd.events.push_back(MeshdCame{});
        }
        if (const auto* given = std::get_if<GiveAddress>(&*request))
          given_addresses.push_back(given->address);
        continue;
      }
      if (meshd.events.empty()) return;
      MeshdEvent event = std::move(meshd.events.front());
      meshd.events.pop_front();
      radio.on_event(event, now);
    }
  }
  void on_action(RadioEvent& event) {
    if (const auto* refused = std::get_if<SendRefused>(&event)) refusals.push_back(*refused);
    if (std::holds_alternative<LinkIsUp>(event)) is_up = true;
    if (std::holds_alternative<LinkIsDown>(event)) is_up = false;
    const auto* about_nodes = std::get_if<ProvisionerEvent>(&event);
    if (about_nodes == nullptr) return;
    if (std::holds_alternative<SourceWanted>(*about_nodes)) radio.use_source(0x0001, 32, now);
    if (const auto* ended = std::get_if<JoinEnded>(about_nodes)) joins.push_back(*ended);
    if (std::holds_alternative<DeviceJoined>(*about_nodes)) ++joined;
    if (const auto* ended = std::get_if<RadioCleared>(about_nodes)) cleared.push_back(*ended);
  }
  /// A device of meshd begins to join.
  void begin_join() {
    meshd.robots.add(1);
    ProvisionDevice device;
    device.address = destination;
    std::ranges::copy(meshd.robots.devices[0].uuid, device.uuid.begin());
    radio.provision(device);
    settle();
  }
  void run_for(Duration time) {
    for (const TimePoint end = now + time; now < end; now += 5ms) {
      if (radio.deadline() && *radio.deadline() <= now) radio.on_deadline(now);
      settle();
    }
  }
  void send(std::uint8_t number, bool is_urgent = false) {
    radio.send({.destination = destination, .payload = Bytes{number}, .is_urgent = is_urgent}, now);
  }
  Bytes sent() const {
    Bytes all;
    for (const Send& each : meshd.sent) all.push_back(each.payload.front());
    return all;
  }

  static bool count_up(std::span<std::uint8_t> octets) {
    std::uint8_t number = 0;
    for (std::uint8_t& octet : octets) octet = ++number;
    return true;
  }

  TimePoint now{};
  FakeMeshd meshd;
  MeshdRadio radio{Settings{}, NodeDatabase{}, count_up};
  bool is_up = false;
  std::vector<SendRefused> refusals;
  std::vector<JoinEnded> joins;
  std::vector<RadioCleared> cleared;
  std::vector<std::optional<std::uint16_t>> given_addresses;
  int joined = 0;
  int sends = 0;  ///< Send calls, answered or not
  std::uint64_t last_call = 0;
};

TEST(MeshdRadio, SendsOneMessageAtATimeAndUrgentOnesFirst) {
  RadioRig rig;
  for (std::uint8_t number = 1; number <= 3; ++number) rig.send(number);
  rig.send(9, true);
  rig.send(3);
  rig.settle();
  EXPECT_EQ(rig.sent(), Bytes{9});
  rig.run_for(20ms);
  EXPECT_EQ(rig.sent(), Bytes{9}) << "the first message is being sent";
  rig.radio.withdraw(destination, Bytes{2});
  rig.run_for(1s);
  EXPECT_EQ(rig.sent(), (Bytes{9, 1, 3}));
  EXPECT_TRUE(rig.radio.is_idle());
}

TEST(MeshdRadio, GivesALongMessageTheTimeOfItsSegments) {
  RadioRig rig;
  const Bytes longest(MeshdRadio::max_access_bytes, 7);
  rig.radio.send({.destination = destination, .payload = longest}, rig.now);
  rig.settle();
  rig.send(1);
  rig.run_for(31 * MeshdRadio::packet_time);
  EXPECT_EQ(rig.meshd.sent.size(), 1u);
  rig.run_for(3 * MeshdRadio::packet_time);
  EXPECT_EQ(rig.meshd.sent.size(), 2u);
  EXPECT_TRUE(rig.refusals.empty());
}

TEST(MeshdRadio, KeepsABoundedNumberOfMessages) {
  RadioRig rig;
  for (std::size_t number = 0; number < MeshdRadio::max_waiting + 5; ++number)
    rig.send(static_cast<std::uint8_t>(number));
  rig.run_for(10s);
  EXPECT_EQ(rig.meshd.sent.size(), MeshdRadio::max_waiting);
  const Counters counters = rig.radio.counters();
  EXPECT_TRUE(std::ranges::any_of(counters, [](const Counter& counter) {
    return counter.name == "sends_dropped" && counter.value == 5;
  }));
}

TEST(MeshdRadio, ReportsMessagesThatMeshdRefusesToSend) {
  RadioRig rig;
  rig.radio.send(
      {.destination = destination, .payload = hex("8008 00"), .is_under_device_key = true},
      rig.now);
  rig.settle();
  ASSERT_EQ(rig.refusals.size(), 1u);
  EXPECT_EQ(rig.refusals[0].destination, destination);
  EXPECT_NE(rig.refusals[0].why.find("NotFound"), std::string::npos);
}

TEST(MeshdRadio, SendsNothingMoreToAMeshdThatDoesNotAnswer) {
  RadioRig rig;
  rig.meshd.does_not_answer = true;
  rig.send(1);
  rig.send(2);
  rig.settle();
  rig.run_for(MeshdRadio::answer_time_limit + 100ms);
  EXPECT_FALSE(rig.is_up);
  for (std::uint8_t number = 3; number < 10; ++number) {
    rig.send(number);
    rig.feed(MeshdAnswer{.number = rig.last_call, .error = "org.freedesktop.DBus.Error.NoReply"});
    rig.run_for(25s);
  }
  EXPECT_EQ(rig.sends, 1) << "meshd would send all of them once it runs again";
  EXPECT_FALSE(rig.is_up);
  rig.meshd.does_not_answer = false;
  rig.meshd.restart();
  rig.feed(MeshdCame{});
  EXPECT_TRUE(rig.is_up);
  rig.run_for(10s);
  EXPECT_EQ(rig.sends, 1);
  rig.send(99);
  rig.run_for(1s);
  EXPECT_EQ(rig.sent(), Bytes{99});
}

TEST(MeshdRadio, NoticesSoonThatAnIdleMeshdDoesNotAnswer) {
  RadioRig rig;
  rig.run_for(35s);
  EXPECT_TRUE(rig.is_up);
  rig.meshd.does_not_answer = true;
  rig.run_for(15s);
  EXPECT_FALSE(rig.is_up);
}

TEST(MeshdRadio, MakesTheNodeAgainWhenMeshdDoesNotCompleteIt) {
  FakeMeshd meshd;
  meshd.does_not_complete = true;
  RadioRig rig(std::move(meshd));
  rig.run_for(MeshdRadio::node_time_limit - 100ms);
  EXPECT_EQ(rig.meshd.imports, 1);
  rig.meshd.does_not_complete = false;
  rig.meshd.restart();  // its bus name has the same owner for the gateway
  rig.run_for(MeshdRadio::retry_after + 200ms);
  EXPECT_EQ(rig.meshd.imports, 2);
  EXPECT_TRUE(rig.is_up);
}

TEST(MeshdRadio, WaitsWhenMeshdRefusesTheKeysOfItsNewNode) {
  FakeMeshd meshd;
  meshd.has_other_keys = true;
  RadioRig rig(std::move(meshd));
  rig.run_for(9 * MeshdRadio::retry_after);
  EXPECT_EQ(rig.meshd.imports, 1) << "each import costs disk writes";
  rig.meshd.has_other_keys = false;
  rig.run_for(2 * MeshdRadio::retry_after);
  EXPECT_TRUE(rig.is_up);
}

TEST(MeshdRadio, IgnoresAFailureAfterTheDeviceHasJoined) {
  RadioRig rig;
  ProvisionDevice device;
  device.uuid = {1};
  device.address = destination;
  rig.meshd.does_not_answer = true;
  rig.radio.provision(device);
  rig.settle();
  rig.feed(AddNodeComplete{device.uuid, destination});
  rig.feed(AddNodeFailed{device.uuid, "timeout"});
  rig.feed(MeshdAnswer{.number = rig.last_call, .device_keys = {{destination, Key{7}}}});
  EXPECT_EQ(rig.joined, 1);
  ASSERT_EQ(rig.joins.size(), 1u);
  EXPECT_EQ(rig.joins[0].failure, "");
}

TEST(MeshdRadio, FailsJoinThatMeshdDoesNotReport) {
  RadioRig rig;
  rig.meshd.does_not_answer = true;
  rig.radio.provision({});
  rig.settle();
  rig.meshd.does_not_answer = false;
  rig.run_for(MeshdRadio::join_time_limit + 100ms);
  ASSERT_EQ(rig.joins.size(), 1u);
  EXPECT_FALSE(rig.joins[0].failure.empty());
  EXPECT_FALSE(rig.joins[0].may_have_joined) << "the device got no address";
}

TEST(MeshdRadio, ReportsEndOfDeviceThatWasRefused) {
  RadioRig rig;
  rig.begin_join();
  rig.radio.answer_device("its addresses are taken", rig.now);
  while (auto request = rig.radio.next_request())
    if (const auto* given = std::get_if<GiveAddress>(&*request))
      rig.meshd.give_address(given->address);
  rig.settle();
  ASSERT_EQ(rig.joins.size(), 1u);
  EXPECT_EQ(rig.joins[0].failure, "its addresses are taken");
}

TEST(MeshdRadio, BreaksOffOnlyAJoinWithoutAnAddress) {
  for (const bool has_address : {false, true}) {
    RadioRig rig;
    rig.begin_join();
    if (has_address) rig.radio.answer_device("", rig.now);
    rig.radio.break_off_join("the daemon ends");
    rig.settle();
    EXPECT_EQ(rig.joins.size(), has_address ? 0u : 1u);
  }
}

TEST(MeshdRadio, RefusesDeviceThatMeshdAcceptsWithoutStaticOob) {
  for (const bool has_oob : {false, true}) {
    RadioRig rig;
    rig.meshd.does_not_answer = true;
    ProvisionDevice device;
    device.uuid = {1};
    device.address = destination;
    device.static_oob = Key{7};
    rig.feed(StaticOobGiven{});  // for an earlier device
    rig.radio.provision(device);
    rig.settle();
    if (has_oob) rig.feed(StaticOobGiven{});
    rig.feed(RequestProvData{1});
    if (has_oob) {
      EXPECT_TRUE(rig.given_addresses.empty()) << "the device may get an address";
      continue;
    }
    ASSERT_EQ(rig.given_addresses.size(), 1u);
    EXPECT_EQ(rig.given_addresses[0], std::nullopt);
    rig.feed(AddNodeFailed{device.uuid, "timeout"});
    ASSERT_EQ(rig.joins.size(), 1u);
    EXPECT_NE(rig.joins[0].failure.find("says that it has no static OOB"), std::string::npos);
    EXPECT_FALSE(rig.joins[0].may_have_joined);
  }
}

TEST(MeshdRadio, IgnoresDeviceKeyOfFailedJoin) {
  RadioRig rig;
  rig.meshd.does_not_answer = true;
  ProvisionDevice device;
  device.uuid = {1};
  device.address = destination;
  rig.radio.provision(device);
  rig.settle();
  rig.feed(AddNodeComplete{device.uuid, destination});
  const std::uint64_t keys_wanted = rig.last_call;
  rig.meshd.does_not_answer = false;
  rig.run_for(MeshdRadio::join_time_limit + 100ms);
  ASSERT_EQ(rig.joins.size(), 1u);
  rig.meshd.does_not_answer = true;
  device.uuid = {2};
  device.address = destination + 1;
  rig.radio.provision(device);
  rig.settle();
  rig.feed(MeshdAnswer{.number = keys_wanted, .device_keys = {{destination, Key{7}}}});
  EXPECT_EQ(rig.joined, 0);
  EXPECT_EQ(rig.joins.size(), 1u);
}

TEST(MeshdRadio, ReportsFailedClearWhenMeshdGoesAwayWithoutAnswer) {
  RadioRig rig;
  rig.meshd.does_not_answer = true;
  rig.radio.clear(rig.now);
  rig.settle();
  EXPECT_TRUE(rig.cleared.empty());
  rig.feed(MeshdGone{"it is not running"});
  ASSERT_EQ(rig.cleared.size(), 1u);
  EXPECT_NE(rig.cleared[0].problem, "");
  rig.meshd.does_not_answer = false;
  rig.meshd.restart();
  rig.feed(MeshdCame{});
  EXPECT_EQ(rig.cleared.size(), 1u) << "once";
}

}  // namespace
}  // namespace slamgw::ble
