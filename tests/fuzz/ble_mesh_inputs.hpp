// SPDX-License-Identifier: Apache-2.0
// Turns a fuzzer's octets into inputs of BleMesh on a BoardRadio; also checks the outcomes of its
// commands.
#pragma once

#include <algorithm>
#include <string>

#include "adapters/ble_mesh_usb_cdc/ble_mesh.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/board_radio.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/serial_protocol.hpp"

namespace slamgw::ble {

class MeshInputs {
 public:
  MeshInputs() { mesh_.on_start(); }

  void apply(std::uint8_t verb, std::uint8_t argument, ByteView octets) {
    switch (verb % 16) {
      case 0: mesh_.on_bytes(octets, now_); break;
      case 1: now_ += std::chrono::milliseconds{10} * argument; break;
      case 2: mesh_.on_port_open(now_); break;
      case 3: mesh_.on_port_closed("closed", now_); break;
      case 4: mesh_.on_receipt(argument, ReceiptOutcome{argument % 2 == 0}, now_); break;
      case 5: command(argument, octets); break;
      case 6: answer(argument < 128 ? 0 : argument, octets); break;
      case 7: message(argument, octets); break;
      case 8: mesh_.on_broker_link(argument % 2 == 0, now_); break;
      case 9: event(argument, octets); break;
      case 10: mesh_.on_stored(argument < 128 ? "" : "no space", now_); break;
      case 11: order(argument, octets); break;
      case 12: mesh_.on_deadline(now_ += std::chrono::seconds{argument}); break;
      case 13: mesh_.on_session_held("nr1", now_); break;
      case 14: ended_ += mesh_.give_up("nr1", now_).size(); break;
      case 15: relay(argument, octets); break;
    }
    mesh_.on_deadline(now_);
    drain();
  }

  /// Checks that no action is overdue and that no command has ended twice.
  bool is_settled() const {
    const auto due = mesh_.deadline();
    return (!due || *due > now_) && ended_ <= asked_ && answered_ <= ordered_;
  }

 private:
  void command(std::uint8_t argument, ByteView octets) {
    const std::string types[] = {"cmd", "run", "x"};
    ++asked_;
    mesh_.on_broker_message(
        {"nr1",
         {"p/server/nr1/" + types[argument % 3], Bytes(octets.begin(), octets.end()),
          Qos::at_least_once, argument >= 128},
         CommandId{asked_}},
        now_);
  }

  void relay(std::uint8_t argument, ByteView octets) {
    mesh_.on_robot_message(
        {"p/robot/r" + std::to_string(argument) + "/update", Bytes(octets.begin(), octets.end()),
         Qos::at_most_once, argument >= 250},
        now_);
  }

  /// The board's response to the command in flight.
  void answer(std::uint8_t status, ByteView data) {
    const Bytes params = ByteWriter{}.write_u8(last_command_).write_u8(status).write(data).take();
    if (params.size() <= max_frame_params) mesh_.on_bytes(encode_frame(0x84, params), now_);
  }

  /// Gives the board's event c0 to cf, most of which are about provisioning.
  void event(std::uint8_t opcode, ByteView params) {
    if (params.size() <= max_frame_params)
      mesh_.on_bytes(encode_frame(static_cast<std::uint8_t>(0xc0 | opcode % 16), params), now_);
  }

  void order(std::uint8_t argument, ByteView octets) {
    const std::string text(as_text(octets));
    ++ordered_;
    switch (argument % 7) {
      case 0: return mesh_.on_order(ordered_, ScanOrder{}, now_);
      case 1: return mesh_.on_order(ordered_, ProvisionOrder{std::string(32, '1'), text}, now_);
      case 2: return mesh_.on_order(ordered_, NodesOrder{}, now_);
      case 3: return mesh_.on_order(ordered_, RemoveOrder{text, argument >= 128}, now_);
      case 4: return mesh_.on_order(ordered_, ImportOrder{text}, now_);
      case 5: return mesh_.on_order(ordered_, ResetBoardOrder{}, now_);
      case 6: return mesh_.on_order(ordered_, RefreshKeysOrder{{text}, argument >= 128}, now_);
    }
  }

  void message(std::uint8_t source, ByteView payload) {
    ByteWriter event;
    event.write_u16_le(source).write_u16_le(1).write_u32_le(0).write_u8(4);
    for (int i = 0; i < 8; ++i) event.write_u8(0);
    event.write_u16_le(static_cast<std::uint16_t>(payload.size())).write(payload);
    if (event.bytes().size() <= max_frame_params)
      mesh_.on_bytes(encode_frame(0xd0, event.bytes()), now_);
  }

  void drain() {
    Bytes echo;
    while (auto action = mesh_.next_action()) {
      if (auto* write = std::get_if<WriteSerial>(&*action)) {
        if (write->bytes[0] == 9 && write->bytes[1] == 2) echo = write->bytes;
        last_command_ = write->bytes[1];
      }
      if (std::holds_alternative<OrderEnded>(*action)) ++answered_;
      auto* event = std::get_if<MeshEvent>(&*action);
      if (event != nullptr && std::holds_alternative<CommandOutcome>(*event)) ++ended_;
    }
    if (echo.empty()) return;
    echo[1] = 0x82;
    mesh_.on_bytes(echo, now_);
    drain();
  }

  static bool not_random(std::span<std::uint8_t> octets) {
    std::ranges::fill(octets, std::uint8_t{1});
    return true;
  }

  BleMesh mesh_{Settings{},
                TopicScheme("p", "g"),
                RobotNames({{"nr1", 0x0010, {}}}),
                NodeDatabase{},
                std::make_unique<BoardRadio>(Settings{}, NodeDatabase{}, not_random, 1),
                not_random};
  TimePoint now_{};
  std::uint8_t last_command_ = 0;
  std::uint64_t asked_ = 0;
  std::uint64_t ended_ = 0;
  std::uint64_t ordered_ = 0;
  std::uint64_t answered_ = 0;
};

}  // namespace slamgw::ble
