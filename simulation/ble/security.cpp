// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/security.hpp"

#include <openssl/bn.h>
#include <openssl/ec.h>
#include <openssl/evp.h>
#include <openssl/obj_mac.h>

#include <algorithm>
#include <memory>
#include <new>

namespace slamgw::sim::ble {
namespace {

constexpr std::size_t mic_octets = 8;
constexpr std::size_t point_octets = 1 + 64;  // uncompressed: 04 X Y
constexpr std::uint8_t uncompressed = 0x04;

template <auto free_function>
struct Free {
  template <typename T>
  void operator()(T* object) const {
    free_function(object);
  }
};
using Group = std::unique_ptr<EC_GROUP, Free<EC_GROUP_free>>;
using Point = std::unique_ptr<EC_POINT, Free<EC_POINT_free>>;
using Number = std::unique_ptr<BIGNUM, Free<BN_clear_free>>;
using Cipher = std::unique_ptr<EVP_CIPHER_CTX, Free<EVP_CIPHER_CTX_free>>;
using PointOctets = std::array<std::uint8_t, point_octets>;

Group p256() { return Group(EC_GROUP_new_by_curve_name(NID_X9_62_prime256v1)); }

Number number_of(const PrivateKey& key) {
  return Number(BN_bin2bn(key.data(), static_cast<int>(key.size()), nullptr));
}

std::optional<PointOctets> octets_of(const Group& group, const Point& point) {
  PointOctets out{};
  const std::size_t size = EC_POINT_point2oct(
      group.get(), point.get(), POINT_CONVERSION_UNCOMPRESSED, out.data(), out.size(), nullptr);
  if (size != out.size()) return std::nullopt;  // the point at infinity
  return out;
}

int length(ByteView bytes) { return static_cast<int>(bytes.size()); }

}  // namespace

KeyPair make_key_pair(Random& random) {
  KeyPair pair;
  for (std::uint8_t& octet : pair.private_key) octet = static_cast<std::uint8_t>(random.below(256));
  pair.private_key.front() &= 0x7f;  // stays below the order of the curve
  pair.private_key.back() |= 0x01;   // and is not 0
  pair.public_key = public_key_of(pair.private_key).value_or(PublicKey{});
  return pair;
}

std::optional<PublicKey> public_key_of(const PrivateKey& private_key) {
  const Group group = p256();
  const Number number = number_of(private_key);
  const Point point(EC_POINT_new(group.get()));
  if (!group || !number || !point) throw std::bad_alloc();
  if (EC_POINT_mul(group.get(), point.get(), number.get(), nullptr, nullptr, nullptr) != 1) {
    return std::nullopt;
  }
  const std::optional<PointOctets> octets = octets_of(group, point);
  if (!octets) return std::nullopt;
  PublicKey out{};
  std::copy_n(octets->begin() + 1, out.size(), out.begin());
  return out;
}

std::optional<Secret> shared_secret(const PrivateKey& own, const PublicKey& peer) {
  const Group group = p256();
  const Number number = number_of(own);
  const Point point(EC_POINT_new(group.get()));
  const Point product(EC_POINT_new(group.get()));
  if (!group || !number || !point || !product) throw std::bad_alloc();
  PointOctets octets{uncompressed};
  std::copy(peer.begin(), peer.end(), octets.begin() + 1);
  const bool is_shared =
      EC_POINT_oct2point(group.get(), point.get(), octets.data(), octets.size(), nullptr) == 1 &&
      EC_POINT_mul(group.get(), product.get(), nullptr, point.get(), number.get(), nullptr) == 1;
  if (!is_shared) return std::nullopt;
  const std::optional<PointOctets> result = octets_of(group, product);
  if (!result) return std::nullopt;
  Secret out{};
  std::copy_n(result->begin() + 1, out.size(), out.begin());
  return out;
}

Key aes_cmac(const Key& key, ByteView message) {
  Key out{};
  std::size_t size = 0;
  const unsigned char* done =
      EVP_Q_mac(nullptr, "CMAC", nullptr, "AES-128-CBC", nullptr, key.data(), key.size(),
                message.data(), message.size(), out.data(), out.size(), &size);
  if (done == nullptr || size != out.size()) throw std::bad_alloc();
  return out;
}

Key s1(ByteView message) { return aes_cmac(Key{}, message); }

Key k1(ByteView n, const Key& salt, ByteView p) { return aes_cmac(aes_cmac(salt, n), p); }

Key k1(ByteView n, const Key& salt, std::string_view p) {
  Bytes octets;
  put(octets, p);
  return k1(n, salt, octets);
}

Address virtual_address(const Key& label) {
  static constexpr std::array<std::uint8_t, 4> vtad{'v', 't', 'a', 'd'};
  const Key hash = aes_cmac(s1(vtad), label);
  return static_cast<Address>(0x8000 | (get_u16_be(hash, 14) & 0x3fff));
}

Bytes aes_ccm_encrypt(const Key& key, const Nonce& nonce, ByteView plain) {
  const Cipher cipher(EVP_CIPHER_CTX_new());
  Bytes out(plain.size() + mic_octets);
  int size = 0;
  const bool is_done =
      cipher && EVP_EncryptInit_ex(cipher.get(), EVP_aes_128_ccm(), nullptr, nullptr, nullptr) &&
      EVP_CIPHER_CTX_ctrl(cipher.get(), EVP_CTRL_AEAD_SET_IVLEN, length(nonce), nullptr) &&
      EVP_CIPHER_CTX_ctrl(cipher.get(), EVP_CTRL_AEAD_SET_TAG, mic_octets, nullptr) &&
      EVP_EncryptInit_ex(cipher.get(), nullptr, nullptr, key.data(), nonce.data()) &&
      EVP_EncryptUpdate(cipher.get(), out.data(), &size, plain.data(), length(plain)) &&
      EVP_CIPHER_CTX_ctrl(cipher.get(), EVP_CTRL_AEAD_GET_TAG, mic_octets,
                          out.data() + plain.size());
  if (!is_done) throw std::bad_alloc();
  return out;
}

std::optional<Bytes> aes_ccm_decrypt(const Key& key, const Nonce& nonce, ByteView sealed) {
  if (sealed.size() < mic_octets) return std::nullopt;
  const ByteView text = sealed.first(sealed.size() - mic_octets);
  Bytes mic(sealed.end() - mic_octets, sealed.end());
  const Cipher cipher(EVP_CIPHER_CTX_new());
  Bytes out(text.size());
  int size = 0;
  const bool is_authentic =
      cipher && EVP_DecryptInit_ex(cipher.get(), EVP_aes_128_ccm(), nullptr, nullptr, nullptr) &&
      EVP_CIPHER_CTX_ctrl(cipher.get(), EVP_CTRL_AEAD_SET_IVLEN, length(nonce), nullptr) &&
      EVP_CIPHER_CTX_ctrl(cipher.get(), EVP_CTRL_AEAD_SET_TAG, mic_octets, mic.data()) &&
      EVP_DecryptInit_ex(cipher.get(), nullptr, nullptr, key.data(), nonce.data()) &&
      EVP_DecryptUpdate(cipher.get(), out.data(), &size, text.data(), length(text)) > 0;
  if (!is_authentic) return std::nullopt;
  return out;
}

Key random_key(Random& random) {
  Key out{};
  for (std::uint8_t& octet : out) octet = static_cast<std::uint8_t>(random.below(256));
  return out;
}

}  // namespace slamgw::sim::ble
