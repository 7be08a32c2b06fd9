// SPDX-License-Identifier: Apache-2.0
#include "daemon/sessions/robot_sessions.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace slamgw::sessions {

RobotSessions::RobotSessions(SessionNames names, ServedElsewhere is_served_elsewhere,
                             std::size_t max_sessions)
    : names_(std::move(names)),
      is_served_elsewhere_(std::move(is_served_elsewhere)),
      max_sessions_(max_sessions) {}

// --- From the meshes -----------------------------------------------------------------------------

void RobotSessions::on_heard(const std::string& robot, const Now& now) {
  RobotSession* session = find_or_make(robot, now);
  if (!session) return;
  if (!kept_.empty()) kept_.erase(robot);
  session->on_heard(now);
  want(robot, *session, now);
}

void RobotSessions::hear_commands(const std::string& robot, bool wants_retained) {
  if (RobotSession* session = find(robot)) session->hear_commands(wants_retained);
}

void RobotSessions::subscribe(const std::string& robot, const std::string& filter, Qos qos,
                              bool is_standing, const Now& now) {
  if (RobotSession* session = find_or_make(robot, now))
    session->subscribe(filter, qos, is_standing);
  else
    actions_.push(FilterAnswered{robot, filter, false});
}

void RobotSessions::unsubscribe(const std::string& robot, const std::string& filter) {
  if (RobotSession* session = find(robot)) session->unsubscribe(filter);
}

void RobotSessions::begin_clean(const std::string& robot) {
  if (RobotSession* session = find(robot)) session->begin_clean();
}

void RobotSessions::keep(const std::string& robot, std::optional<TimePoint> unheld_since,
                         Duration after, const Now& now) {
  if (!find_or_make(robot, now)) return;
  kept_[robot] = {unheld_since};
  wake_at(robot, now.mono + after);
}

void RobotSessions::forget(const std::string& robot) {
  const auto found = sessions_.find(robot);
  if (found == sessions_.end()) return;
  RobotSession& session = *found->second.session;
  held_ -= session.is_held() ? 1 : 0;
  opening_ -= session.state() == RobotSession::State::opening ? 1 : 0;
  session.close(/*is_forgotten=*/true);
  kept_.erase(robot);
  sessions_.erase(found);
  open_next();
}

// --- Opening -------------------------------------------------------------------------------------

void RobotSessions::want(const std::string& robot, RobotSession& session, TimePoint now) {
  if (!is_broker_up_ || is_stopping_ || !session.is_wanted()) return;
  if (now < session.opens_at()) return wake_at(robot, session.opens_at());
  session.set_queued();
  queue_.push_back(robot);
  open_next();
}

void RobotSessions::open_next() {
  while (is_broker_up_ && opening_ < max_opening && !queue_.empty()) {
    RobotSession* session = find(queue_.front());
    queue_.pop_front();
    if (!session || session->state() != RobotSession::State::queued) continue;
    ++opening_;
    session->open();
  }
}

void RobotSessions::after_opening() {
  --opening_;
  open_next();
}

void RobotSessions::wake_at(const std::string& robot, TimePoint when) {
  const auto found = sessions_.find(robot);
  if (found == sessions_.end() || (found->second.wake && *found->second.wake <= when)) return;
  if (found->second.wake) {
    const auto [first, last] = wakes_.equal_range(*found->second.wake);
    wakes_.erase(std::find_if(first, last, [&](const auto& each) { return each.second == robot; }));
  }
  found->second.wake = when;
  wakes_.emplace(when, robot);
}

// --- From the shell ------------------------------------------------------------------------------

void RobotSessions::on_broker_up(bool is_v5, bool is_other, const Now& now) {
  if (is_other) on_broker_down(now);
  is_broker_up_ = true;
  is_v5_ = is_v5;
  for (auto& [robot, entry] : sessions_) {
    if (kept_.contains(robot))
      wake_at(robot, now.mono + unheard_delay);
    else
      want(robot, *entry.session, now);
  }
}

/// Sessions that were held are answered for again when the broker is back, unless another gateway
/// has heard their robots by then.
void RobotSessions::on_broker_down(const Now& now) {
  is_broker_up_ = false;
  queue_.clear();
  opening_ = 0;
  for (auto& [robot, entry] : sessions_) {
    RobotSession& session = *entry.session;
    const bool was_held = session.is_held();
    if (session.state() == RobotSession::State::detached) continue;
    if (session.state() != RobotSession::State::queued) actions_.push(CloseSession{robot, false});
    session.on_detached(/*is_broker_gone=*/true, now);
    if (was_held) kept_[robot] = {now.mono};
  }
  lost_ += std::exchange(held_, 0);
}

