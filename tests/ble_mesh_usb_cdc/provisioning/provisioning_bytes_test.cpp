// SPDX-License-Identifier: Apache-2.0
// The bytes of provisioning: commands and events as Nordic's host script has them, and the key
// exchange against the sample data of Mesh Profile 1.0 section 8.7.
#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>

#include "adapters/ble_mesh_usb_cdc/nordic/provisioning_session.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/serial_protocol.hpp"
#include "tests/ble_mesh_usb_cdc/hex.hpp"

namespace slamgw::ble {
namespace {

template <std::size_t size>
std::array<std::uint8_t, size> array_of(std::string_view text) {
  const Bytes bytes = hex(text);
  std::array<std::uint8_t, size> out{};
  if (bytes.size() != size) ADD_FAILURE() << text;
  std::copy_n(bytes.begin(), std::min(size, bytes.size()), out.begin());
  return out;
}

Key key_beginning_with(std::uint8_t first) {
  Key key;
  std::iota(key.begin(), key.end(), first);
  return key;
}

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
const char* const common_secret =
    "ab85843a2f6d883f62e5684b38e307335fe6e1945ecd19604105c6f23221eb69";

TEST(Ecdh, AgreesWithTheSpecification) {
  const auto provisioner = key_pair_of(array_of<32>(provisioner_private));
  const auto device = key_pair_of(array_of<32>(device_private));
  ASSERT_TRUE(provisioner && device);
  EXPECT_EQ(to_hex(provisioner->public_key), provisioner_public);
  EXPECT_EQ(to_hex(device->public_key), device_public);
  EXPECT_EQ(to_hex(shared_secret(*provisioner, device->public_key).value()), common_secret);
  EXPECT_EQ(to_hex(shared_secret(*device, provisioner->public_key).value()), common_secret);
}

TEST(Ecdh, RejectsPointsOffCurve) {
  const auto own = key_pair_of(array_of<32>(provisioner_private));
  auto peer = array_of<64>(device_public);
  peer[63] ^= 1;
  EXPECT_FALSE(shared_secret(*own, peer));
  EXPECT_FALSE(shared_secret(*own, PublicKey{}));
}

TEST(Ecdh, DrawsAgainWhenANumberIsOutOfRange) {
  int draws = 0;
  const auto pair = make_key_pair([&](std::span<std::uint8_t> octets) {
    std::fill(octets.begin(), octets.end(), draws++ == 0 ? 0xff : 0x01);
    return true;
  });
  EXPECT_TRUE(pair);
  EXPECT_EQ(draws, 2);
  EXPECT_FALSE(make_key_pair([](std::span<std::uint8_t>) { return false; }));
  EXPECT_FALSE(key_pair_of({})) << "zero is not a private key";
}

TEST(ProvisioningCommands, EqualThoseOfNordicsHostScript) {
  EXPECT_EQ(encode_command(CommandOpcode::scan_start), hex("01 61"));
  EXPECT_EQ(encode_command(CommandOpcode::scan_stop), hex("01 62"));
  EXPECT_EQ(encode_command(CommandOpcode::state_clear), hex("01 ac"));
  EXPECT_EQ(encode_command(CommandOpcode::radio_reset), hex("01 0e"));
  EXPECT_EQ(encode_capabilities_set(), hex("0a 6a 01 00 00 00 00 00 00 00 00"));
  EXPECT_EQ(encode_provision(0, {key_beginning_with(0), key_beginning_with(0xa0), 0, 0x0100, {}},
                             SerialVersion::sdk_3_1),
            hex("2d 63 00 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f a0 a1 a2 a3 a4 a5 a6 a7 "
                "a8 a9 aa ab ac ad ae af 00 00 00 00 00 00 00 01 00 00 00"));
  EXPECT_EQ(encode_oob_use(0, OobMethod::none), hex("05 66 00 00 00 00"));
  SharedSecret secret;
  std::iota(secret.begin(), secret.end(), std::uint8_t{0});
  EXPECT_EQ(encode_command(CommandOpcode::ecdh_secret, std::uint8_t{0}, secret),
            hex("22 68 00 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f 10 11 12 13 14 15 16 17 "
                "18 19 1a 1b 1c 1d 1e 1f"));
  EXPECT_EQ(encode_command(CommandOpcode::devkey_add, std::uint16_t{0x0100}, std::uint16_t{0},
                           key_beginning_with(0)),
            hex("15 9c 00 01 00 00 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f"));
}

TEST(ProvisioningCommands, HaveTheLengthsOfTheirTables) {
  const KeyPair pair = *key_pair_of(array_of<32>(device_private));
  EXPECT_EQ(encode_command(CommandOpcode::keypair_set, pair.private_key, pair.public_key),
            hex("61 69") + hex(device_private) + hex(device_public));
  EXPECT_EQ(encode_command(CommandOpcode::auth_data, std::uint8_t{1}, key_beginning_with(0)),
            hex("12 67 01 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f"));
  EXPECT_EQ(encode_oob_use(1, OobMethod::static_data), hex("05 66 01 01 00 10"));
  EXPECT_EQ(encode_provision(1, {{}, {}, 0x01020304, 0x7fff, {}}, SerialVersion::sdk_3_1).size(),
            46u);
}

template <class T>
T read_as(const Bytes& wire) {
  const auto event = decode_event(ByteView(wire).subspan(1));
  if (event.has_value()) {
    const auto* provisioning = std::get_if<ProvisioningEvent>(&*event);
    if (provisioning != nullptr && std::holds_alternative<T>(*provisioning))
      return std::get<T>(*provisioning);
  }
  ADD_FAILURE() << to_hex(wire) << " is not that event";
  return {};
}

TEST(ProvisioningEvents, AreRead) {
  const auto beacon = read_as<UnprovisionedBeacon>(
      hex("1a c0 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f c8 00 01 c4 3b f9 0b 6e 01"));
  EXPECT_EQ(beacon.uuid, key_beginning_with(0));
  EXPECT_EQ(beacon.rssi_dbm, -56);
  EXPECT_EQ(read_as<ProvisioningLinkOpened>(hex("02 c1 01")).context, 1);
  EXPECT_EQ(read_as<ProvisioningLinkClosed>(hex("03 c2 01 02")).reason, 2);
  EXPECT_EQ(read_as<CapabilitiesReceived>(hex("0b c3 00 01 00 00 00 00 00 00 00 00")).elements, 1);
  EXPECT_EQ(
      read_as<CapabilitiesReceived>(hex("0b c3 00 03 00 01 00 00 00 00 00 00")).static_oob_types,
      1);
  EXPECT_EQ(read_as<AuthenticationRequested>(hex("05 c6 00 01 00 00")).method, 1);
  EXPECT_EQ(read_as<ProvisioningFailed>(hex("03 c9 00 04")).error, 4);
  const Bytes ecdh = hex("62 c7 01") + hex(device_public) + hex(provisioner_private);
  EXPECT_EQ(to_hex(read_as<EcdhRequested>(ecdh).peer), device_public);
  const auto complete = read_as<ProvisioningComplete>(
      hex("2c c5 01 00 00 00 00 00 00 02 01 00 00 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f "
          "a0 a1 a2 a3 a4 a5 a6 a7 a8 a9 aa ab ac ad ae af"));
  EXPECT_EQ(complete.context, 1);
  EXPECT_EQ(complete.device_key, key_beginning_with(0));
  EXPECT_EQ(complete.address, 0x0102);
  EXPECT_EQ(complete.net_key, key_beginning_with(0xa0));
}

/// Releases 2.2.0, 3.1.0 and 5.0.0 said the same (tests/vectors/nordic_board/provisioning.txt).
TEST(ProvisioningEvents, ReadKeysAndAddressOfADeviceThatHasJoined) {
  const auto joined = read_as<ProvisioningComplete>(
      hex("2c c5 00 00 00 00 00 00 00 00 01 00 00 4f 9b 79 1f e1 0a 9f d6 54 fa 70 4b 59 23 a8 90 "
          "10 11 12 13 14 15 16 17 18 19 1a 1b 1c 1d 1e 1f"));
  EXPECT_EQ(joined.address, 0x0100);
  EXPECT_EQ(to_hex(joined.device_key), "4f9b791fe10a9fd654fa704b5923a890");
  EXPECT_EQ(joined.net_key, key_beginning_with(0x10));
}

TEST(ProvisioningEvents, OfTheWrongLengthAreRefused) {
  for (const char* wire :
       {"c0 00 01", "c1", "c2 00", "c3 00 01", "c5 00", "c6 00 01", "c7 00", "c9 00"})
    EXPECT_EQ(decode_event(hex(wire)).error(), DecodeError::too_short) << wire;
  for (const char* wire : {"c1 00 00", "c2 00 00 00", "c9 00 00 00", "c6 00 01 00 00 00"})
    EXPECT_EQ(decode_event(hex(wire)).error(), DecodeError::wrong_length) << wire;
}

}  // namespace
}  // namespace slamgw::ble
