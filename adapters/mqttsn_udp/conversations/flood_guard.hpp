// SPDX-License-Identifier: Apache-2.0
// How many answers strangers get: a small burst each, then a few a second, and a bound on all of
// them together (R21, R39). Sources share a fixed number of places by hash, so a flood of addresses
// costs no memory.
#pragma once

#include <array>
#include <cstddef>

#include "adapters/mqttsn_udp/clients/token_bucket.hpp"
#include "adapters/mqttsn_udp/protocol/endpoint.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::mqttsn {

class FloodGuard {
 public:
  bool may_answer(const Peer& peer, TimePoint now);

 private:
  static constexpr std::size_t places = 1024;
  std::array<TokenBucket, places> sources_;
  TokenBucket all_;
};

}  // namespace slamgw::mqttsn
