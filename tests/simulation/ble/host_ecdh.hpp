// SPDX-License-Identifier: Apache-2.0
// A host's own P-256, by another interface of OpenSSL than the simulator's, so that a mistake in
// either one shows.
#pragma once

#include <openssl/core_names.h>
#include <openssl/ec.h>
#include <openssl/evp.h>
#include <openssl/param_build.h>

#include <memory>
#include <stdexcept>

#include "simulation/bytes.hpp"

namespace slamgw::sim {

class HostKeyPair {
 public:
  HostKeyPair() : key_(EVP_EC_gen("P-256"), EVP_PKEY_free) {
    if (!key_) throw std::runtime_error("no key pair");
  }

  /// 32 octets.
  Bytes private_key() const {
    BIGNUM* number = nullptr;
    EVP_PKEY_get_bn_param(key_.get(), OSSL_PKEY_PARAM_PRIV_KEY, &number);
    Bytes out(32);
    BN_bn2binpad(number, out.data(), 32);
    BN_free(number);
    return out;
  }

  /// X || Y.
  Bytes public_key() const {
    Bytes out(65);
    std::size_t size = 0;
    EVP_PKEY_get_octet_string_param(key_.get(), OSSL_PKEY_PARAM_PUB_KEY, out.data(), out.size(),
                                    &size);
    out.erase(out.begin());
    return out;
  }

  /// With the other side's X || Y.
  Bytes shared_secret(ByteView peer) const {
    const std::unique_ptr<EVP_PKEY, decltype(&EVP_PKEY_free)> other(import(peer), EVP_PKEY_free);
    const std::unique_ptr<EVP_PKEY_CTX, decltype(&EVP_PKEY_CTX_free)> context(
        EVP_PKEY_CTX_new(key_.get(), nullptr), EVP_PKEY_CTX_free);
    Bytes out(32);
    std::size_t size = out.size();
    if (EVP_PKEY_derive_init(context.get()) != 1 ||
        EVP_PKEY_derive_set_peer(context.get(), other.get()) != 1 ||
        EVP_PKEY_derive(context.get(), out.data(), &size) != 1) {
      throw std::runtime_error("no shared secret");
    }
    return out;
  }

 private:
  static EVP_PKEY* import(ByteView peer) {
    Bytes point{0x04};
    put(point, peer);
    char group[] = "P-256";
    OSSL_PARAM params[] = {
        OSSL_PARAM_construct_utf8_string(OSSL_PKEY_PARAM_GROUP_NAME, group, 0),
        OSSL_PARAM_construct_octet_string(OSSL_PKEY_PARAM_PUB_KEY, point.data(), point.size()),
        OSSL_PARAM_construct_end()};
    EVP_PKEY_CTX* context = EVP_PKEY_CTX_new_from_name(nullptr, "EC", nullptr);
    EVP_PKEY* key = nullptr;
    EVP_PKEY_fromdata_init(context);
    EVP_PKEY_fromdata(context, &key, EVP_PKEY_PUBLIC_KEY, params);
    EVP_PKEY_CTX_free(context);
    return key;
  }

  std::unique_ptr<EVP_PKEY, decltype(&EVP_PKEY_free)> key_;
};

}  // namespace slamgw::sim
