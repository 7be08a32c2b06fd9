// SPDX-License-Identifier: Apache-2.0
// The provisioning half of Nordic's serial firmware: commands 0x60-0x6f, events 0xc0-0xc9, two
// contexts that each run one link (PB-ADV). ECDH is off-loaded to the host, as the stock example
// does. The board asks it for replies and events; Network carries its link signals.
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "simulation/ble/board/provisioning_link.hpp"

namespace slamgw::sim::ble {

/// An unprovisioned device's beacon as the board's radio receives it.
struct Beacon {
  Key uuid{};
  std::uint16_t number = 0;  ///< of the robot; makes its advertiser address
  std::int8_t rssi_dbm = 0;
};

class Provisioner {
 public:
  /// `firmware` must outlive this object.
  Provisioner(const Firmware& firmware, Random random);
  Provisioner(const Provisioner&) = delete;
  Provisioner& operator=(const Provisioner&) = delete;

  /// Resets contexts, scanning and the key pair, as the board's reset does.
  void reset();

  /// Returns nothing for unknown opcodes of the range, which the firmware does not answer. Only the
  /// length of Auth Data is checked; missing octets count as 0. Immediate events of the command
  /// precede its answer.
  std::optional<Reply> on_command(std::uint8_t opcode, ByteView params, TimePoint now);
  void on_beacon(const Beacon& beacon);
  void on_link_signal(const LinkSignal& signal, TimePoint now);
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);

  /// Opcode and parameters.
  std::optional<Bytes> next_event();
  std::optional<LinkSignal> next_link_signal();

 private:
  Reply scan(bool is_on);
  Reply keypair_set(ByteView params);

  ProvisioningLink::Shared shared_;
  std::array<ProvisioningLink, 2> links_;  ///< by context
  bool is_scanning_ = false;
  std::uint32_t last_link_ = 0;
};

}  // namespace slamgw::sim::ble
