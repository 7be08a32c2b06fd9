// SPDX-License-Identifier: Apache-2.0
// Protects third parties from datagrams that an attacker requests in their name. An address is
// validated once it has answered something that only its owner can have read: a REGACK, PUBACK or
// PUBREC with an unforeseeable MsgId. Until then it is sent at most as many octets as came
// from it (RFC 9000 section 8 does so with a factor of 3). Octets are those of MQTT-SN messages,
// without UDP and IP headers. Pure.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <unordered_set>

#include "adapters/mqttsn_udp/protocol/endpoint.hpp"

namespace slamgw::mqttsn {

class AddressValidation {
 public:
  bool is_validated(const IpAddress& address) const { return validated_.contains(address); }
  /// The address has shown that it receives. At most `limits::max_validated_addresses` are known;
  /// the oldest one has to show it again.
  void validate(const IpAddress& address);

  void on_received(const IpAddress& address, std::size_t octets);
  /// Whether a message of so many octets may go to this address now.
  bool may_send(const IpAddress& address, std::size_t octets) const;
  /// Octets that may still be sent to an address that is not validated.
  std::uint32_t allowance(const IpAddress& address) const { return allowances_[place_of(address)]; }
  /// From before a restart; no more than what is there already.
  void restore_allowance(const IpAddress& address, std::uint32_t octets);
  void on_sent(const IpAddress& address, std::size_t octets);

 private:
  struct Hash {
    std::size_t operator()(const IpAddress& address) const;
  };

  /// Addresses share a fixed number of places by hash, so that a flood of addresses costs no
  /// memory. The sum over all addresses of one place keeps the bound too.
  static constexpr std::size_t places = 4096;
  static std::size_t place_of(const IpAddress& address) { return Hash{}(address) % places; }

  std::array<std::uint32_t, places> allowances_{};  // octets
  std::unordered_set<IpAddress, Hash> validated_;
  std::deque<IpAddress> oldest_first_;
};

}  // namespace slamgw::mqttsn
