// SPDX-License-Identifier: Apache-2.0
// A device on a provisioning link (Mesh Profile 1.0 section 5.4.2): answers the provisioner's PDUs
// until it has its network data or something is wrong. One object per link. No bearer and no clock:
// Node opens and closes the link.
#pragma once

#include <optional>

#include "simulation/ble/provisioning_pdu.hpp"

namespace slamgw::sim::ble {

class Provisionee {
 public:
  struct Identity {
    KeyPair key_pair;
    std::optional<Key> static_oob;  ///< required if set
  };
  struct Result {
    ProvisioningData data;
    Key device_key{};
  };

  Provisionee(const Identity& identity, const Key& random) : identity_(identity), random_(random) {}

  /// Returns the answer, if any. A wrong or unexpected PDU is answered with Failed; later PDUs are
  /// ignored.
  std::optional<Bytes> on_pdu(ByteView pdu);
  /// Returns the data once the answer was Complete.
  const std::optional<Result>& result() const { return result_; }

 private:
  enum class State { invite, start, public_key, confirmation, random, data, done };

  std::optional<Bytes> on_expected(Pdu type, ByteView parameters);
  Bytes on_start(ByteView parameters);
  Bytes on_public_key(ByteView parameters);
  Bytes on_random(ByteView parameters);
  Bytes on_data(ByteView parameters);
  Bytes fail(ProvisioningError error);
  Key auth_value() const { return identity_.static_oob.value_or(Key{}); }

  Identity identity_;
  Key random_;
  State state_ = State::invite;
  Bytes inputs_;  ///< of the confirmation
  Secret secret_{};
  Authentication authentication_{};
  Key peer_confirmation_{};
  SessionKeys keys_{};
  std::optional<Result> result_;
};

}  // namespace slamgw::sim::ble
