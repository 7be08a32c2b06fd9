// SPDX-License-Identifier: Apache-2.0
// The provisioning half of Nordic's serial firmware: commands 0x60-0x6f, events 0xc0-0xc9, two
// contexts that each run one link (PB-ADV). ECDH is off-loaded to the host, as the stock example
// does. The board asks it for replies and events; Network carries its link signals.
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <optional>

#include "simulation/ble/board/reply.hpp"
#include "simulation/ble/provisioning_pdu.hpp"

namespace slamgw::sim::ble {

/// An unprovisioned device's beacon as the board's radio receives it.
struct Beacon {
  Key uuid{};
  std::uint16_t number = 0;  ///< of the robot; makes its advertiser address
  std::int8_t rssi_dbm = 0;
};

class Provisioner {
 public:
  static constexpr std::size_t contexts = 2;
  /// Link Close is said three times before the link is closed for the host, too.
  static constexpr std::chrono::milliseconds closing_time{60};

  explicit Provisioner(Random random);

  /// The board's reset: contexts, scanning and the key pair are void.
  void reset();

  /// Nothing for unknown opcodes of the range: the firmware does not answer them. Lengths are not
  /// checked (but Auth Data's is); octets that are missing count as 0.
  std::optional<Reply> on_command(std::uint8_t opcode, ByteView params, TimePoint now);
  void on_beacon(const Beacon& beacon);
  void on_link_signal(const LinkSignal& signal, TimePoint now);
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);

  /// Opcode and parameters.
  std::optional<Bytes> next_event();
  std::optional<LinkSignal> next_link_signal();

 private:
  enum class State {
    idle,
    opening,
    capabilities,
    oob_use,  ///< the host's 0x66 is due
    public_key,
    ecdh_secret,  ///< the host's 0x68
    auth_data,    ///< the host's 0x67
    confirmation,
    random,
    complete,
    closing,
  };
  struct Context {
    State state = State::idle;
    std::uint32_t link = 0;
    TimePoint due{};
    ProvisioningData data;
    std::uint8_t attention_s = 0;
    OobMethod method = OobMethod::none;
    Bytes inputs;  ///< of the confirmation
    PublicKey peer{};
    Secret secret{};
    Authentication authentication;
    Key auth_value{};
    Key random{};
    Key peer_confirmation{};
    Key device_key{};
    CloseReason close_reason = CloseReason::success;
  };

  Reply scan(bool is_on);
  Reply provision(ByteView params, TimePoint now);
  Reply oob_use(ByteView params, TimePoint now);
  Reply auth_data(ByteView params, TimePoint now);
  Reply ecdh_secret(ByteView params, TimePoint now);
  Reply keypair_set(ByteView params);

  void on_pdu(std::uint8_t id, ByteView pdu, TimePoint now);
  void on_capabilities(std::uint8_t id, ByteView parameters);
  void on_public_key(std::uint8_t id, ByteView parameters);
  void on_random(std::uint8_t id, ByteView parameters, TimePoint now);
  void on_complete(std::uint8_t id, TimePoint now);
  void send(std::uint8_t id, Pdu type, ByteView parameters);
  void send_confirmation(std::uint8_t id);
  void close(std::uint8_t id, CloseReason reason, TimePoint now);

  Random random_;
  bool is_scanning_ = false;
  KeyPair key_pair_;
  std::array<Context, contexts> contexts_;
  std::uint32_t last_link_ = 0;
  std::deque<Bytes> events_;
  std::deque<LinkSignal> signals_;
};

}  // namespace slamgw::sim::ble
