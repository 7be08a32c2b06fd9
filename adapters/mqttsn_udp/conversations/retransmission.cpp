// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/retransmission.hpp"

#include <algorithm>

#include "adapters/mqttsn_udp/limits.hpp"

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

void Release::begin(ClientSession& session, std::uint16_t msg_id, TimePoint now) {
  Delivery& delivery = session.delivery;
  if (delivery.releasing.size() >= limits::max_open_releases)
    delivery.releasing.erase(delivery.releasing.begin());
  delivery.releasing.push_back(begin_attempt(settings_, delivery, msg_id, now));
  output_.mark_unsaved(session);
  output_.send(session, Pubrel{msg_id});
}

bool Release::on_pubrec(ClientSession& session, std::uint16_t msg_id) {
  const auto open = std::ranges::find(session.delivery.releasing, msg_id, &Attempt::msg_id);
  if (open == session.delivery.releasing.end()) return false;
  open->repeats = std::max(open->repeats, 1U);
  output_.send(session, Pubrel{msg_id});
  return true;
}

bool Release::on_pubcomp(Delivery& delivery, std::uint16_t msg_id, TimePoint now) {
  const auto open = std::ranges::find(delivery.releasing, msg_id, &Attempt::msg_id);
  if (open == delivery.releasing.end()) return false;
  on_answered(delivery, *open, now);
  delivery.releasing.erase(open);
  return true;
}

bool Release::is_fresh(const Delivery& delivery) {
  return std::ranges::any_of(delivery.releasing,
                             [](const Attempt& open) { return open.repeat_at && open.is_fresh(); });
}

void Release::rest(Delivery& delivery) {
  for (Attempt& open : delivery.releasing) {
    open.repeat_at.reset();
    open.begun = TimePoint::min();
  }
}

void Release::resume(ClientSession& session, TimePoint now) {
  Delivery& delivery = session.delivery;
  for (Attempt& open : delivery.releasing) {
    if (open.repeat_at || session.last_heard <= open.begun) continue;
    open = begin_attempt(settings_, delivery, open.msg_id, now);
    output_.send(session, Pubrel{open.msg_id});
  }
}

/// A PUBREL that is given up rests if the client sent nothing at all. Otherwise it is forgotten,
/// and only a PUBREC brings it back (R92).
bool Release::on_time(ClientSession& session, TimePoint now) {
  bool is_silent = false;
  const auto is_over = [&](Attempt& open) {
    switch (check_attempt(settings_, open, now)) {
      case Due::nothing: return false;
      case Due::repeat:
        output_.count(Count::retransmitted);
        output_.send(session, Pubrel{open.msg_id});
        return false;
      case Due::give_up: break;
    }
    open.repeat_at.reset();
    const bool was_heard = session.last_heard > open.begun;
    is_silent |= !was_heard;
    return was_heard;
  };
  if (std::erase_if(session.delivery.releasing, is_over) > 0) output_.mark_unsaved(session);
  return is_silent;
}

std::optional<TimePoint> Release::next_time(const Delivery& delivery) {
  std::optional<TimePoint> next;
  for (const Attempt& open : delivery.releasing) next = earlier(next, open.repeat_at);
  return next;
}

}  // namespace slamgw::mqttsn
