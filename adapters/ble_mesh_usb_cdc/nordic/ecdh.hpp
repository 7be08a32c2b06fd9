// SPDX-License-Identifier: Apache-2.0
// P-256 for provisioning (Mesh Profile 1.0 section 5.4.2.3): the serial board leaves this to its
// host. Arithmetic only: randomness comes from the caller. Called by BoardRadio and
// ProvisioningSession; nothing of it is ever printed.
#pragma once

#include <functional>
#include <optional>
#include <span>

#include "adapters/ble_mesh_usb_cdc/nordic/commands.hpp"

namespace slamgw::ble {

/// Fills a span with random octets fit for keys; false when the system has none to give.
using RandomSource = std::function<bool(std::span<std::uint8_t>)>;

/// A fresh key pair for one provisioning; nothing when there is no randomness.
std::optional<KeyPair> make_key_pair(const RandomSource& random);
/// Nothing when the private key is 0 or not below the order of the curve.
std::optional<KeyPair> key_pair_of(const std::array<std::uint8_t, 32>& private_key);
/// The X coordinate of the common point; nothing when `peer` is no point of the curve (an attack:
/// Mesh Profile 1.0 section 5.4.3.1 wants it refused).
std::optional<SharedSecret> shared_secret(const KeyPair& own, const PublicKey& peer);

}  // namespace slamgw::ble
