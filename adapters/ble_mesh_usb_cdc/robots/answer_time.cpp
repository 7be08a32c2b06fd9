// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/robots/answer_time.hpp"

#include <algorithm>
#include <chrono>

namespace slamgw::ble {

Duration AnswerTime::timeout(Duration longest) const {
  return timeout_ == Duration::zero() ? longest : std::min(timeout_, longest);
}

void AnswerTime::on_answer(Duration round_trip) {
  round_trip_.on_answer(round_trip);
  timeout_ = std::max(shortest_timeout, round_trip_.timeout());
}

void AnswerTime::on_repeated() { timeout_ = std::min(2 * timeout_, longest_timeout); }

}  // namespace slamgw::ble
