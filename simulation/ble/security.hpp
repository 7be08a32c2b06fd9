// SPDX-License-Identifier: Apache-2.0
// The cryptography of provisioning: P-256, AES-CMAC, AES-CCM (OpenSSL's libcrypto) and the
// functions s1 and k1 (Mesh Profile 1.0 section 3.8.2), virtual addresses. Octets are in the
// specification's order, most significant first. Used by the board's provisioner and by the robots.
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "simulation/ble/access.hpp"
#include "simulation/random.hpp"

namespace slamgw::sim::ble {

using PrivateKey = std::array<std::uint8_t, 32>;
using PublicKey = std::array<std::uint8_t, 64>;  ///< X || Y
using Secret = std::array<std::uint8_t, 32>;     ///< X of the shared point
using Nonce = std::array<std::uint8_t, 13>;

struct KeyPair {
  PrivateKey private_key{};
  PublicKey public_key{};
};

/// The same random numbers give the same pair.
KeyPair make_key_pair(Random& random);
/// Returns nothing when `private_key` is not valid for P-256.
std::optional<PublicKey> public_key_of(const PrivateKey& private_key);
/// ECDH; returns nothing when `peer` is not a point of the curve.
std::optional<Secret> shared_secret(const PrivateKey& own, const PublicKey& peer);

Key aes_cmac(const Key& key, ByteView message);
/// AES-CMAC with the zero key (section 3.8.2.4).
Key s1(ByteView message);
/// AES-CMAC(AES-CMAC(salt, n), p) (section 3.8.2.5).
Key k1(ByteView n, const Key& salt, ByteView p);
Key k1(ByteView n, const Key& salt, std::string_view p);

/// The address of a label UUID (section 3.4.2.3).
Address virtual_address(const Key& label);

/// With an 8-octet MIC at the end.
Bytes aes_ccm_encrypt(const Key& key, const Nonce& nonce, ByteView plain);
/// Returns nothing when the MIC is wrong.
std::optional<Bytes> aes_ccm_decrypt(const Key& key, const Nonce& nonce, ByteView sealed);

Key random_key(Random& random);

}  // namespace slamgw::sim::ble
