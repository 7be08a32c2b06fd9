// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/retransmission.hpp"

#include <algorithm>

namespace slamgw::mqttsn {

namespace {

TimePoint end_of(const Attempt& attempt, const Settings& settings) {
  return attempt.begun + settings.retry_interval * (settings.retry_count + 1);
}

}  // namespace

Attempt begin_attempt(const Settings& settings, const Delivery& delivery, std::uint16_t msg_id,
                      TimePoint now) {
  Attempt attempt{msg_id, now, now, delivery.timeout.first(settings.retry_interval)};
  attempt.repeat_at = std::min(now + attempt.wait, end_of(attempt, settings));
  return attempt;
}

Due check_attempt(const Settings& settings, Attempt& attempt, TimePoint now) {
  if (!attempt.repeat_at || *attempt.repeat_at > now) return Due::nothing;
  if (end_of(attempt, settings) <= now) return Due::give_up;
  ++attempt.repeats;
  attempt.sent = now;
  attempt.wait =
      RetransmissionTimeout::next(attempt.wait, attempt.repeats, settings.retry_interval);
  attempt.repeat_at = std::min(now + attempt.wait, end_of(attempt, settings));
  return Due::repeat;
}

void on_answered(Delivery& delivery, const Attempt& attempt, TimePoint now) {
  if (attempt.begun == TimePoint::min()) return;  // it rested, or was restored: no time is known
  if (attempt.repeats == 0) {
    delivery.timeout.on_answer(now - attempt.begun);
  } else {
    delivery.timeout.on_ambiguous_answer(now - attempt.begun, now - attempt.sent);
  }
}

}  // namespace slamgw::mqttsn
