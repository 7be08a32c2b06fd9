// SPDX-License-Identifier: Apache-2.0
// Feeds arbitrary octets to the headers for robots and checks their invariants after each step.
// Used by the fuzzer, and by a short random run among the tests.
#pragma once

#include <algorithm>
#include <array>
#include <string_view>

#include "adapters/ble_mesh_usb_cdc/access/robot_models.hpp"
#include "adapters/mqttsn_udp/protocol/packet.hpp"
#include "tests/firmware/headers.hpp"

namespace slamgw::firmware {

/// Returns true if a decoded message is one of the gateway's models and encodes to the same octets.
inline bool ble_holds(ByteView octets) {
  slam_ble_message message{};
  std::array<slam_position, SLAM_MAX_POSITIONS> positions{};
  (void)slam_decode_positions(octets.data(), octets.size(), positions.data(), positions.size());
  if (!slam_ble_decode(octets.data(), octets.size(), &message)) return true;
  const auto access = ble::decode_access(octets);
  if (!access || !ble::vendor_message_of(access->opcode)) return false;
  Bytes out(SLAM_BLE_MAX_SIZE);
  out.resize(slam_ble_encode(&message, out.data(), out.size()));
  return octets.size() > SLAM_BLE_MAX_SIZE ? out.empty() : std::ranges::equal(out, octets);
}

/// An input: kind 1, argument 1, and for a datagram or a payload a length 1 and that many octets.
class SnLife {
 public:
  SnLife() {
    settings_.client_id = "c";
    settings_.will_topic = "w";
    settings_.will_message = "lost";
    settings_.topics = topics;
    settings_.topic_count = 5;
    settings_.keep_alive_s = 10;
    slam_sn_init(&client_, &settings_, 0xfff0);
    slam_sn_connect(&client_, now_);
  }

  /// Returns false when an invariant is broken.
  bool run(ByteView script) {
    std::size_t at = 0;
    const auto next = [&] { return at < script.size() ? script[at++] : std::uint8_t{0}; };
    while (at < script.size()) {
      const std::uint8_t kind = next();
      const std::uint8_t argument = next();
      std::size_t size = kind % 8 < 4 ? next() : 0;
      size = std::min(size, script.size() - at);
      one_input(kind, argument, script.subspan(at, size));
      at += size;
      if (!drains()) return false;
    }
    return true;
  }

 private:
  static constexpr slam_sn_topic topics[5] = {{"a/b", 0, 0},
                                              {"a/#", 0, SLAM_SN_SUBSCRIBE | SLAM_SN_QOS1},
                                              {"c", 0, SLAM_SN_SUBSCRIBE | SLAM_SN_QOS2},
                                              {nullptr, 7, SLAM_SN_SUBSCRIBE | SLAM_SN_PREDEFINED},
                                              {"ab", 0, SLAM_SN_SHORT}};

  void one_input(std::uint8_t kind, std::uint8_t argument, ByteView octets) {
    switch (kind % 8) {
      case 0:
      case 1:
      case 2: receive(octets); return;
      case 3:
        slam_sn_publish(&client_, now_, argument % 6, argument, octets.data(), octets.size());
        return;
      case 4: now_ += argument * 300U; return;
      case 5: slam_sn_sleep(&client_, now_, argument); return;
      case 6: slam_sn_wake(&client_, now_); return;
      default:
        if (argument % 8 == 0) slam_sn_disconnect(&client_, now_);
        if (argument % 8 == 1) slam_sn_connect(&client_, now_);
    }
  }

  /// Prepends the Length, so that it is right most of the time.
  void receive(ByteView octets) {
    Bytes datagram{static_cast<std::uint8_t>(octets.size() + 1)};
    datagram.insert(datagram.end(), octets.begin(), octets.end());
    slam_sn_event event{};
    slam_sn_receive(&client_, now_, datagram.data(), datagram.size(), &event);
    reads_ = reads_ + event.size;
    for (std::size_t i = 0; i < event.size; ++i) reads_ = reads_ + event.data[i];
    for (std::size_t i = 0; i < event.name_size; ++i)
      reads_ = reads_ + static_cast<unsigned char>(event.name[i]);
  }

  /// Returns true if each sent datagram is valid, has a message id where needed, and sending ends.
  bool drains() {
    for (int i = 0; i < 4; ++i) {
      std::size_t size = 0;
      const std::uint8_t* octets = slam_sn_poll(&client_, now_, &size);
      if (size == 0) return slam_sn_wait_ms(&client_, now_) > 0;
      if (size > SLAM_SN_MAX_PACKET) return false;
      const auto packet = mqttsn::decode(ByteView(octets, size));
      if (!packet) return false;
      if (const auto* request = std::get_if<mqttsn::Register>(&*packet);
          request && !request->msg_id)
        return false;
      if (const auto* request = std::get_if<mqttsn::Subscribe>(&*packet);
          request && !request->msg_id)
        return false;
      if (const auto* request = std::get_if<mqttsn::Publish>(&*packet);
          request && (request->qos == mqttsn::WireQos::zero) != (request->msg_id == 0))
        return false;
    }
    return false;
  }

  slam_sn_settings settings_{};
  slam_sn_client client_{};
  std::uint32_t now_ = 0xffff0000;
  volatile std::size_t reads_ = 0;
};

}  // namespace slamgw::firmware
