// SPDX-License-Identifier: Apache-2.0
#include "tests/simulation/ble/replay_host.hpp"

#include <algorithm>

namespace slamgw::sim::ble {
namespace {

constexpr std::uint8_t provision = 0x63;
constexpr std::uint8_t ecdh_secret = 0x68;
constexpr std::uint8_t devkey_add = 0x9c;
constexpr std::uint8_t unprovisioned_received = 0xc0;
constexpr std::uint8_t provisioning_complete = 0xc5;
constexpr std::uint8_t ecdh_request = 0xc7;

// Offsets in packets, from the length octet on
constexpr std::size_t uuid_in_beacon = 2;
constexpr std::size_t uuid_in_provision = 3;
constexpr std::size_t secret_at = 3;
constexpr std::size_t peer_key_at = 3;
constexpr std::size_t own_key_at = peer_key_at + sizeof(PublicKey);
constexpr std::size_t device_key_in_event = 13;
constexpr std::size_t device_key_in_devkey_add = 6;

template <typename Octets>
Octets octets_at(const Bytes& packet, std::size_t offset) {
  Octets out{};
  std::copy_n(packet.begin() + static_cast<std::ptrdiff_t>(offset), out.size(), out.begin());
  return out;
}

template <typename Octets>
void replace(Bytes& packet, std::size_t offset, const Octets& with) {
  std::copy(with.begin(), with.end(), packet.begin() + static_cast<std::ptrdiff_t>(offset));
}

}  // namespace

std::vector<Bytes> ReplayHost::answers_to(const Bytes& recorded_command, Duration time) {
  if (!recorded_command.empty()) host_.tell(own(recorded_command));
  host_.run(time);
  std::vector<Bytes> packets = std::move(host_.packets);
  host_.packets.clear();
  std::erase_if(packets, [&](const Bytes& packet) {
    return packet[1] == unprovisioned_received && !uuid_.empty();
  });
  for (const Bytes& packet : packets) learn_from(packet);
  return packets;
}

Bytes ReplayHost::own(Bytes command) const {
  const std::uint8_t opcode = command.size() > 1 ? command[1] : 0;
  if (opcode == provision && !uuid_.empty()) replace(command, uuid_in_provision, uuid_);
  if (opcode == devkey_add && !device_key_.empty()) {
    replace(command, device_key_in_devkey_add, device_key_);
  }
  if (opcode == ecdh_secret && !ecdh_request_.empty()) {
    const auto secret = shared_secret(octets_at<PrivateKey>(ecdh_request_, own_key_at),
                                      octets_at<PublicKey>(ecdh_request_, peer_key_at));
    replace(command, secret_at, secret.value());
  }
  return command;
}

void ReplayHost::learn_from(const Bytes& packet) {
  const auto octets = [&](std::size_t offset) {
    const auto first = packet.begin() + static_cast<std::ptrdiff_t>(offset);
    return Bytes(first, first + sizeof(Key));
  };
  if (packet[1] == unprovisioned_received) uuid_ = octets(uuid_in_beacon);
  if (packet[1] == provisioning_complete) device_key_ = octets(device_key_in_event);
  if (packet[1] == ecdh_request) ecdh_request_ = packet;
}

test::RecordedPacket ReplayHost::without_device(test::RecordedPacket packet) {
  const std::uint8_t event = packet.octets[1];
  if (event == unprovisioned_received) undefine(packet, uuid_in_beacon, sizeof(Key));
  if (event == provisioning_complete) undefine(packet, device_key_in_event, sizeof(Key));
  if (event == ecdh_request) undefine(packet, peer_key_at, sizeof(PublicKey));
  return packet;
}

void undefine(test::RecordedPacket& packet, std::size_t first, std::size_t count) {
  std::fill_n(packet.is_defined.begin() + static_cast<std::ptrdiff_t>(first), count, false);
}

}  // namespace slamgw::sim::ble
