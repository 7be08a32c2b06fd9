// SPDX-License-Identifier: Apache-2.0
#include "daemon/sessions/robot_session.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace slamgw::sessions {

// --- Who holds it --------------------------------------------------------------------------------

void RobotSession::on_heard(TimePoint now) {
  if (state_ == State::attached) {
    if (now - held_since_ >= longest_flap_wait) quick_losses_ = 0;
    return;
  }
  is_wanted_ = true;
  was_heard_after_loss_ = was_heard_after_loss_ || quick_losses_ > 0;
}

void RobotSession::keep(std::optional<TimePoint> unheld_since) {
  if (state_ == State::attached) return;
  is_wanted_ = true;
  unheld_since_ = unheld_since;
}

void RobotSession::open() {
  state_ = State::opening;
  actions_.push(OpenSession{robot_, is_clean_due_});
}

void RobotSession::close(bool is_forgotten) {
  const bool was_held = is_held();
  is_wanted_ = false;
  if (state_ == State::opening || was_held) actions_.push(CloseSession{robot_, is_forgotten});
  counts_.fenced_off += unfenced_.size();
  unfenced_.clear();
  end_sorting();
  state_ = State::detached;
  if (was_held) actions_.push(SessionLost{robot_, LossReason::let_go});
}

void RobotSession::on_attached(bool is_present, bool is_v5, TimePoint now) {
  state_ = State::attached;
  is_wanted_ = false;
  is_v5_ = is_v5;
  held_since_ = now;
  retry_ = first_retry;
  if (!is_present || std::exchange(is_clean_due_, false))
    for (auto& [filter, entry] : filters_) entry.is_standing = false;
  const auto unheld_since = std::exchange(unheld_since_, std::nullopt);
  subscribe_own();
  if (is_present && unheld_since && now - *unheld_since > stale_after) {
    marker_ = fmt::format("marker {}", now.time_since_epoch().count());
    marker_until_ = now + marker_patience;
    actions_.push(SendMarker{robot_, marker_});
  }
  actions_.push(SessionHeld{robot_, is_present});
  for (const std::string& filter : std::exchange(given_up_, {}))
    if (is_present) actions_.push(UnsubscribeSession{robot_, filter});
  for (auto& [filter, entry] : filters_)
    if (!entry.is_standing) ask(filter, entry);
}

/// The mailbox first: the marker comes back through it.
void RobotSession::subscribe_own() {
  actions_.push(SubscribeSession{robot_, names_.mailbox_topic(robot_), Qos::at_least_once,
                                 mailbox_id, false});
  if (hears_commands_ && (is_v5_ || wants_retained_commands_))
    actions_.push(SubscribeSession{robot_, names_.command_filter(robot_), Qos::at_least_once,
                                   command_id, wants_retained_commands_});
}

void RobotSession::on_attach_failed(TimePoint now) {
  state_ = State::detached;
  opens_at_ = now + retry_;
  retry_ = std::min(retry_ * 2, longest_retry);
}

void RobotSession::on_detached(bool is_broker_gone, TimePoint now) {
  if (state_ != State::attached) return on_attach_failed(now);
  state_ = State::detached;
  counts_.fenced_off += unfenced_.size();
  unfenced_.clear();
  end_sorting();
  was_heard_after_loss_ = false;
  if (is_broker_gone) {
    unheld_since_ = now;
  } else {
    count_loss(now);
  }
  actions_.push(SessionLost{robot_, is_broker_gone ? LossReason::broker_gone : LossReason::taken});
}

/// Two gateways, or a foreign client, that take the session from each other.
void RobotSession::count_loss(TimePoint now) {
  quick_losses_ = now - held_since_ < quick_loss ? quick_losses_ + 1 : 1;
  if (quick_losses_ <= free_losses) return;
  const unsigned doublings = std::min(quick_losses_ - free_losses - 1, 5U);
  const auto wait = std::min(first_flap_wait * (1 << doublings), longest_flap_wait);
  opens_at_ = now + wait;
  if (quick_losses_ == free_losses + 1)
    actions_.push(Notice{
        Severity::warning,
        fmt::format("{}: its session at the broker (client id {}) is taken again and again: are "
                    "there two robots, or a foreign client, of that name?",
                    robot_, names_.client_id(robot_)),
        robot_});
}

// --- What the robot hears ------------------------------------------------------------------------

