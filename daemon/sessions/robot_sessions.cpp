// SPDX-License-Identifier: Apache-2.0
#include "daemon/sessions/robot_sessions.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace slamgw::sessions {

RobotSessions::RobotSessions(SessionNames names, ServedElsewhere is_served_elsewhere,
                             std::optional<TimePoint> last_alive, std::size_t max_sessions)
    : names_(std::move(names)),
      is_served_elsewhere_(std::move(is_served_elsewhere)),
      last_alive_(last_alive),
      max_sessions_(max_sessions) {}

// --- From the meshes -----------------------------------------------------------------------------

void RobotSessions::on_heard(const std::string& robot, const Now& now) {
  RobotSession* session = find_or_make(robot, now);
  if (!session || session->is_held()) return;
  session->on_heard(is_served_elsewhere_(robot), now);
  settle(robot, *session, now);
}

void RobotSessions::subscribe(const std::string& robot, const std::string& filter, Qos qos,
                              bool is_standing, const Now& now) {
  RobotSession* session = find_or_make(robot, now);
  if (!session) {
    if (!is_standing) actions_.push(FilterAnswered{robot, filter, false});
    return;
  }
  if (is_standing) {
    session->resume(filter, qos, now);
  } else {
    session->note_heard(is_served_elsewhere_(robot), now);
    session->subscribe(filter, qos, is_broker_up_ && !is_silent_, now);
  }
  settle(robot, *session, now);
}

void RobotSessions::unsubscribe(const std::string& robot, const std::string& filter) {
  if (RobotSession* session = find(robot)) session->unsubscribe(filter);
}

void RobotSessions::begin_clean(const std::string& robot, const Now& now) {
  RobotSession* session = find_or_make(robot, now);
  if (!session) return;
  session->note_heard(is_served_elsewhere_(robot), now);
  session->begin_clean(now);
  settle(robot, *session, now);
}

void RobotSessions::prove(const std::string& robot) {
  if (RobotSession* session = find(robot)) session->prove();
}

void RobotSessions::on_shown_elsewhere(const std::string& robot, const Now& now) {
  if (RobotSession* session = find(robot)) session->on_shown_elsewhere(now);
}

void RobotSessions::on_given_up(const std::string& robot) {
  RobotSession* session = find(robot);
  if (session && !session->is_held()) session->on_given_up();
}

void RobotSessions::read_note(const std::string& robot, const Now& now) {
  RobotSession* session = is_broker_up_ ? find_or_make(robot, now) : nullptr;
  if (!session) {
    actions_.push(NoteRead{robot, std::nullopt});
    return;
  }
  session->note_heard(is_served_elsewhere_(robot), now);
  session->read_note(now);
  settle(robot, *session, now);
}

void RobotSessions::settle(const std::string& robot, RobotSession& session, TimePoint now) {
  if (const auto next = session.deadline()) wake_at(robot, *next);
  if (is_broker_up_ && session.keeps_at()) wake_at(robot, *session.keeps_at());
  if (is_broker_up_ && !is_stopping_ && session.is_wanted()) {
    if (now < session.opens_at()) {
      wake_at(robot, session.opens_at());
    } else {
      session.set_queued();
      queue_.push_back(robot);
    }
  }
  open_next();
}

void RobotSessions::keep(const std::string& robot, std::optional<TimePoint> unheld_since,
                         Duration after, const Now& now) {
  const bool is_new = find(robot) == nullptr;
  RobotSession* session = find_or_make(robot, now);
  if (!session || session->is_held()) return;
  if (unheld_since && (is_new || session->unheld_since() < unheld_since))
    session->set_unheld_since(unheld_since);
  session->set_keeps_at(earlier(session->keeps_at(), now.mono + after));
  settle(robot, *session, now);
}

void RobotSessions::attach_kept(const Now& now) {
  for (auto& [robot, entry] : sessions_) {
    if (!entry.session->keeps_at()) continue;
    entry.session->set_keeps_at(now.mono);
    wake_at(robot, now.mono);
  }
}

