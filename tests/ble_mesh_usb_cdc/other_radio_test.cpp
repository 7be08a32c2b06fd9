// SPDX-License-Identifier: Apache-2.0
// The mesh above radio.hpp on a radio that is not Nordic's board. It reports neither TTL nor signal
// strength, does not reveal device keys, keeps its address, and sends longer messages.
#include <gtest/gtest.h>

#include <deque>

#include "adapters/ble_mesh_usb_cdc/ble_mesh.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/mesh_json.hpp"
#include "tests/ble_mesh_usb_cdc/event_log.hpp"
#include "tests/ble_mesh_usb_cdc/fake_devices.hpp"
#include "tests/ble_mesh_usb_cdc/hex.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

constexpr std::uint16_t other_robot = 0x0100;
constexpr std::size_t most_sent_bytes = 380;

class OtherRadio final : public Radio {
 public:
  std::size_t max_send_bytes() const override { return most_sent_bytes; }
  std::size_t max_senders() const override { return 1000; }
  bool hears_earlier_lives() const override { return false; }
  Counters counters() const override { return {{"calls", sent.size()}}; }

  void send(Outgoing message, TimePoint) override {
    sent.push_back(message);
    FakeDevice* device = devices.at(message.destination);
    if (device == nullptr || !message.is_under_device_key) return;
    const Bytes answer = devices.answer(*device, to_hex(message.payload));
    if (!answer.empty()) hear(answer, true);
  }
  void withdraw(std::uint16_t, const Bytes&) override {}
  bool is_idle() const override { return true; }

  void scan(bool is_on) override {
    if (!is_on || devices.devices.empty() || devices.devices[0].address != 0) return;
    UnprovisionedBeacon beacon;
    std::ranges::copy(devices.devices[0].uuid, beacon.uuid.begin());
    say(ProvisionerEvent{beacon});
  }
  void provision(const ProvisionDevice& device) override {
    joining_ = device;
    say(ProvisionerEvent{DeviceAnswered{1}});
  }
  void answer_device(const std::string& refusal, TimePoint) override {
    ASSERT_EQ(refusal, "");
    devices.devices.at(0).address = joining_.address;
    say(ProvisionerEvent{DeviceJoined{}});
    say(ProvisionerEvent{JoinEnded{}});
  }
  void break_off_join(const std::string&) override {}
  void use_device_key(std::uint16_t address, const std::optional<Key>& key) override {
    EXPECT_FALSE(key) << "this radio reveals no device key";
    say(ProvisionerEvent{DeviceKeyUsed{address, {}}});
  }
  void forget_device_key(std::uint16_t address) override {
    say(ProvisionerEvent{DeviceKeyUsed{address, {}}});
  }

  void on_keys_failed(const std::string&, TimePoint) override {}
  void change_keys(const RadioKeys& radio_keys, TimePoint) override {
    has_keys = radio_keys.keys.net_key != Key{};
    say(LinkIsUp{"another radio", "", 0x0001, false});
  }
  void use_source(std::uint16_t, std::uint16_t, TimePoint) override {}
  void delay_source(const std::string&) override {}
  void clear(TimePoint) override { say(ProvisionerEvent{RadioCleared{"it can't be cleared"}}); }
  bool restart(TimePoint) override { return false; }

  std::optional<RadioAction> next_action(TimePoint) override {
    if (actions_.empty()) return std::nullopt;
    RadioAction action = std::move(actions_.front());
    actions_.pop_front();
    return action;
  }
  std::optional<TimePoint> deadline() const override { return std::nullopt; }
  void on_deadline(TimePoint) override {}

  void say(RadioEvent event) { actions_.emplace_back(std::move(event)); }
  /// Delivers a message from the robot.
  void hear(Bytes payload, bool is_under_device_key = false) {
    MessageReceived message;
    message.source = other_robot;
    message.is_under_device_key = is_under_device_key;
    message.actual_length = static_cast<std::uint16_t>(payload.size());
    message.payload = std::move(payload);
    say(std::move(message));
  }

  FakeDevices devices;
  std::vector<Outgoing> sent;
  bool has_keys = false;

 private:
  std::deque<RadioAction> actions_;
  ProvisionDevice joining_;
};

struct OtherRadioRig : EventLog {
  OtherRadioRig() {
    radio.devices.add(1);
    mesh.on_start();
    radio.say(ProvisionerEvent{KeysWanted{}});
  }

