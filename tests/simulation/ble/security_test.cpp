// SPDX-License-Identifier: Apache-2.0
// The cryptography of provisioning against the sample data of Mesh Profile 1.0 (sections 8.1, 8.7).
#include "simulation/ble/security.hpp"

#include <gtest/gtest.h>

#include <algorithm>

#include "simulation/ble/provisioning_pdu.hpp"
#include "tests/simulation/hex.hpp"

namespace slamgw::sim::ble {
namespace {

template <typename Array>
Array array_of(std::string_view text) {
  Array out{};
  const Bytes octets = hex(text);
  std::copy_n(octets.begin(), out.size(), out.begin());
  return out;
}
Key key_of(std::string_view text) { return array_of<Key>(text); }

const char* const provisioner_private =
    "06a516693c9aa31a6084545d0c5db641b48572b97203ddffb7ac73f7d0457663";
const char* const provisioner_public =
    "2c31a47b5779809ef44cb5eaaf5c3e43d5f8faad4a8794cb987e9b03745c78dd"
    "919512183898dfbecd52e2408e43871fd021109117bd3ed4eaf8437743715d4f";
const char* const device_private =
    "529aa0670d72cd6497502ed473502b037e8803b5c60829a5a3caa219505530ba";
const char* const device_public =
    "f465e43ff23d3f1b9dc7dfc04da8758184dbc966204796eccf0d6cf5e16500cc"
    "0201d048bcbbd899eeefc424164e33c201c2b010ca6b4d43a8a155cad8ecb279";
const char* const expected_ecdh_secret =
    "ab85843a2f6d883f62e5684b38e307335fe6e1945ecd19604105c6f23221eb69";

TEST(Security, DerivesSampleDataOfS1AndK1) {
  Bytes test;
  put(test, std::string_view("test"));
  EXPECT_EQ(s1(test), key_of("b73cefbd641ef2ea598c2b6efb62f79c"));
  EXPECT_EQ(k1(hex("3216d1509884b533248541792b877f98"), key_of("2ba14ffa0df84a2831938d57d276cab4"),
               hex("5a09d60797eeb4478aada59db3352a0d")),
            key_of("f6ed15a8934afbe7d83e8dcb57fcf5d7"));
}

TEST(Security, DerivesSampleSharedSecret) {
  const auto provisioner = array_of<PrivateKey>(provisioner_private);
  const auto device = array_of<PrivateKey>(device_private);
  EXPECT_EQ(public_key_of(provisioner), array_of<PublicKey>(provisioner_public));
  EXPECT_EQ(public_key_of(device), array_of<PublicKey>(device_public));
  EXPECT_EQ(shared_secret(provisioner, array_of<PublicKey>(device_public)),
            array_of<Secret>(expected_ecdh_secret));
  EXPECT_EQ(shared_secret(device, array_of<PublicKey>(provisioner_public)),
            array_of<Secret>(expected_ecdh_secret));
}

TEST(Security, RejectsInvalidKeys) {
  PublicKey off_curve = array_of<PublicKey>(device_public);
  off_curve.back() ^= 1;
  EXPECT_FALSE(shared_secret(array_of<PrivateKey>(device_private), off_curve).has_value());
  EXPECT_FALSE(public_key_of(PrivateKey{}).has_value());
  Random random(1, 2, Random::Use::provisioning);
  const KeyPair pair = make_key_pair(random);
  EXPECT_EQ(public_key_of(pair.private_key), pair.public_key);
}

TEST(Security, DerivesSampleDataOfProvisioning) {
  const auto secret = array_of<Secret>(expected_ecdh_secret);
  Bytes inputs = hex("00 0100010000000000000000 0000000000");
  put(inputs, hex(provisioner_public));
  put(inputs, hex(device_public));
  const Authentication with = authentication(inputs, secret);
  EXPECT_EQ(with.salt, key_of("5faabe187337c71cc6c973369dcaa79a"));
  EXPECT_EQ(with.key, key_of("e31fe046c68ec339c425fc6629f0336f"));
  const Key provisioner_random = key_of("8b19ac31d58b124c946209b5db1021b9");
  const Key device_random = key_of("55a2a2bca04cd32ff6f346bd0a0c1a3a");
  EXPECT_EQ(confirmation(with, provisioner_random, Key{}),
            key_of("b38a114dfdca1fe153bd2c1e0dc46ac2"));
  EXPECT_EQ(confirmation(with, device_random, Key{}), key_of("eeba521c196b52cc2e37aa40329f554e"));

  const SessionKeys keys = session_keys(secret, with, provisioner_random, device_random);
  EXPECT_EQ(keys.session_key, key_of("c80253af86b33dfa450bbdb2a191fea3"));
  EXPECT_EQ(keys.nonce, array_of<Nonce>("da7ddbe78b5f62b81d6847487e"));
  EXPECT_EQ(keys.device_key, key_of("0520adad5e0142aa3e325087b4ec16d8"));

  const ProvisioningData data{key_of("efb2255e6422d330088e09bb015ed707"), 0x0567, 0, 0x01020304,
                              0x0b0c};
  Bytes sealed = aes_ccm_encrypt(keys.session_key, keys.nonce, encode(data));
  EXPECT_EQ(sealed, hex("d0bd7f4a89a2ff6222af59a90a60ad58acfe3123356f5cec29 73e0ec50783b10c7"));
  EXPECT_EQ(decode_provisioning_data(*aes_ccm_decrypt(keys.session_key, keys.nonce, sealed)), data);
  sealed[3] ^= 0x10;
  EXPECT_FALSE(aes_ccm_decrypt(keys.session_key, keys.nonce, sealed).has_value());
  EXPECT_FALSE(aes_ccm_decrypt(keys.session_key, keys.nonce, hex("00")).has_value());
}

}  // namespace
}  // namespace slamgw::sim::ble
