// SPDX-License-Identifier: Apache-2.0
// Feeds octets as a sequence of inputs to the gateway's machine and checks its invariants after
// each. Used by the fuzzer, and by a short random run among the tests.
#pragma once

#include <set>
#include <string>
#include <vector>

#include "adapters/mqttsn_udp/sn_gateway.hpp"

namespace slamgw::mqttsn {

class FuzzLife {
 public:
  FuzzLife();

  /// An input: kind 1, argument 1, and for some a length 1 and that many octets. Returns false when
  /// an invariant is broken.
  bool run(ByteView script);

 private:
  void one_input(ByteReader& in);
  void datagram(std::uint8_t from, ByteView octets);
  void broker_message(std::uint8_t argument, ByteView payload);
  void link_or_roam(std::uint8_t argument);
  bool drain();
  bool is_sound(const SendDatagram& sent) const;
  bool holds() const;

  SnGateway gateway_;
  TimePoint now_{std::chrono::hours(1)};
  std::vector<std::uint64_t> owed_;
  std::vector<SubscribeRequest> asked_;
  std::map<std::string, Bytes> notes_;
  std::set<std::string> robots_;  // all that ever came or went
};

}  // namespace slamgw::mqttsn
