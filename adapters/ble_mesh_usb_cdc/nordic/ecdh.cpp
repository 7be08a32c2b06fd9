// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic/ecdh.hpp"

#include <openssl/bn.h>
#include <openssl/ec.h>
#include <openssl/obj_mac.h>

#include <memory>

namespace slamgw::ble {
namespace {

template <auto free>
struct Free {
  template <class T>
  void operator()(T* pointer) const {
    free(pointer);
  }
};
using Number = std::unique_ptr<BIGNUM, Free<BN_clear_free>>;
using Group = std::unique_ptr<EC_GROUP, Free<EC_GROUP_free>>;
using Point = std::unique_ptr<EC_POINT, Free<EC_POINT_clear_free>>;

constexpr std::size_t coordinate_bytes = 32;
/// A random number is out of range once in 2^32 times.
constexpr int max_draws = 8;

Group p256() { return Group(EC_GROUP_new_by_curve_name(NID_X9_62_prime256v1)); }

Number number_of(ByteView octets) {
  return Number(BN_bin2bn(octets.data(), static_cast<int>(octets.size()), nullptr));
}

bool write_number(const BIGNUM* number, std::span<std::uint8_t> octets) {
  return BN_bn2binpad(number, octets.data(), static_cast<int>(octets.size())) ==
         static_cast<int>(octets.size());
}

}  // namespace

std::optional<KeyPair> make_key_pair(const RandomSource& random) {
  std::array<std::uint8_t, coordinate_bytes> scalar{};
  for (int draw = 0; draw < max_draws && random(scalar); ++draw)
    if (auto pair = key_pair_of(scalar)) return pair;
  return std::nullopt;
}

std::optional<KeyPair> key_pair_of(const std::array<std::uint8_t, 32>& private_key) {
  const Group group = p256();
  const Number scalar = number_of(private_key);
  if (!group || !scalar || BN_is_zero(scalar.get()) ||
      BN_cmp(scalar.get(), EC_GROUP_get0_order(group.get())) >= 0)
    return std::nullopt;
  const Point point(EC_POINT_new(group.get()));
  const Number x(BN_new());
  const Number y(BN_new());
  KeyPair pair{private_key, {}};
  const std::span<std::uint8_t> octets(pair.public_key);
  const bool is_made =
      point && x && y &&
      EC_POINT_mul(group.get(), point.get(), scalar.get(), nullptr, nullptr, nullptr) == 1 &&
      EC_POINT_get_affine_coordinates(group.get(), point.get(), x.get(), y.get(), nullptr) == 1 &&
      write_number(x.get(), octets.first(coordinate_bytes)) &&
      write_number(y.get(), octets.last(coordinate_bytes));
  return is_made ? std::optional(pair) : std::nullopt;
}

std::optional<SharedSecret> shared_secret(const KeyPair& own, const PublicKey& peer) {
  const Group group = p256();
  const Number scalar = number_of(own.private_key);
  const ByteView octets(peer);
  const Number peer_x = number_of(octets.first(coordinate_bytes));
  const Number peer_y = number_of(octets.last(coordinate_bytes));
  const Point peer_point(group ? EC_POINT_new(group.get()) : nullptr);
  const Point common(group ? EC_POINT_new(group.get()) : nullptr);
  const Number x(BN_new());
  if (!scalar || !peer_x || !peer_y || !peer_point || !common || !x) return std::nullopt;
  SharedSecret secret;
  // Setting the coordinates fails for a point that is not on the curve.
  const bool is_made =
      EC_POINT_set_affine_coordinates(group.get(), peer_point.get(), peer_x.get(), peer_y.get(),
                                      nullptr) == 1 &&
      EC_POINT_mul(group.get(), common.get(), nullptr, peer_point.get(), scalar.get(), nullptr) ==
          1 &&
      EC_POINT_get_affine_coordinates(group.get(), common.get(), x.get(), nullptr, nullptr) == 1 &&
      write_number(x.get(), secret);
  return is_made ? std::optional(secret) : std::nullopt;
}

}  // namespace slamgw::ble