void RobotSessions::on_attached(const std::string& robot, bool is_present, const Now& now) {
  RobotSession* session = find(robot);
  if (!session || session->state() != RobotSession::State::opening) return;
  ++held_;
  ++attached_;
  session->on_attached(is_present, is_v5_, now);
  if (const auto until = session->deadline()) wake_at(robot, *until);
  after_opening();
}

void RobotSessions::on_attach_failed(const std::string& robot, const Now& now) {
  RobotSession* session = find(robot);
  if (!session || session->state() != RobotSession::State::opening) return;
  session->on_attach_failed(now);
  want(robot, *session, now);
  after_opening();
}

void RobotSessions::on_detached(const std::string& robot, const Now& now) {
  RobotSession* session = find(robot);
  if (!session) return;
  if (session->state() == RobotSession::State::opening) return on_attach_failed(robot, now);
  if (!session->is_held()) return;
  --held_;
  ++lost_;
  session->on_detached(/*is_broker_gone=*/false, now);
}

void RobotSessions::on_subscribed(const std::string& robot, const std::string& filter,
                                  bool is_granted) {
  if (RobotSession* session = find(robot)) session->on_subscribed(filter, is_granted);
}

void RobotSessions::on_message(const std::string& robot, BrokerMessage message,
                               std::span<const std::uint32_t> ids, const Now& now) {
  if (RobotSession* session = find(robot)) session->on_message(std::move(message), ids, now);
}

void RobotSessions::on_fence(const std::string& robot, std::uint64_t number, const Now& now) {
  if (RobotSession* session = find(robot)) session->on_fence(number, now);
}

void RobotSessions::on_stop() {
  is_stopping_ = true;
  queue_.clear();
  for (auto& [robot, entry] : sessions_) entry.session->close(/*is_forgotten=*/false);
  held_ = 0;
  opening_ = 0;
}

// --- Time ----------------------------------------------------------------------------------------

std::optional<TimePoint> RobotSessions::deadline() const {
  if (wakes_.empty()) return std::nullopt;
  return wakes_.begin()->first;
}

void RobotSessions::on_deadline(const Now& now) {
  while (!wakes_.empty() && wakes_.begin()->first <= now.mono) {
    const std::string robot = std::move(wakes_.begin()->second);
    wakes_.erase(wakes_.begin());
    const auto found = sessions_.find(robot);
    if (found == sessions_.end()) continue;
    found->second.wake.reset();
    RobotSession* session = found->second.session.get();
    session->on_deadline(now);
    if (const auto kept = kept_.find(robot); kept != kept_.end() && is_broker_up_) {
      if (!is_served_elsewhere_(robot)) session->keep(kept->second.unheld_since);
      kept_.erase(kept);
    }
    want(robot, *session, now);
  }
}

// --- Questions -----------------------------------------------------------------------------------

RobotSession* RobotSessions::find(const std::string& robot) {
  const auto found = sessions_.find(robot);
  return found == sessions_.end() ? nullptr : found->second.session.get();
}

const RobotSession* RobotSessions::find(const std::string& robot) const {
  const auto found = sessions_.find(robot);
  return found == sessions_.end() ? nullptr : found->second.session.get();
}

RobotSession* RobotSessions::find_or_make(const std::string& robot, TimePoint now) {
  if (RobotSession* session = find(robot)) return session;
  if (sessions_.size() >= max_sessions_) {
    if (const auto count = full_throttle_.on_event(now))
      actions_.push(Notice{Severity::warning,
                           fmt::format("{} has no session at the broker: {} robots have one "
                                       "already; forget some of them ({} like it)",
                                       robot, max_sessions_, *count),
                           robot});
    return nullptr;
  }
  auto session = std::make_unique<RobotSession>(robot, names_, actions_, counts_);
  return sessions_.emplace(robot, Entry{std::move(session)}).first->second.session.get();
}

bool RobotSessions::is_held(const std::string& robot) const {
  const RobotSession* session = find(robot);
  return session && session->is_held();
}

bool RobotSessions::is_contested(const std::string& robot) const {
  const RobotSession* session = find(robot);
  return session && session->is_contested();
}

Counters RobotSessions::counters() const {
  return {{"sessions", held_},
          {"sessions_attached", attached_},
          {"sessions_lost", lost_},
          {"commands_fenced_off", counts_.fenced_off},
          {"session_messages_dropped", counts_.dropped}};
}

}  // namespace slamgw::sessions
