// SPDX-License-Identifier: Apache-2.0
// Nordic's board as a radio, without a mesh above it: the device keys in its table, and the scan.
#include "adapters/ble_mesh_usb_cdc/nordic/board_radio.hpp"

#include <gtest/gtest.h>

#include <deque>

#include "tests/ble_mesh_usb_cdc/fake_board.hpp"
#include "tests/ble_mesh_usb_cdc/mesh_rig.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

constexpr std::uint16_t keyed_node = 0x0100;
constexpr std::uint8_t devkey_addition = 0x9c;
constexpr std::uint8_t devkey_deletion = 0x9d;

Key device_key_of(std::uint8_t octet) {
  Key key;
  key.fill(octet);
  return key;
}

/// A BoardRadio and a FakeBoard whose answers wait until the test delivers them.
struct BoardRadioRig {
  BoardRadioRig() {
    radio.on_port_open(now);
    run();
  }

  void run() {
    for (int step = 0; step < 200; ++step) {
      write_all();
      if (!answers.empty()) {
        take_answer();
      } else if (radio.deadline()) {
        now += 10ms;
        radio.on_deadline(now);
      }
    }
  }
  void write_all() {
    while (auto action = radio.next_action(now)) {
      if (const auto* write = std::get_if<WriteSerial>(&*action)) {
        const Bytes answer = board.on_bytes(write->bytes);
        if (!answer.empty()) answers.push_back(answer);
      }
      if (auto* event = std::get_if<RadioEvent>(&*action)) on_event(*event);
    }
  }
  void take_answer() {
    const Bytes answer = std::move(answers.front());
    answers.pop_front();
    radio.on_bytes(answer, now);
    write_all();
  }
  void on_event(const RadioEvent& event) {
    const auto* concern = std::get_if<ProvisionerEvent>(&event);
    if (concern == nullptr) return;
    if (std::holds_alternative<SourceWanted>(*concern)) radio.use_source(1, 1, now);
    if (const auto* one = std::get_if<DeviceKeyUsed>(concern)) used.push_back(*one);
  }
  /// Returns the node's keys on the board.
  std::vector<Bytes> keys() const {
    std::vector<Bytes> found;
    for (const auto& [handle, entry] : board.devices.device_keys)
      if (entry.first == keyed_node) found.push_back(entry.second);
    return found;
  }
  void use(std::uint8_t octet) { radio.use_device_key(keyed_node, device_key_of(octet)); }

  TimePoint now{};
  FakeBoard board;
  std::deque<Bytes> answers;
  BoardRadio radio{Settings{}, test_database(), test_random(), 7};
  std::vector<DeviceKeyUsed> used;
};

TEST(BoardRadio, AddsADeviceKeyAndRemovesIt) {
  BoardRadioRig rig;
  rig.use(1);
  rig.run();
  EXPECT_EQ(rig.keys(), std::vector<Bytes>{Bytes(16, 1)});
  rig.radio.forget_device_key(keyed_node);
  rig.run();
  EXPECT_TRUE(rig.keys().empty());
  EXPECT_EQ(rig.used.size(), 2u);
}

TEST(BoardRadio, DoesNotAddPresentDeviceKeyAgain) {
  BoardRadioRig rig;
  rig.use(1);
  rig.run();
  rig.use(1);
  rig.run();
  ASSERT_EQ(rig.used.size(), 2u);
  EXPECT_EQ(rig.used[1].problem, "");
  EXPECT_EQ(rig.board.count(devkey_addition), 1u);
  rig.radio.forget_device_key(keyed_node);
  rig.run();
  EXPECT_TRUE(rig.keys().empty());
}

TEST(BoardRadio, ReplacesDeviceKeyOfNode) {
  BoardRadioRig rig;
  rig.use(1);
  rig.run();
  rig.use(2);
  rig.run();
  ASSERT_EQ(rig.used.size(), 2u);
  EXPECT_EQ(rig.used[1].problem, "");
  EXPECT_EQ(rig.keys(), std::vector<Bytes>{Bytes(16, 2)});
}

TEST(BoardRadio, AppliesLastDeviceKeyRequestedDuringCommand) {
  BoardRadioRig rig;
  rig.use(1);
  rig.run();
  rig.radio.forget_device_key(keyed_node);
  rig.write_all();
  ASSERT_EQ(rig.answers.size(), 1u) << "to the deletion";
  rig.use(1);
  rig.run();
  EXPECT_EQ(rig.keys(), std::vector<Bytes>{Bytes(16, 1)});
  rig.use(2);
  rig.write_all();
  rig.use(3);
  rig.run();
  EXPECT_EQ(rig.keys(), std::vector<Bytes>{Bytes(16, 3)});
  rig.use(4);
  rig.run();
  rig.radio.forget_device_key(keyed_node);
  rig.run();
  EXPECT_TRUE(rig.keys().empty());
}

TEST(BoardRadio, DoesNotAddDeviceKeyThatIsAlreadyForgotten) {
  BoardRadioRig rig;
  rig.use(1);
  rig.radio.forget_device_key(keyed_node);
  rig.run();
  EXPECT_EQ(rig.used.size(), 1u);
  EXPECT_EQ(rig.board.count(devkey_addition), 0u);
}

TEST(BoardRadio, SendsNothingUnderMissingDeviceKey) {
  BoardRadioRig rig;
  rig.radio.send({.destination = keyed_node, .payload = hex("80 49"), .is_under_device_key = true},
                 rig.now);
  rig.run();
  EXPECT_TRUE(rig.board.sent.empty());
}

TEST(BoardRadio, ReportsMissingDeviceKey) {
  BoardRadioRig rig;
  rig.radio.use_device_key(keyed_node, std::nullopt);
  rig.run();
  ASSERT_EQ(rig.used.size(), 1u);
  EXPECT_NE(rig.used[0].problem, "");
  EXPECT_EQ(rig.board.count(devkey_addition) + rig.board.count(devkey_deletion), 0u);
}

TEST(BoardRadio, AsksForAScanAgainWhenARepeatedRequestIsRefused) {
  BoardRadioRig rig;
  rig.board.status_of[0x61] = 0x86;
  rig.radio.scan(true);
  rig.write_all();
  rig.answers.clear();  // lost on the line
  for (int i = 0; i < 5; ++i) rig.run();
  EXPECT_EQ(rig.board.count(0x61), 2u);
  rig.board.status_of.clear();
  for (int i = 0; i < 20; ++i) rig.run();
  EXPECT_TRUE(rig.board.devices.is_scanning);
}

}  // namespace
}  // namespace slamgw::ble
