// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/provisioning_pdu.hpp"

#include <algorithm>

namespace slamgw::sim::ble {
namespace {

constexpr std::size_t data_octets = 16 + 2 + 1 + 4 + 2;

}  // namespace

Bytes encode(const ProvisioningData& data) {
  Bytes out(data.net_key.begin(), data.net_key.end());
  put_u16_be(out, data.net_key_index);
  put_u8(out, data.flags);
  put_u16_be(out, static_cast<std::uint16_t>(data.iv_index >> 16));
  put_u16_be(out, static_cast<std::uint16_t>(data.iv_index & 0xffff));
  put_u16_be(out, data.address);
  return out;
}

std::optional<ProvisioningData> decode_provisioning_data(ByteView octets) {
  if (octets.size() != data_octets) return std::nullopt;
  ProvisioningData data;
  std::copy_n(octets.begin(), data.net_key.size(), data.net_key.begin());
  data.net_key_index = get_u16_be(octets, 16);
  data.flags = octets[18];
  data.iv_index = static_cast<std::uint32_t>(get_u16_be(octets, 19)) << 16 | get_u16_be(octets, 21);
  data.address = get_u16_be(octets, 23);
  if (!is_unicast(data.address)) return std::nullopt;
  return data;
}

std::optional<std::size_t> pdu_size(std::uint8_t type) {
  static constexpr std::size_t sizes[] = {2, 12, 6, 65, 1, 17, 17, 1 + data_octets + 8, 1, 2};
  if (type >= std::size(sizes)) return std::nullopt;
  return sizes[type];
}

Bytes make_pdu(Pdu type, ByteView parameters) {
  Bytes out{static_cast<std::uint8_t>(type)};
  put(out, parameters);
  return out;
}

Authentication authentication(ByteView inputs, const Secret& secret) {
  const Key salt = s1(inputs);
  return {salt, k1(secret, salt, "prck")};
}

Key confirmation(const Authentication& with, const Key& random, const Key& auth_value) {
  Bytes message(random.begin(), random.end());
  put(message, auth_value);
  return aes_cmac(with.key, message);
}

SessionKeys session_keys(const Secret& secret, const Authentication& with,
                         const Key& provisioner_random, const Key& device_random) {
  Bytes inputs(with.salt.begin(), with.salt.end());
  put(inputs, provisioner_random);
  put(inputs, device_random);
  const Key salt = s1(inputs);
  SessionKeys keys;
  keys.session_key = k1(secret, salt, "prsk");
  const Key nonce = k1(secret, salt, "prsn");
  std::copy(nonce.end() - keys.nonce.size(), nonce.end(), keys.nonce.begin());
  keys.device_key = k1(secret, salt, "prdk");
  return keys;
}

}  // namespace slamgw::sim::ble