void RobotSessions::forget(const std::string& robot) {
  const bool was_held = is_held(robot);
  if (const auto found = sessions_.find(robot); found != sessions_.end()) {
    found->second.session->close(/*is_forgotten=*/true);
    if (found->second.wake) wakes_.erase({*found->second.wake, robot});
    sessions_.erase(found);
  }
  // On MQTT 5 the DISCONNECT of a held session has ended the session, too.
  const bool is_over = was_held ? is_v5_ : is_served_elsewhere_(robot);
  if (!is_over && forgetting_.size() < max_forgetting && forgetting_.emplace(robot, false).second)
    queue_.push_back(robot);
  open_next();
}

// --- Opening -------------------------------------------------------------------------------------

void RobotSessions::open_next() {
  while (is_broker_up_ && counts_.opening < max_opening && !queue_.empty()) {
    const std::string robot = std::move(queue_.front());
    queue_.pop_front();
    if (const auto found = forgetting_.find(robot); found != forgetting_.end()) {
      if (std::exchange(found->second, true)) continue;
      ++counts_.opening;
      actions_.push(OpenSession{robot, /*is_clean=*/true});
      continue;
    }
    RobotSession* session = find(robot);
    if (!session || session->state() != RobotSession::State::queued) continue;
    if (is_served_elsewhere_(robot)) session->set_unheld_since({});
    session->open();
  }
}

/// Ends the attempt, even if it has failed: the broker also ends a session that is unused for a
/// day.
void RobotSessions::end_forgetting(const std::string& robot) {
  const auto ended = forgetting_.extract(robot);
  if (!ended.empty() && ended.mapped()) --counts_.opening;
  open_next();
}

void RobotSessions::wake_at(const std::string& robot, TimePoint when) {
  const auto found = sessions_.find(robot);
  if (found == sessions_.end() || (found->second.wake && *found->second.wake <= when)) return;
  if (found->second.wake) wakes_.erase({*found->second.wake, robot});
  found->second.wake = when;
  wakes_.emplace(when, robot);
}

// --- From the shell ------------------------------------------------------------------------------

void RobotSessions::on_broker_up(bool is_v5, bool is_other, const Now& now) {
  if (is_other) {
    last_alive_.reset();
    for (auto& [robot, entry] : sessions_) entry.session->on_other_broker(now.mono);
  }
  is_broker_up_ = true;
  is_v5_ = is_v5;
  for (auto& [robot, entry] : sessions_) {
    if (const auto kept = entry.session->keeps_at())
      entry.session->set_keeps_at(std::max(*kept, now.mono + unheard_delay));
    settle(robot, *entry.session, now);
  }
  for (const auto& [robot, is_under_way] : forgetting_) queue_.push_back(robot);
  open_next();
}

/// Detaches all sessions. Those that were held are attached again when the broker is back, unless
/// another gateway has heard their robots first.
void RobotSessions::on_broker_down(const Now& now) {
  is_broker_up_ = is_silent_ = false;
  queue_.clear();
  for (auto& [robot, entry] : sessions_) {
    RobotSession& session = *entry.session;
    const bool is_forgiven = session.forgive_loss(now.mono);
    if (session.is_held() || is_forgiven) session.set_keeps_at(now.mono);
    if (session.is_connected()) actions_.push(CloseSession{robot, false});
    session.on_detached(LossReason::broker_gone, lost_since(now.mono), now);
    if (is_forgiven) actions_.push(SessionLost{robot, LossReason::broker_gone});
    session.grant_waiting();
    session.end_note({});
  }
  for (auto& [robot, is_under_way] : forgetting_) {
    if (!std::exchange(is_under_way, false)) continue;
    --counts_.opening;
    actions_.push(CloseSession{robot, false});
  }
}

void RobotSessions::on_silence(bool is_silent) {
  is_silent_ = is_silent;
  if (!is_silent) return;
  for (auto& [robot, entry] : sessions_) entry.session->grant_waiting();
}

