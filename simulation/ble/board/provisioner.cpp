// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/board/provisioner.hpp"

#include <algorithm>
#include <utility>

namespace slamgw::sim::ble {
namespace {

constexpr std::uint8_t unprovisioned_received = 0xc0;
constexpr std::size_t longest_command = 1 + 96;  // Keypair Set

}  // namespace

Provisioner::Provisioner(const Firmware& firmware, Random random)
    : shared_{firmware, random},
      links_{ProvisioningLink{0, shared_}, ProvisioningLink{1, shared_}} {
  reset();
}

void Provisioner::reset() {
  is_scanning_ = false;
  shared_.key_pair = make_key_pair(shared_.random);  // the firmware makes one when it starts
  for (ProvisioningLink& link : links_) link.reset();
  shared_.events.clear();
  shared_.signals.clear();
}

std::optional<Reply> Provisioner::on_command(std::uint8_t opcode, ByteView params, TimePoint now) {
  Bytes padded(params.begin(), params.end());
  padded.resize(std::max(params.size(), longest_command));
  const bool has_context = opcode == 0x63 || (opcode >= 0x66 && opcode <= 0x68);
  if (has_context && padded[0] >= links_.size()) return Reply{Status::invalid_data};
  ProvisioningLink& link = links_[has_context ? padded[0] : 0];
  switch (opcode) {
    case 0x61: return scan(true);
    case 0x62: return scan(false);
    case 0x63: return link.provision(padded, ++last_link_, now);
    case 0x64:  // Listen: the board is never provisioned here
    case 0x6a:  // Capabilities Set: for Listen
      return Reply{};
    case 0x66: return link.oob_use(padded, now);
    case 0x67:
      return link.auth_data(ByteView(padded).first(std::max<std::size_t>(params.size(), 1)), now);
    case 0x68: return link.ecdh_secret(padded, now);
    case 0x69: return keypair_set(padded);
    default: return std::nullopt;
  }
}

Reply Provisioner::scan(bool is_on) {
  if (is_scanning_ == is_on) return {Status::invalid_state};
  is_scanning_ = is_on;
  return {};
}

Reply Provisioner::keypair_set(ByteView params) {
  KeyPair& pair = shared_.key_pair;
  std::copy_n(params.begin(), pair.private_key.size(), pair.private_key.begin());
  std::copy_n(params.begin() + pair.private_key.size(), pair.public_key.size(),
              pair.public_key.begin());
  return {};
}

void Provisioner::on_beacon(const Beacon& beacon) {
  if (!is_scanning_) return;
  Bytes event{unprovisioned_received};
  put(event, beacon.uuid);
  put_u8(event, static_cast<std::uint8_t>(beacon.rssi_dbm));
  put_u8(event, 0x00);  // no GATT bearer
  put_u8(event, 0x01);  // random static address, least significant octet first
  put_u16_le(event, beacon.number);
  put(event, Bytes{0xf9, 0x0b, 0x6e, 0xc1});
  shared_.events.push_back(std::move(event));
}

void Provisioner::on_link_signal(const LinkSignal& signal, TimePoint now) {
  for (ProvisioningLink& link : links_) {
    if (link.owns(signal.link)) return link.on_signal(signal, now);
  }
}

std::optional<TimePoint> Provisioner::deadline() const {
  return first_of(links_[0].deadline(), links_[1].deadline());
}

void Provisioner::on_deadline(TimePoint now) {
  for (ProvisioningLink& link : links_) link.on_deadline(now);
}

std::optional<Bytes> Provisioner::next_event() {
  if (shared_.events.empty()) return std::nullopt;
  Bytes event = std::move(shared_.events.front());
  shared_.events.pop_front();
  return event;
}

std::optional<LinkSignal> Provisioner::next_link_signal() {
  if (shared_.signals.empty()) return std::nullopt;
  LinkSignal signal = std::move(shared_.signals.front());
  shared_.signals.pop_front();
  return signal;
}

}  // namespace slamgw::sim::ble