void RobotSession::subscribe(const std::string& filter, Qos qos, bool is_standing) {
  Filter& entry = filters_[filter];
  if (entry.id == 0) entry.id = next_id_++;
  entry.qos = qos;
  entry.is_standing = is_standing && !is_clean_due_;
  entry.is_answer_due = !is_standing;
  given_up_.erase(filter);
  if (is_held() && !entry.is_standing) ask(filter, entry);
}

void RobotSession::unsubscribe(const std::string& filter) {
  if (filters_.erase(filter) == 0) return;
  if (is_held()) {
    actions_.push(UnsubscribeSession{robot_, filter});
  } else if (given_up_.size() < max_given_up) {
    given_up_.insert(filter);
  } else {
    is_clean_due_ = true;
  }
}

void RobotSession::begin_clean() {
  if (!is_held()) {
    filters_.clear();
    given_up_.clear();
    is_clean_due_ = true;
    return;
  }
  while (!filters_.empty()) unsubscribe(std::string(filters_.begin()->first));
}

void RobotSession::ask(const std::string& filter, Filter& entry) {
  actions_.push(SubscribeSession{robot_, filter, entry.qos, entry.id, true});
}

void RobotSession::on_subscribed(const std::string& filter, bool is_granted) {
  const auto found = filters_.find(filter);
  if (found == filters_.end()) return;  // the gateway's own, or given up meanwhile
  found->second.is_standing = is_granted;
  if (std::exchange(found->second.is_answer_due, false))
    actions_.push(FilterAnswered{robot_, filter, is_granted});
  if (!is_granted) filters_.erase(filter);
}

// --- Messages ------------------------------------------------------------------------------------

void RobotSession::on_message(BrokerMessage message, std::span<const std::uint32_t> ids,
                              TimePoint now) {
  if (!is_held()) return;
  if (is_marker(message)) {
    for (Unfenced& each : unfenced_) each.is_stale = true;
    end_sorting();
    return release(now);
  }
  if (is_copy(message, ids)) return;
  if (unfenced_.size() >= max_unfenced) {
    ++counts_.dropped;
    return;
  }
  const bool is_unasked = ids.size() == 1 && ids.front() == command_id && !wants_retained_commands_;
  unfenced_.push_back({++last_fence_, std::move(message), is_unasked, false, false, now});
  actions_.push(AskFence{robot_, last_fence_});
}

/// Brokers may send a message once for each of our filters that it matches. Taken is the copy for
/// the robot's own filter with the lowest identifier, else that for the gateway's.
bool RobotSession::is_copy(const BrokerMessage& message, std::span<const std::uint32_t> ids) const {
  if (ids.size() != 1) return false;  // one message for all of them, or a broker that names none
  for (const auto& [filter, entry] : filters_) {
    const bool is_better = ids.front() < first_filter_id || entry.id < ids.front();
    if (is_better && entry.is_standing && !message.retain && filter_matches(filter, message.topic))
      return true;
  }
  return false;
}

bool RobotSession::is_marker(const BrokerMessage& message) const {
  return !marker_.empty() && message.topic == names_.mailbox_topic(robot_) &&
         as_text(message.payload) == marker_;
}

void RobotSession::end_sorting() {
  marker_.clear();
  marker_until_.reset();
}

void RobotSession::on_fence(std::uint64_t number, TimePoint now) {
  for (Unfenced& each : unfenced_) each.is_answered = each.is_answered || each.fence <= number;
  release(now);
}

/// Nothing leaves before it is known what is stale.
void RobotSession::release(TimePoint now) {
  if (!marker_.empty()) return;
  while (!unfenced_.empty() && unfenced_.front().is_answered) {
    Unfenced first = std::move(unfenced_.front());
    unfenced_.pop_front();
    first.message.waited = std::chrono::duration_cast<Waited>(now - first.came);
    if (first.is_stale && !first.message.retain)
      actions_.push(RefuseStale{robot_, std::move(first.message)});
    else
      actions_.push(TakeMessage{robot_, std::move(first.message), first.is_unasked});
  }
}

void RobotSession::on_deadline(TimePoint now) {
  if (!marker_until_ || now < *marker_until_) return;
  for (Unfenced& each : unfenced_) each.is_stale = true;
  end_sorting();
  release(now);
}

}  // namespace slamgw::sessions
