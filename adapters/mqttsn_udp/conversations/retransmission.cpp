// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/retransmission.hpp"

#include <algorithm>

namespace slamgw::mqttsn {

Attempt Retransmission::begin(const Delivery& delivery, std::uint16_t msg_id, TimePoint now) const {
  Attempt attempt{msg_id, now, now, delivery.timeout.first(settings_.retry_interval)};
  attempt.repeat_at = std::min(now + attempt.wait, end_of(attempt));
  return attempt;
}

Retransmission::Due Retransmission::on_time(Attempt& attempt, TimePoint now) const {
  if (!attempt.repeat_at || *attempt.repeat_at > now) return Due::nothing;
  if (end_of(attempt) <= now) return Due::give_up;
  ++attempt.repeats;
  attempt.sent = now;
  attempt.wait =
      RetransmissionTimeout::next(attempt.wait, attempt.repeats, settings_.retry_interval);
  attempt.repeat_at = std::min(now + attempt.wait, end_of(attempt));
  return Due::repeat;
}

void Retransmission::on_answer(Delivery& delivery, const Attempt& attempt, TimePoint now) {
  if (attempt.begun == TimePoint::min()) return;  // it rested, or was restored: no time is known
  if (attempt.repeats == 0) {
    delivery.timeout.on_answer(now - attempt.begun);
  } else {
    delivery.timeout.on_ambiguous_answer(now - attempt.begun, now - attempt.sent);
  }
}

TimePoint Retransmission::end_of(const Attempt& attempt) const {
  return attempt.begun + settings_.retry_interval * (settings_.retry_count + 1);
}

}  // namespace slamgw::mqttsn
