// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/address_validation.hpp"

#include <algorithm>
#include <limits>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

namespace {

/// Returns the octets that a message costs its receiver's network, headers included.
std::size_t with_headers(const IpAddress& address, std::size_t octets) {
  constexpr std::size_t ipv4_header_octets = 28;
  return octets + (is_ipv4(address) ? ipv4_header_octets : AddressValidation::max_header_octets);
}

}  // namespace

void AddressValidation::validate(const IpAddress& address) {
  if (!validated_.insert(address).second) return;
  oldest_first_.push_back(address);
  if (oldest_first_.size() <= limits::max_validated_addresses) return;
  validated_.erase(oldest_first_.front());
  oldest_first_.pop_front();
}

void AddressValidation::on_answer(const IpAddress& address, bool is_right, TimePoint now) {
  if (is_validated(address)) return;
  if (now - wrong_since_ >= limits::wrong_answer_memory) {
    wrong_answers_.fill(0);
    wrong_since_ = now;
  }
  std::uint8_t& wrong = wrong_answers_[place_of(address)];
  if (wrong >= limits::max_wrong_answers) return;
  if (is_right) return validate(address);
  ++wrong;
}

void AddressValidation::on_received(const IpAddress& address, std::size_t octets) {
  if (is_validated(address)) return;
  std::uint32_t& allowance = allowances_[place_of(address)];
  const std::size_t room = std::numeric_limits<std::uint32_t>::max() - allowance;
  allowance += static_cast<std::uint32_t>(std::min(factor * with_headers(address, octets), room));
}

bool AddressValidation::may_send(const IpAddress& address, std::size_t octets) const {
  return is_validated(address) || with_headers(address, octets) < allowances_[place_of(address)];
}

void AddressValidation::restore_allowance(const IpAddress& address, std::uint32_t octets) {
  std::uint32_t& allowance = allowances_[place_of(address)];
  allowance = std::max(allowance, octets);
}

void AddressValidation::on_sent(const IpAddress& address, std::size_t octets) {
  if (is_validated(address)) return;
  std::uint32_t& allowance = allowances_[place_of(address)];
  allowance -=
      static_cast<std::uint32_t>(std::min<std::size_t>(with_headers(address, octets), allowance));
}

}  // namespace slamgw::mqttsn
