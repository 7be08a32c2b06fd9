// SPDX-License-Identifier: Apache-2.0
// The provisioning protocol as both ends of a link share it (Mesh Profile 1.0 section 5.4): types
// and sizes of its PDUs, and the keys derived from the shared secret. Numbers in PDUs are
// big-endian.
#pragma once

#include <cstdint>
#include <optional>

#include "simulation/ble/security.hpp"

namespace slamgw::sim::ble {

enum class Pdu : std::uint8_t {
  invite = 0x00,
  capabilities = 0x01,
  start = 0x02,
  public_key = 0x03,
  input_complete = 0x04,
  confirmation = 0x05,
  random = 0x06,
  data = 0x07,
  complete = 0x08,
  failed = 0x09,
};

/// Section 5.4.4.
enum class ProvisioningError : std::uint8_t {
  invalid_pdu = 0x01,
  invalid_format = 0x02,
  unexpected_pdu = 0x03,
  confirmation_failed = 0x04,
  decryption_failed = 0x06,
};

/// Section 5.3.1.4.3.
enum class CloseReason : std::uint8_t { success = 0x00, timeout = 0x01, fail = 0x02 };

enum class OobMethod : std::uint8_t { none = 0x00, static_oob = 0x01 };

/// Between the provisioner and a device (PB-ADV, Mesh Profile 1.0 section 5.3). A link without a
/// PDU for `link_time` is over.
constexpr std::chrono::seconds link_time{60};
struct LinkSignal {
  enum class Kind : std::uint8_t { open, opened, pdu, close };
  Kind kind = Kind::pdu;
  std::uint32_t link = 0;  ///< one number for each `open`
  Key uuid{};              ///< `open`: of the wanted device
  Bytes pdu;               ///< `pdu`: type first
};

/// The data that make a device a node.
struct ProvisioningData {
  Key net_key{};
  std::uint16_t net_key_index = 0;
  std::uint8_t flags = 0;  ///< bit 0 key refresh, bit 1 IV update
  std::uint32_t iv_index = 0;
  Address address = 0;

  bool operator==(const ProvisioningData&) const = default;
};

/// 25 octets.
Bytes encode(const ProvisioningData& data);
std::optional<ProvisioningData> decode_provisioning_data(ByteView octets);

/// Returns the size of the whole PDU; nothing for unknown types.
std::optional<std::size_t> pdu_size(std::uint8_t type);
Bytes make_pdu(Pdu type, ByteView parameters);

/// ConfirmationSalt and ConfirmationKey (section 5.4.2.4). `inputs`: the parameters of Invite,
/// Capabilities and Start and both public keys, the provisioner's first.
struct Authentication {
  Key salt{};
  Key key{};
};
Authentication authentication(ByteView inputs, const Secret& secret);
Key confirmation(const Authentication& with, const Key& random, const Key& auth_value);

/// Section 5.4.2.5.
struct SessionKeys {
  Key session_key{};
  Nonce nonce{};
  Key device_key{};
};
SessionKeys session_keys(const Secret& secret, const Authentication& with,
                         const Key& provisioner_random, const Key& device_random);

}  // namespace slamgw::sim::ble
