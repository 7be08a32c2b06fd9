// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/retransmission_timeout.hpp"

#include <algorithm>

namespace slamgw::mqttsn {

Duration RetransmissionTimeout::first(Duration longest) const {
  return std::min(timeout_, longest);
}

Duration RetransmissionTimeout::next(Duration last, unsigned repeats, Duration longest) {
  constexpr unsigned even = 4;
  return std::min(repeats <= even ? last : last * 3 / 2, longest);
}

void RetransmissionTimeout::on_answer(Duration round_trip) {
  round_trip_.on_answer(round_trip);
  timeout_ = std::max(round_trip_.timeout(), shortest);
}

void RetransmissionTimeout::on_ambiguous_answer(Duration since_first, Duration since_last) {
  const bool answers_last_copy = round_trip_.is_known() && since_last <= round_trip_.timeout();
  if (!answers_last_copy) timeout_ = std::clamp(since_first * 3 / 2, timeout_, 2 * timeout_);
}

}  // namespace slamgw::mqttsn