void RobotSessions::on_attached(const std::string& robot, bool is_present, const Now& now) {
  if (forgetting_.contains(robot)) {
    actions_.push(CloseSession{robot, true});
    return end_forgetting(robot);
  }
  RobotSession* session = find(robot);
  if (!session || session->state() != RobotSession::State::opening) return;
  // On MQTT 3.1.1, only another CONNECT could end it.
  const bool is_unused = is_v5_ && !is_present && session->is_unused();
  session->on_attached(is_present, is_v5_, now);
  if (is_unused) return forget(robot);
  settle(robot, *session, now);
}

void RobotSessions::on_attach_failed(const std::string& robot, const Now& now, bool is_refused) {
  if (forgetting_.contains(robot)) return end_forgetting(robot);
  RobotSession* session = find(robot);
  if (!session || !session->is_opening()) return;
  session->on_attach_failed(is_served_elsewhere_(robot), now);
  if (is_refused) session->on_refused();
  settle(robot, *session, now);
}

void RobotSessions::on_detached(const std::string& robot, const Now& now, LossReason why) {
  RobotSession* session = find(robot);
  if (!session) return;
  if (session->is_opening()) return on_attach_failed(robot, now);
  if (!session->is_held()) return;
  session->on_detached(why, lost_since(now.mono), now);
  settle(robot, *session, now);
}

void RobotSessions::on_subscribed(const std::string& robot, const std::string& filter,
                                  bool is_granted, const Now& now) {
  RobotSession* session = find(robot);
  if (!session) return;
  const bool was_refused = !session->refused_filters().empty();
  session->on_subscribed(filter, is_granted, now);
  if (!is_granted && session->refused_filters().contains(filter))
    report_refusal(robot, filter, now);
  if (is_granted && was_refused && session->refused_filters().empty()) report_grant(robot);
  settle(robot, *session, now);
}

/// The shell reports a mailbox that is refused.
void RobotSessions::report_refusal(const std::string& robot, const std::string& filter,
                                   TimePoint now) {
  if (filter == names_.mailbox_topic(robot)) return;
  if (const auto count = refusal_throttle_.on_event(now))
    actions_.push(Notice{
        Severity::warning,
        fmt::format("{}: the broker refuses the subscription to {}, so its messages may not reach "
                    "the robot; the broker's access control list may lack it, it may exceed the "
                    "broker's largest packet, or the broker's log says why (count since the last "
                    "line: {})",
                    robot, filter, *count),
        robot});
}

void RobotSessions::report_grant(const std::string& robot) {
  if (std::ranges::any_of(sessions_, [](const auto& each) {
        const RobotSession& session = *each.second.session;
        return session.is_held() && !session.refused_filters().empty();
      }))
    return;
  refusal_throttle_ = LogThrottle(refusal_interval);
  actions_.push(
      Notice{Severity::notice,
             fmt::format("{}: the broker grants all subscriptions of robots again", robot), robot});
}

void RobotSessions::on_message(const std::string& robot, BrokerMessage message,
                               std::span<const std::uint32_t> ids, const Now& now) {
  if (RobotSession* session = find(robot)) session->on_message(std::move(message), ids, now);
}

void RobotSessions::on_fence(const std::string& robot, std::uint64_t number, const Now& now) {
  if (RobotSession* session = find(robot)) session->on_fence(number, now);
}

bool RobotSessions::on_stop() {
  is_stopping_ = true;
  queue_.clear();
  bool are_closed = true;
  for (auto& [robot, entry] : sessions_) {
    if (entry.session->has_unfenced())
      are_closed = false;
    else
      entry.session->leave();
  }
  return are_closed;
}

// --- Time ----------------------------------------------------------------------------------------

void RobotSessions::on_tick(TimePoint now) {
  if (has_stood_still(now)) {
    stood_still_since_ = *last_tick_;
    goes_on_at_ = now;
  }
  last_tick_ = now;
}

