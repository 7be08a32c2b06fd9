// SPDX-License-Identifier: Apache-2.0
// One of the board's two provisioning contexts and its link to a device (Mesh Profile 1.0 section
// 5.4.2), in the order of Nordic's firmware: after both public keys the host is asked for the
// shared secret, then for the OOB value.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "simulation/ble/board/reply.hpp"
#include "simulation/ble/firmware.hpp"
#include "simulation/ble/provisioning_pdu.hpp"

namespace slamgw::sim::ble {

class ProvisioningLink {
 public:
  /// Link Close is sent three times before the host sees the link closed.
  static constexpr std::chrono::milliseconds closing_time{60};

  /// State that both contexts share: the board's key pair, and messages for host and radio.
  struct Shared {
    const Firmware& firmware;
    Random random;
    KeyPair key_pair{};
    std::deque<Bytes> events{};  ///< opcode and parameters
    std::deque<LinkSignal> signals{};
  };

  /// `shared` must outlive this object.
  ProvisioningLink(std::uint8_t id, Shared& shared) : id_(id), shared_(shared) {}

  /// The parameters of commands 0x63, 0x66, 0x67 and 0x68, with the context in front. `params` of
  /// the first two and the last are as long as the longest command.
  Reply provision(ByteView params, std::uint32_t link, TimePoint now);
  Reply oob_use(ByteView params, TimePoint now);
  Reply auth_data(ByteView params, TimePoint now);
  Reply ecdh_secret(ByteView params, TimePoint now);

  bool owns(std::uint32_t link) const { return state_ != State::idle && context_.link == link; }
  void on_signal(const LinkSignal& signal, TimePoint now);
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);
  /// Resets the context, as the board's reset does.
  void reset();

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
  /// Cleared at the end of the link.
  struct Context {
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

  bool takes_size(OobMethod method, std::uint8_t size) const;
  void on_opened(TimePoint now);
  void on_pdu(ByteView pdu, TimePoint now);
  void on_expected(Pdu type, ByteView parameters, TimePoint now);
  void on_capabilities(ByteView parameters);
  void on_public_key(ByteView parameters);
  void on_random(ByteView parameters, TimePoint now);
  void on_complete(TimePoint now);
  void send(Pdu type, ByteView parameters);
  void send_confirmation();
  void close(CloseReason reason, TimePoint now);

  std::uint8_t id_;
  Shared& shared_;
  State state_ = State::idle;
  Context context_;
};

}  // namespace slamgw::sim::ble
