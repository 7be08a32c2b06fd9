// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/robot/provisionee.hpp"

#include <algorithm>

namespace slamgw::sim::ble {
namespace {

Key key_from(ByteView parameters) {
  Key key{};
  std::copy_n(parameters.begin(), key.size(), key.begin());
  return key;
}

}  // namespace

std::optional<Bytes> Provisionee::on_pdu(ByteView pdu) {
  if (state_ == State::done) return std::nullopt;
  if (pdu.empty() || pdu_size(pdu[0]) != pdu.size()) {
    return fail(pdu.empty() || !pdu_size(pdu[0]) ? ProvisioningError::invalid_pdu
                                                 : ProvisioningError::invalid_format);
  }
  static constexpr Pdu expected[] = {Pdu::invite,       Pdu::start,  Pdu::public_key,
                                     Pdu::confirmation, Pdu::random, Pdu::data};
  const Pdu type = static_cast<Pdu>(pdu[0]);
  if (expected[static_cast<std::size_t>(state_)] != type) {
    return fail(ProvisioningError::unexpected_pdu);
  }
  return on_expected(type, pdu.subspan(1));
}

std::optional<Bytes> Provisionee::on_expected(Pdu type, ByteView parameters) {
  if (type == Pdu::invite) {
    state_ = State::start;
    const std::uint8_t static_types = identity_.static_oob ? 1 : 0;
    const Bytes capabilities{1, 0, 1, 0, static_types, 0, 0, 0, 0, 0, 0};  // 1 element, FIPS P-256
    put(inputs_, parameters);
    put(inputs_, capabilities);
    return make_pdu(Pdu::capabilities, capabilities);
  }
  if (type == Pdu::start) {
    Bytes failure = on_start(parameters);
    if (failure.empty()) return std::nullopt;
    return failure;
  }
  if (type == Pdu::public_key) return on_public_key(parameters);
  if (type == Pdu::confirmation) {
    state_ = State::random;
    peer_confirmation_ = key_from(parameters);
    return make_pdu(Pdu::confirmation, confirmation(authentication_, random_, auth_value()));
  }
  return type == Pdu::random ? on_random(parameters) : on_data(parameters);
}

/// Algorithm, public key, method, action and size: the first two must be 0 (table 5.28), action and
/// size are for kinds of OOB that robots lack. Nordic's device accepts the static method although
/// it has not offered it.
Bytes Provisionee::on_start(ByteView parameters) {
  const auto method = static_cast<OobMethod>(parameters[2]);
  const bool is_known = method == OobMethod::none || method == OobMethod::static_oob;
  const bool lacks_demanded_oob = identity_.static_oob && method != OobMethod::static_oob;
  const bool is_rest_zero =
      parameters[0] == 0 && parameters[1] == 0 && parameters[3] == 0 && parameters[4] == 0;
  if (!is_known || lacks_demanded_oob || !is_rest_zero) {
    return fail(ProvisioningError::invalid_format);
  }
  put(inputs_, parameters);
  state_ = State::public_key;
  return {};
}

Bytes Provisionee::on_public_key(ByteView parameters) {
  PublicKey peer{};
  std::copy_n(parameters.begin(), peer.size(), peer.begin());
  const std::optional<Secret> secret = shared_secret(identity_.key_pair.private_key, peer);
  if (!secret) return fail(ProvisioningError::invalid_format);
  secret_ = *secret;
  put(inputs_, peer);
  put(inputs_, identity_.key_pair.public_key);
  authentication_ = authentication(inputs_, secret_);
  state_ = State::confirmation;
  return make_pdu(Pdu::public_key, identity_.key_pair.public_key);
}

Bytes Provisionee::on_random(ByteView parameters) {
  const Key peer_random = key_from(parameters);
  if (confirmation(authentication_, peer_random, auth_value()) != peer_confirmation_) {
    return fail(ProvisioningError::confirmation_failed);
  }
  keys_ = session_keys(secret_, authentication_, peer_random, random_);
  state_ = State::data;
  return make_pdu(Pdu::random, random_);
}

Bytes Provisionee::on_data(ByteView parameters) {
  const std::optional<Bytes> plain = aes_ccm_decrypt(keys_.session_key, keys_.nonce, parameters);
  if (!plain) return fail(ProvisioningError::decryption_failed);
  const std::optional<ProvisioningData> data = decode_provisioning_data(*plain);
  if (!data) return fail(ProvisioningError::invalid_format);
  result_ = Result{*data, keys_.device_key};
  state_ = State::done;
  return make_pdu(Pdu::complete, {});
}

Bytes Provisionee::fail(ProvisioningError error) {
  state_ = State::done;
  return make_pdu(Pdu::failed, Bytes{static_cast<std::uint8_t>(error)});
}

}  // namespace slamgw::sim::ble
