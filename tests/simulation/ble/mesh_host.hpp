// SPDX-License-Identifier: Apache-2.0
// A scripted host in front of the whole simulated mesh, on a virtual clock. It sends commands,
// collects events, and can provision a robot with its own ECDH.
#pragma once

#include <algorithm>
#include <optional>
#include <string>
#include <vector>

#include "simulation/ble/network.hpp"
#include "simulation/ble/state_file.hpp"
#include "tests/simulation/ble/host_ecdh.hpp"
#include "tests/simulation/hex.hpp"

namespace slamgw::sim::ble {

class MeshHost {
 public:
  static constexpr const char* net_key = "000102030405060708090a0b0c0d0e0f";
  static constexpr const char* app_key = "101112131415161718191a1b1c1d1e1f";

  explicit MeshHost(const BleOptions& options, const std::string& state = "") : network_(options) {
    if (!state.empty()) restore_state(network_, state);
    network_.on_start(now_);
    fetch();
  }
  static BleOptions unprovisioned(unsigned robots = 1) {
    BleOptions options;
    options.common.robots = robots;
    options.is_unprovisioned = true;
    options.uuid_prefix = hex("736c616d");
    return options;
  }

  /// Sends octets; returns the immediate answers, separated by " | ".
  std::string tell(std::string_view command) { return tell(hex(command)); }
  std::string tell(const Bytes& command) {
    const std::size_t before = packets.size();
    for (const std::uint8_t octet : command) {  // reads while it writes
      network_.on_host_bytes(Bytes{octet}, now_);
      fetch();
    }
    std::string out;
    for (std::size_t i = before; i < packets.size(); ++i) {
      out += (out.empty() ? "" : " | ") + to_hex(packets[i]);
    }
    return out;
  }
  /// Sends a command without its length octet.
  std::string command(Bytes opcode_and_params) {
    opcode_and_params.insert(opcode_and_params.begin(),
                             static_cast<std::uint8_t>(opcode_and_params.size()));
    return tell(opcode_and_params);
  }

  void run(Duration limit) {
    const TimePoint end = now_ + limit;
    while (network_.deadline() <= end) step();
    now_ = end;
  }
  /// Returns the next packet of this event in time, opcode first; drops earlier packets.
  std::optional<Bytes> await(std::uint8_t event, Duration limit = std::chrono::seconds{70}) {
    const TimePoint end = now_ + limit;
    for (;;) {
      while (!packets.empty()) {
        Bytes packet = std::move(packets.front());
        packets.erase(packets.begin());
        if (packet[1] == event) return Bytes(packet.begin() + 1, packet.end());
      }
      if (network_.deadline() > end) return std::nullopt;
      step();
    }
  }

  /// Sets network and application key, and address 0x0001.
  void set_up() {
    tell("05 9f 01 00 01 00");
    tell("13 92 00 00" + std::string(net_key));
    tell("15 97 00 00 00 00" + std::string(app_key));
  }
  /// Starts scanning and provisions the first beacon's device in context 0.
  Bytes start_provisioning(Address address) {
    Bytes keypair = keys.private_key();
    put(keypair, keys.public_key());
    return start_provisioning(address, keypair);
  }
  Bytes start_provisioning(Address address, const Bytes& keypair) {
    Bytes set{0x69};
    put(set, keypair);
    command(set);
    tell("0a 6a 01 00 00 00 00 00 00 00 00");
    tell("01 61");
    const Bytes beacon = await(0xc0).value();
    tell("01 62");
    const Bytes uuid(beacon.begin() + 1, beacon.begin() + 17);
    command(provision_command(0, uuid, address));
    return uuid;
  }
  static Bytes provision_command(std::uint8_t context, const Bytes& uuid, Address address) {
    Bytes out{0x63, context};
    put(out, uuid);
    put(out, hex(net_key));
    put(out, Bytes{0, 0, 0, 0, 0, 0});
    put_u16_le(out, address);
    put(out, Bytes{0, 0, 5});
    return out;
  }
  /// Answers event 0xc7 with the right secret.
  std::string answer_ecdh(const Bytes& request) {
    Bytes answer{0x68, request[1]};
    put(answer, keys.shared_secret(ByteView(request).subspan(2, 64)));
    return command(answer);
  }
  /// Provisions a robot; returns its device key.
  Bytes provision(Address address) {
    start_provisioning(address);
    await(0xc3);
    tell("05 66 00 00 00 00");
    answer_ecdh(await(0xc7).value());
    const Bytes complete = await(0xc5).value();
    await(0xc2);
    return Bytes(complete.begin() + 12, complete.begin() + 28);
  }
  /// Provisions, adds the device key as handle 8 and the address as handle 0.
  void adopt(Address address) {
    set_up();
    Bytes add{0x9c};
    const Bytes device_key = provision(address);
    put_u16_le(add, address);
    put_u16_le(add, 0);
    put(add, device_key);
    command(add);
    Bytes publication{0xa4};
    put_u16_le(publication, address);
    command(publication);
  }
  /// Sends a message to address handle 0; returns the answer's payload, or "".
  std::string ask(std::string_view payload, std::uint8_t key_handle = 8) {
    packets.clear();
    send(payload, key_handle);
    const std::optional<Bytes> event = await(0xd0, std::chrono::seconds{4});
    if (!event) return "";
    last_key_handle = get_u16_le(*event, 5);
    return to_hex(ByteView(*event).subspan(20));
  }
  std::string send(std::string_view payload, std::uint8_t key_handle = 8) {
    Bytes send{0xab, key_handle, 0, 0x01, 0, 0, 0, 4, 0, 0, 0};
    put(send, hex(payload));
    return command(send);
  }

  void reboot() {
    network_.reboot_board(now_);
    packets.clear();
  }
  Network& network() { return network_; }
  TimePoint now() const { return now_; }

  HostKeyPair keys;
  std::vector<Bytes> packets;  ///< packets of the board, length octets first
  Handle last_key_handle = 0;

 private:
  void step() {
    now_ = std::max(now_, network_.deadline());
    network_.on_deadline(now_);
    fetch();
  }
  void fetch() {
    while (auto packet = network_.next_host_packet(now_)) packets.push_back(std::move(*packet));
  }

  TimePoint now_{std::chrono::seconds{1000}};
  Network network_;
};

}  // namespace slamgw::sim::ble