bool RobotSessions::has_stood_still(TimePoint now) const {
  return last_tick_ && now - *last_tick_ > longest_pause;
}

/// A process that stood still notices the loss only when it goes on.
TimePoint RobotSessions::lost_since(TimePoint now) const {
  if (has_stood_still(now)) return *last_tick_;
  return now < goes_on_at_ + catching_up ? stood_still_since_ : now;
}

std::optional<TimePoint> RobotSessions::deadline() const {
  if (wakes_.empty()) return std::nullopt;
  return wakes_.begin()->first;
}

void RobotSessions::on_deadline(const Now& now) {
  while (!wakes_.empty() && wakes_.begin()->first <= now.mono) {
    const std::string robot = wakes_.begin()->second;
    wakes_.erase(wakes_.begin());
    Entry& entry = sessions_.at(robot);
    RobotSession& session = *entry.session;
    entry.wake.reset();
    session.on_deadline(now);
    if (is_broker_up_ && session.keeps_at() && *session.keeps_at() <= now.mono) {
      session.set_keeps_at({});
      if (!is_served_elsewhere_(robot))
        session.keep(now.mono);
      else if (!session.is_held())
        actions_.push(SessionLost{robot, LossReason::taken});
    }
    settle(robot, session, now);
  }
}

// --- Questions -----------------------------------------------------------------------------------

RobotSession* RobotSessions::find(const std::string& robot) const {
  const auto found = sessions_.find(robot);
  return found == sessions_.end() ? nullptr : found->second.session.get();
}

RobotSession* RobotSessions::find_or_make(const std::string& robot, TimePoint now) {
  if (RobotSession* session = find(robot)) return session;
  if (sessions_.size() >= max_sessions_) {
    if (const auto count = full_throttle_.on_event(now))
      actions_.push(
          Notice{Severity::warning,
                 fmt::format("{} has no session at the broker: {} robots have one "
                             "already; forget some of them (count since the last line: {})",
                             robot, max_sessions_, *count),
                 robot});
    return nullptr;
  }
  const TimePoint unheld_since = last_alive_.value_or(now - 2 * RobotSession::stale_after);
  auto session = std::make_unique<RobotSession>(robot, names_, actions_, counts_, unheld_since);
  if (const auto found = forgetting_.find(robot); found != forgetting_.end()) {
    if (found->second) actions_.push(CloseSession{robot, false});
    session->begin_clean(now);
    end_forgetting(robot);
  }
  return sessions_.emplace(robot, Entry{std::move(session)}).first->second.session.get();
}

bool RobotSessions::is_held(const std::string& robot) const {
  const RobotSession* session = find(robot);
  return session && session->is_held();
}

bool RobotSessions::was_just_taken(const std::string& robot, TimePoint now) const {
  const RobotSession* session = find(robot);
  return session && session->lost_at() && now - *session->lost_at() < showing;
}

bool RobotSessions::is_contested(const std::string& robot) const {
  const RobotSession* session = find(robot);
  return session && session->is_contested();
}

bool RobotSessions::is_refused(const std::string& robot) const {
  const RobotSession* session = find(robot);
  return session && session->is_refused();
}

std::optional<std::string> RobotSessions::refused_filter(const std::string& robot) const {
  const RobotSession* session = find(robot);
  if (!session || !session->is_held() || session->refused_filters().empty()) return std::nullopt;
  return *session->refused_filters().begin();
}

bool RobotSessions::may_want(const std::string& robot, const std::string& topic) const {
  const RobotSession* session = find(robot);
  return !session || !session->is_held() || session->may_want(topic);
}

Counters RobotSessions::counters() const {
  return {{"sessions", counts_.held},
          {"sessions_attached", counts_.attached},
          {"sessions_lost", counts_.lost},
          {"commands_fenced_off", counts_.fenced_off},
          {"session_messages_dropped", counts_.dropped}};
}

}  // namespace slamgw::sessions
