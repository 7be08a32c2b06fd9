// SPDX-License-Identifier: Apache-2.0
// Protects third parties from datagrams that an attacker requests in their name. An address is
// validated once it has answered something that only its owner can have read: a REGACK, PUBACK or
// PUBREC with an unforeseeable MsgId. Until then it is sent less than `factor` times the octets
// that came from it, IP and UDP headers included both ways, as in RFC 9000 section 8. So the
// smallest message, PINGREQ, pays for its answer and for one short REGISTER. Pure.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <string_view>
#include <unordered_set>

#include "adapters/mqttsn_udp/protocol/endpoint.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::mqttsn {

class AddressValidation {
 public:
  /// RFC 9000 section 8 allows as much, so that a handshake fits.
  static constexpr std::uint32_t factor = 3;
  /// IPv6 and UDP around each message; 28 with IPv4.
  static constexpr std::size_t max_header_octets = 48;

  bool is_validated(const IpAddress& address) const { return validated_.contains(address); }
  /// Call when the address has shown that it receives. At most `limits::max_validated_addresses`
  /// are kept; the oldest address then has to show it again.
  void validate(const IpAddress& address);
  /// Call for each REGACK, PUBACK and PUBREC. `is_right`: it fits a request that was sent to this
  /// address only. Validates the address then, unless it has given too many wrong answers.
  void on_answer(const IpAddress& address, bool is_right, TimePoint now);

  /// Here and below, `octets` count the message without IP and UDP headers.
  void on_received(const IpAddress& address, std::size_t octets);
  /// Whether a message of this size may go to this address now.
  bool may_send(const IpAddress& address, std::size_t octets) const;
  /// Octets, headers included, that may still be sent to an address that is not validated.
  std::uint32_t allowance(const IpAddress& address) const { return allowances_[place_of(address)]; }
  /// Restores the allowance from before a restart. A larger present allowance stays.
  void restore_allowance(const IpAddress& address, std::uint32_t octets);
  void on_sent(const IpAddress& address, std::size_t octets);

 private:
  struct Hash {
    std::size_t operator()(const IpAddress& address) const {
      return std::hash<std::string_view>{}(as_text(address));
    }
  };

  /// Addresses share a fixed number of places by hash, so that a flood of addresses costs no
  /// memory. The sum over all addresses of one place keeps the bound too.
  static constexpr std::size_t places = 4096;
  static std::size_t place_of(const IpAddress& address) { return Hash{}(address) % places; }

  std::array<std::uint32_t, places> allowances_{};  // octets
  std::array<std::uint8_t, places> wrong_answers_{};
  TimePoint wrong_since_{};  // all wrong answers are forgotten together
  std::unordered_set<IpAddress, Hash> validated_;
  std::deque<IpAddress> oldest_first_;
};

}  // namespace slamgw::mqttsn