  void run_for(Duration time) {
    for (const TimePoint end = now + time; now < end; now += 50ms) {
      mesh.on_deadline(now);
      while (auto action = mesh.next_action()) perform(*action);
    }
  }
  void perform(MeshAction& action) {
    if (auto* store = std::get_if<StoreMesh>(&action)) {
      stored = std::move(store->database);
      mesh.on_stored({}, now);
    }
    if (auto* event = std::get_if<MeshEvent>(&action)) events.push_back(std::move(*event));
    EXPECT_FALSE(std::holds_alternative<WriteSerial>(action) ||
                 std::holds_alternative<ReopenPort>(action));
  }
  void command(const std::string& type, Bytes payload) {
    mesh.on_broker_message(
        {"ble-0100",
         {"ntnu-slam/server/ble-0100/" + type, std::move(payload), Qos::at_least_once, false},
         CommandId{1}},
        now);
    run_for(50ms);
  }

  TimePoint now{};
  std::unique_ptr<OtherRadio> owned = std::make_unique<OtherRadio>();
  OtherRadio& radio = *owned;
  BleMesh mesh{Settings{},
               TopicScheme("ntnu-slam", "gw"),
               RobotNames(),
               std::nullopt,
               std::move(owned),
               [](std::span<std::uint8_t> octets) {
                 std::ranges::fill(octets, std::uint8_t{1});
                 return true;
               }};
  NodeDatabase stored;
};

TEST(OtherRadio, ARobotJoinsIsConfiguredHeardAndCommanded) {
  OtherRadioRig rig;
  rig.run_for(10s);
  EXPECT_TRUE(rig.radio.has_keys);
  EXPECT_TRUE(rig.is_up());
  ASSERT_EQ(rig.stored.nodes.size(), 1u);
  EXPECT_EQ(rig.stored.nodes[0].state, NodeState::configured);
  EXPECT_FALSE(rig.stored.nodes[0].device_key);

  rig.radio.hear(hex("c9 59 00 0a 00 ec ff"));
  rig.run_for(50ms);
  const auto reports = rig.all<Report>();
  ASSERT_EQ(reports.size(), 1u);
  EXPECT_EQ(reports[0].topic, "ntnu-slam/robot/ble-0100/update");
  ASSERT_TRUE(reports[0].radio);
  EXPECT_FALSE(reports[0].radio->rssi_dbm || reports[0].radio->ttl || reports[0].radio->hops);
  rig.mesh.on_receipt(reports[0].receipt.id, ReceiptOutcome::safe, rig.now);
  EXPECT_EQ(rig.radio.sent.back().payload, hex("cc 59 00 00"));

  rig.command("cmd", hex("01 00 02 00"));
  EXPECT_EQ(rig.radio.sent.back().payload, hex("cd 59 00 01 00 02 00"));
  EXPECT_FALSE(rig.radio.sent.back().is_under_device_key);
  rig.radio.hear(hex("d0 59 00 00"));
  rig.run_for(50ms);
  ASSERT_EQ(rig.all<CommandOutcome>().size(), 1u);
  EXPECT_EQ(rig.all<CommandOutcome>()[0].result, CommandResult::delivered);
}

TEST(OtherRadio, RefusesCommandsLongerThanRadioSends) {
  OtherRadioRig rig;
  rig.run_for(10s);
  constexpr std::size_t opcode_bytes = 3;
  rig.command("text", Bytes(most_sent_bytes - opcode_bytes + 1, 'x'));
  ASSERT_EQ(rig.all<CommandOutcome>().size(), 1u);
  EXPECT_NE(rig.all<CommandOutcome>()[0].why.find("at most 377"), std::string::npos);
  rig.command("text", Bytes(most_sent_bytes - opcode_bytes, 'x'));
  EXPECT_EQ(rig.radio.sent.back().payload.size(), most_sent_bytes);
}

TEST(OtherRadio, ReadsItsStoredDatabase) {
  OtherRadioRig rig;
  rig.run_for(10s);
  const auto again = decode_node_database(encode_node_database(rig.stored));
  ASSERT_TRUE(again.has_value());
  EXPECT_FALSE(again->nodes.at(0).device_key);
  EXPECT_EQ(again->nodes.at(0).state, NodeState::configured);
}

}  // namespace
}  // namespace slamgw::ble
