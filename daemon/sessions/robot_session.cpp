// SPDX-License-Identifier: Apache-2.0
#include "daemon/sessions/robot_session.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace slamgw::sessions {

// --- Holding the session -------------------------------------------------------------------------

void RobotSession::enter(State state) {
  if (is_opening()) --counts_.opening;
  if (is_held()) --counts_.held;
  state_ = state;
  if (is_opening()) ++counts_.opening;
  if (is_held()) ++counts_.held;
}

void RobotSession::on_heard(bool is_elsewhere, TimePoint now) {
  if (is_held()) return;
  note_heard(is_elsewhere, now);
  keeps_at_.reset();
  is_wanted_ = true;
  const unsigned disputed = is_elsewhere ? quick_losses_ : losses_;
  if (now < quiet_at_ && disputed >= contested_losses) set_contested(true);
}

void RobotSession::note_heard(bool is_elsewhere, TimePoint now) {
  const bool was_silent = now - std::exchange(heard_at_, now) > silence;
  if (!is_elsewhere || !was_silent || is_refused_ || is_flapping(now)) return;
  opens_at_ = {};
  retry_ = first_retry;
}

void RobotSession::on_shown_elsewhere(TimePoint now) {
  if (now - heard_at_ > silence) is_wanted_ = false;
}

void RobotSession::keep(TimePoint now) {
  is_wanted_ = !is_held();
  if (!is_flapping(now)) opens_at_ = std::min(opens_at_, now + retry_);
}

bool RobotSession::is_flapping(TimePoint now) const {
  return now < quiet_at_ && quick_losses_ > free_losses;
}

void RobotSession::set_contested(bool is_contested) {
  if (std::exchange(is_contested_, is_contested) == is_contested) return;
  actions_.push(SessionContested{robot_, is_contested});
  actions_.push(Notice{
      is_contested ? Severity::warning : Severity::notice,
      is_contested
          ? fmt::format("{}: another client keeps taking its session at the broker (client id {}): "
                        "is there a second robot or a foreign client with this name?",
                        robot_, names_.client_id(robot_))
          : fmt::format("{}: no other client takes its session at the broker any more", robot_),
      robot_});
}

void RobotSession::open() {
  enter(State::opening);
  is_opened_clean_ = is_purge_due_;
  actions_.push(OpenSession{robot_, is_opened_clean_});
}

void RobotSession::close(bool is_forgotten) {
  is_wanted_ = false;
  if (is_connected()) actions_.push(CloseSession{robot_, is_forgotten});
  drop_unfenced();
  grant_waiting();
  end_note({});
  enter(State::detached);
}

void RobotSession::leave() {
  is_wanted_ = false;
  if (is_connected()) actions_.push(CloseSession{robot_, false});
  enter(State::detached);
}

void RobotSession::prove() {
  if (!is_held()) return;
  proof_ = ++last_fence_;
  actions_.push(AskFence{robot_, proof_});
}

void RobotSession::drop_unfenced() {
  proof_ = 0;
  for (auto& [filter, fence] : given_up_) fence = 0;
  counts_.fenced_off += unfenced_.size();
  unfenced_.clear();
  asked_.clear();
  answers_until_.reset();
  end_sorting();
}

/// Sorts first when a clean session is due. On MQTT 3.1.1 a session that begins clean also ends
/// with its connection, so it is opened a second time.
void RobotSession::on_attached(bool is_present, bool is_v5, TimePoint now) {
  is_v5_ = is_v5;
  is_refused_ = false;
  if (is_clean_due_ && is_present && !is_opened_clean_) return begin_sorting(now);
  is_clean_due_ = is_purge_due_ = false;
  if (is_opened_clean_ && !is_v5) {
    actions_.push(CloseSession{robot_, false});
    return open();
  }
  enter(State::attached);
  ++counts_.attached;
  is_wanted_ = false;
  held_since_ = now;
  knows_all_ = !is_present;
  // If the broker or the former gateway was killed, the session may lack some of the filters.
  for (auto& [filter, entry] : filters_) entry.is_standing = false;
  asks_again_at_.reset();
  ask_wait_ = first_ask_wait;
  const auto unheld_since = std::exchange(unheld_since_, std::nullopt);
  subscribe_own(names_.mailbox_topic(robot_), /*wants_retained=*/false);  // for the marker, too
  if (!is_present) given_up_.clear();
  unsubscribe_given_up();  // before the gateway's own filter, which may be the same
  subscribe_to_commands();
  if (is_present && unheld_since && now - *unheld_since > stale_after) send_marker(now);
  actions_.push(SessionHeld{robot_, is_present});
  for (auto& [filter, entry] : filters_) ask(filter, entry, now);
  if (!note_until_) return;
  if (!is_present) return end_note({});
  note_until_ = now + longest_note_wait;
  subscribe_own(names_.note_topic(robot_), /*wants_retained=*/true);
}

void RobotSession::send_marker(TimePoint now) {
  marker_ = fmt::format("marker {} {}", now.time_since_epoch().count(), markers_back_);
  marker_until_ = now + marker_patience;
  actions_.push(SendMarker{robot_, marker_});
}

/// Gives the messages that waited at the broker an outcome before the broker forgets them.
void RobotSession::begin_sorting(TimePoint now) {
  if (!is_held()) subscribe_own(names_.mailbox_topic(robot_), /*wants_retained=*/false);
  enter(State::sorting);
  is_wanted_ = true;
  for (Unfenced& each : unfenced_) each.is_stale = true;
  send_marker(now);
}

void RobotSession::purge_when_sorted() {
  if (state_ != State::sorting || !marker_.empty() || !unfenced_.empty()) return;
  actions_.push(CloseSession{robot_, false});
  actions_.push(SessionSorted{robot_});
  is_purge_due_ = true;
  open();
}

void RobotSession::subscribe_own(const std::string& topic, bool wants_retained) {
  actions_.push(SubscribeSession{robot_, topic, Qos::at_least_once, own_id, wants_retained});
}

/// Subscribes to all commands on MQTT 5, so that unsubscribed ones have an outcome, too.
void RobotSession::subscribe_to_commands() {
  if (is_v5_ && !hears_all_commands())
    actions_.push(SubscribeSession{robot_, names_.command_filter(robot_), Qos::at_least_once,
                                   command_id, false});
}

/// Returns true when the robot has a filter for all commands itself: `.../#` or `.../+`.
bool RobotSession::hears_all_commands() const {
  std::string filter = names_.command_filter(robot_);
  if (has_filter(filter)) return true;
  filter.back() = '+';
  return has_filter(filter);
}

bool RobotSession::may_want(const std::string& topic) const {
  return !knows_all_ || std::ranges::any_of(filters_, [&](const auto& each) {
    return filter_matches(each.first, topic);
  });
}

void RobotSession::on_other_broker(TimePoint now) {
  for (auto& [filter, entry] : filters_) entry.is_standing = false;
  unheld_since_ = now - 2 * stale_after;
}

void RobotSession::on_attach_failed(bool is_elsewhere, TimePoint now) {
  drop_unfenced();        // of a session that was lost while sorting
  is_purge_due_ = false;  // new commands may wait in the session, so the next try sorts again
  enter(State::detached);
  const bool may_have_left = is_elsewhere && retry_ > first_retry && now - heard_at_ > silence;
  opens_at_ = now + (may_have_left ? longest_retry : retry_);
  retry_ = std::min(retry_ * 2, longest_retry);
}

void RobotSession::on_detached(LossReason why, TimePoint unheld_since, TimePoint now) {
  if (why == LossReason::broker_gone) {
    is_refused_ = false;
    opens_at_ = {};
    retry_ = first_retry;
  }
  const bool was_held = state_ == State::attached;
  if (state_ == State::sorting) drop_unfenced();
  is_purge_due_ = false;
  enter(State::detached);
  if (!was_held) return;
  ++counts_.lost;
  if (why != LossReason::broken || now - held_since_ >= quick_loss) retry_ = first_retry;
  if (why == LossReason::taken) count_loss(now);
  if (why == LossReason::broken) {
    opens_at_ = now + retry_;
    retry_ = std::min(retry_ * 2, longest_retry);
    keeps_at_ = now;
  }
  if (why != LossReason::broker_gone) blame_unanswered();
  // While the marker is out, the broker may still have messages from before this connection.
  unheld_since_ = marker_.empty() ? unheld_since : now - 2 * stale_after;
  drop_unfenced();
  actions_.push(SessionLost{robot_, why});
}

bool RobotSession::forgive_loss(TimePoint now) {
  const auto lost_at = std::exchange(lost_at_, std::nullopt);
  if (is_held() || !lost_at || now - *lost_at > broker_end) return false;
  losses_ -= std::min(losses_, 1U);
  quick_losses_ -= std::min(quick_losses_, 1U);
  return true;
}

/// Counts the loss. Delays the next CONNECT when two gateways, or a foreign client, repeatedly take
/// the session from each other.
void RobotSession::count_loss(TimePoint now) {
  lost_at_ = now;
  const bool is_again = now < quiet_at_;
  losses_ = is_again ? losses_ + 1 : 1;
  quick_losses_ = is_again && now - held_since_ < quick_loss ? quick_losses_ + 1 : 1;
  if (quick_losses_ > free_losses) {
    const unsigned doublings = std::min(quick_losses_ - free_losses - 1, 5U);
    opens_at_ = now + std::min(first_flap_wait * (1 << doublings), longest_flap_wait);
  }
  quiet_at_ = std::max(now, opens_at_) + quiet_minute;
}

// --- Subscriptions -------------------------------------------------------------------------------

RobotSession::Filter& RobotSession::filter_of(const std::string& filter, Qos qos) {
  const auto [entry, is_new] = filters_.try_emplace(filter);
  if (is_new) entry->second.id = make_id(filter);
  entry->second.qos = qos;
  given_up_.erase(filter);
  return entry->second;
}

/// Returns the filter's FNV-1a hash, or the next free number if another filter has the same.
std::uint32_t RobotSession::make_id(const std::string& filter) const {
  std::uint32_t hash = 2166136261U;
  for (const char c : filter) hash = (hash ^ static_cast<std::uint8_t>(c)) * 16777619U;
  std::uint32_t id = first_filter_id + hash % (last_filter_id - first_filter_id);
  const auto is_used = [&](const auto& each) { return each.second.id == id; };
  while (std::ranges::any_of(filters_, is_used)) ++id;
  return id;
}

void RobotSession::subscribe(const std::string& filter, Qos qos, bool may_wait, TimePoint now) {
  Filter& entry = filter_of(filter, qos);
  entry.wants_retained = true;
  is_wanted_ = is_wanted_ || state_ == State::detached;
  if (may_wait)
    entry.answer_due = now + subscribe_patience;
  else
    actions_.push(FilterAnswered{robot_, filter, true});
  if (is_held()) ask(filter, entry, now);
}

void RobotSession::resume(const std::string& filter, Qos qos, TimePoint now) {
  Filter& entry = filter_of(filter, qos);
  entry.was_granted = true;
  if (is_held()) ask(filter, entry, now);
}

void RobotSession::unsubscribe(const std::string& filter) {
  filters_.erase(filter);
  refused_.erase(filter);
  std::erase(asked_, filter);
  const bool is_remembered = given_up_.size() < max_given_up;
  if (is_remembered) given_up_[filter] = 0;
  if (is_held()) {
    if (is_remembered)
      unsubscribe_given_up();
    else
      actions_.push(UnsubscribeSession{robot_, filter});
    subscribe_to_commands();
  } else if (!is_remembered) {
    is_clean_due_ = true;
  }
}

/// The UNSUBSCRIBEs are answered when a fence after them is. If the connection is lost before, they
/// are sent again.
void RobotSession::unsubscribe_given_up() {
  bool is_any = false;
  for (auto& [filter, fence] : given_up_) {
    if (fence != 0) continue;
    actions_.push(UnsubscribeSession{robot_, filter});
    fence = last_fence_ + 1;
    is_any = true;
  }
  if (is_any) actions_.push(AskFence{robot_, ++last_fence_});
}

/// Filters that another gateway or an earlier process has subscribed are not known here. A session
/// that may have some is replaced by a new one.
void RobotSession::begin_clean(TimePoint now) {
  grant_waiting();
  if (is_held() && knows_all_) {
    while (!filters_.empty()) unsubscribe(std::string(filters_.begin()->first));
    return;
  }
  filters_.clear();
  refused_.clear();
  given_up_.clear();
  is_clean_due_ = true;
  if (is_held()) begin_sorting(now);
}

void RobotSession::on_given_up() {
  grant_waiting();
  filters_.clear();
  refused_.clear();
  given_up_.clear();
  is_clean_due_ = false;
}

void RobotSession::grant_waiting(TimePoint end) {
  for (auto& [filter, entry] : filters_) {
    if (!entry.answer_due || *entry.answer_due > end) continue;
    entry.answer_due.reset();
    actions_.push(FilterAnswered{robot_, filter, true});
  }
}

void RobotSession::ask(const std::string& filter, Filter& entry, TimePoint now) {
  if (entry.wants_retained) entry.retained_until = TimePoint::max();
  actions_.push(SubscribeSession{robot_, filter, qos_at_broker(filter, entry.qos), entry.id,
                                 entry.wants_retained});
  asked_.push_back(filter);
  if (!answers_until_) answers_until_ = now + longest_answer;
}

/// Returns at least QoS 1 for commands, also when the robot gets them with QoS 0: brokers keep no
/// message of QoS 0 while no gateway holds the session.
Qos RobotSession::qos_at_broker(const std::string& filter, Qos qos) const {
  std::string commands = names_.command_filter(robot_);
  commands.pop_back();  // '#'
  return filter.starts_with(commands) ? std::max(qos, Qos::at_least_once) : qos;
}

void RobotSession::on_subscribed(const std::string& filter, bool is_granted, TimePoint now) {
  if (filter == names_.note_topic(robot_)) {
    if (note_until_) note_until_ = std::min(*note_until_, now + note_patience);
    return;
  }
  std::erase(asked_, filter);
  if (asked_.empty()) answers_until_.reset();
  if (!is_granted) return on_refused_filter(filter, now);
  std::erase_if(refused_, [&](const auto& each) {
    return each == filter || !(has_filter(each) || is_own(each));
  });
  if (refused_.empty()) ask_wait_ = first_ask_wait;
  const auto found = filters_.find(filter);
  if (found == filters_.end()) return;  // the gateway's own filter, or one given up since
  Filter& entry = found->second;
  entry.is_standing = entry.was_granted = true;
  entry.fatal_losses = 0;
  if (std::exchange(entry.wants_retained, false)) entry.retained_until = now + retained_patience;
  if (std::exchange(entry.answer_due, std::nullopt))
    actions_.push(FilterAnswered{robot_, filter, true});
}

/// Keeps the filter, because the broker may grant it later: it may have just started, or lack room.
/// A mesh whose robot hears of the refusal unsubscribes.
void RobotSession::on_refused_filter(const std::string& filter, TimePoint now) {
  if (const auto found = filters_.find(filter); found != filters_.end()) {
    found->second.is_standing = false;
    if (std::exchange(found->second.answer_due, std::nullopt))
      actions_.push(FilterAnswered{robot_, filter, false});
  } else if (!is_own(filter)) {
    return;
  }
  refused_.insert(filter);
  if (asks_again_at_) return;
  asks_again_at_ = now + ask_wait_;
  ask_wait_ = std::min(2 * ask_wait_, longest_ask_wait);
}

void RobotSession::ask_again(TimePoint now) {
  for (const std::string& filter : refused_) {
    if (const auto found = filters_.find(filter); found != filters_.end())
      ask(filter, found->second, now);
    else if (filter == names_.mailbox_topic(robot_))
      subscribe_own(filter, /*wants_retained=*/false);
    else
      subscribe_to_commands();
  }
}

/// Returns true for the filters that the gateway itself has in the session.
bool RobotSession::is_own(const std::string& filter) const {
  return filter == names_.mailbox_topic(robot_) ||
         (is_v5_ && !hears_all_commands() && filter == names_.command_filter(robot_));
}

/// Counts the loss against the first unanswered filter: a broker answers in order, so it may have
/// ended the connection instead of answering it. Then no other client has taken the session.
void RobotSession::blame_unanswered() {
  if (asked_.empty()) return;
  const std::string filter = asked_.front();
  const auto found = filters_.find(filter);
  if (found == filters_.end()) return;
  const unsigned most = found->second.was_granted ? max_fatal_losses_of_granted : max_fatal_losses;
  if (++found->second.fatal_losses < most) return;
  losses_ = quick_losses_ = 0;
  filters_.erase(found);
  refused_.erase(filter);
  actions_.push(FilterAnswered{robot_, filter, false});
}

// --- The note ------------------------------------------------------------------------------------

void RobotSession::read_note(TimePoint now) {
  const bool is_asked = note_until_.has_value();
  note_until_ = now + longest_note_wait;
  if (!is_held())
    is_wanted_ = true;  // another gateway may have taken the session since the robot asked before
  else if (!is_asked)
    subscribe_own(names_.note_topic(robot_), /*wants_retained=*/true);
}

/// Ignores notes that are not retained: an UNSUBSCRIBE that was lost with its connection leaves old
/// ones in the session.
void RobotSession::on_note(BrokerMessage message) {
  if (message.retain) end_note(std::move(message.payload));
}

void RobotSession::end_note(Bytes note) {
  if (!std::exchange(note_until_, std::nullopt)) return;
  if (note.size() > max_note_octets) note.clear();
  if (!is_held()) return actions_.push(NoteRead{robot_, std::nullopt});
  actions_.push(UnsubscribeSession{robot_, names_.note_topic(robot_)});
  actions_.push(NoteRead{robot_, std::move(note)});
}

// --- Messages ------------------------------------------------------------------------------------

void RobotSession::on_message(BrokerMessage message, std::span<const std::uint32_t> ids,
                              TimePoint now) {
  if (!is_held() && state_ != State::sorting) return;
  if (message.topic == names_.note_topic(robot_)) return on_note(std::move(message));
  if (is_marker(message)) return on_marker(now);
  const bool is_fence = message.topic == names_.mailbox_topic(robot_) && message.payload.empty();
  if (is_fence || !wants_retained(message, now)) return;
  const std::uint32_t id = ids.size() == 1 ? ids.front() : 0;
  const bool is_unasked = id == command_id || is_given_up(id);
  const bool is_rest = is_copy(message, ids);
  Unfenced* const copy = find_copy(message, id);
  const auto stands = [this](std::uint32_t each) {
    const Filter* filter = find_filter(each);
    return filter && filter->is_standing;
  };
  const bool is_clear = knows_all_ || (copy && !copy->awaits_copy && stands(id) &&
                                       std::ranges::all_of(copy->ids, stands));
  if (copy && (is_rest || is_unasked || !is_clear)) return join(*copy, message, id, is_unasked);
  if (is_rest) return;
  if (unfenced_.size() >= max_unfenced) {
    ++counts_.dropped;
    return;
  }
  const bool awaits_copy = may_have_late_copy(message, id);
  unfenced_.push_back({.fence = ++last_fence_,
                       .message = std::move(message),
                       .ids = {id},
                       .is_unasked = is_unasked,
                       .is_stale = !marker_.empty() || state_ == State::sorting,
                       .awaits_copy = awaits_copy,
                       .came = now});
  actions_.push(AskFence{robot_, last_fence_});
}

/// Returns true when the broker sent a message for a filter that the robot no longer has.
bool RobotSession::is_given_up(std::uint32_t id) const {
  return knows_all_ && id >= first_filter_id && find_filter(id) == nullptr;
}

const RobotSession::Filter* RobotSession::find_filter(std::uint32_t id) const {
  const auto found =
      std::ranges::find_if(filters_, [&](const auto& each) { return each.second.id == id; });
  return found == filters_.end() ? nullptr : &found->second;
}

/// Returns the waiting copy of a message. Brokers may send one for each matching filter.
RobotSession::Unfenced* RobotSession::find_copy(const BrokerMessage& message, std::uint32_t id) {
  if (id == 0 || message.retain) return nullptr;
  const auto copy = std::ranges::find_if(unfenced_, [&](const Unfenced& each) {
    return std::ranges::find(each.ids, id) == each.ids.end() && !each.message.retain &&
           each.message.topic == message.topic && each.message.payload == message.payload;
  });
  return copy == unfenced_.end() ? nullptr : &*copy;
}

/// The message is this gateway's when a fence shows that the broker has the acknowledgements of all
/// its copies. Otherwise the next gateway gets the rest of them, and takes or refuses it too.
void RobotSession::join(Unfenced& copy, const BrokerMessage& message, std::uint32_t id,
                        bool is_unasked) {
  copy.is_unasked = copy.is_unasked && is_unasked;
  copy.ids.push_back(id);
  copy.message.qos = std::max(copy.message.qos, message.qos);
  copy.awaits_copy = copy.awaits_copy || may_have_late_copy(message, id);
  copy.has_waited = copy.is_answered = false;
  copy.fence = ++last_fence_;
  actions_.push(AskFence{robot_, copy.fence});
}

/// Returns true when the broker may have kept another copy, with QoS 2, from before this
/// connection.
bool RobotSession::may_have_late_copy(const BrokerMessage& message, std::uint32_t id) const {
  if (knows_all_ || id < first_filter_id || message.retain) return false;
  return !find_filter(id) || std::ranges::any_of(filters_, [&](const auto& each) {
    const Filter& other = each.second;
    return other.id != id && other.qos == Qos::exactly_once && other.was_granted &&
           !other.is_standing && filter_matches(each.first, message.topic);
  });
}

/// Returns true when a copy may still come: with QoS 2 it comes one round trip later.
bool RobotSession::is_copy_to_come(const Unfenced& one) const {
  return (one.is_unasked || one.awaits_copy) && !one.has_waited;
}

/// Returns false for a retained message that the robot did not ask for: on MQTT 3.1.1, a renewed
/// subscription brings its retained messages again.
bool RobotSession::wants_retained(const BrokerMessage& message, TimePoint now) const {
  if (!message.retain) return true;
  return std::ranges::any_of(filters_, [&](const auto& each) {
    return now < each.second.retained_until && filter_matches(each.first, message.topic);
  });
}

/// Returns true when another copy of the message is the one to take: brokers may send one for each
/// matching filter. The copy for the robot's own filter with the highest QoS is taken, and of those
/// the lowest identifier; without such a filter, the copy for the gateway's filter.
bool RobotSession::is_copy(const BrokerMessage& message, std::span<const std::uint32_t> ids) const {
  if (ids.size() != 1 || ids.front() == own_id || message.retain) return false;
  const Filter* own = find_filter(ids.front());
  return std::ranges::any_of(filters_, [&](const auto& each) {
    const Filter& other = each.second;
    const bool is_better =
        !own || other.qos > own->qos || (other.qos == own->qos && other.id < own->id);
    return is_better && other.is_standing && filter_matches(each.first, message.topic);
  });
}

void RobotSession::on_marker(TimePoint now) {
  if (++markers_back_ < marker_rounds) return send_marker(now);
  end_sorting();
  purge_when_sorted();
}

bool RobotSession::is_marker(const BrokerMessage& message) const {
  return !marker_.empty() && message.topic == names_.mailbox_topic(robot_) &&
         as_text(message.payload) == marker_;
}

void RobotSession::end_sorting() {
  marker_.clear();
  marker_until_.reset();
  markers_back_ = 0;
}

void RobotSession::on_fence(std::uint64_t number, TimePoint now) {
  if (proof_ != 0 && proof_ <= number) {
    proof_ = 0;
    actions_.push(SessionProven{robot_});
  }
  std::erase_if(given_up_,
                [number](const auto& each) { return each.second != 0 && each.second <= number; });
  for (Unfenced& each : unfenced_) {
    if (each.is_answered || each.fence > number) continue;
    each.is_answered = !is_copy_to_come(each);
    if (each.is_answered) continue;
    each.fence = ++last_fence_;
    each.has_waited = true;
    actions_.push(AskFence{robot_, each.fence});
  }
  release(now);
}

void RobotSession::release(TimePoint now) {
  while (!unfenced_.empty() && unfenced_.front().is_answered) {
    Unfenced first = std::move(unfenced_.front());
    unfenced_.pop_front();
    first.message.waited = std::chrono::duration_cast<Waited>(now - first.came);
    pass_on(first);
  }
  purge_when_sorted();
}

/// Reports a message of this gateway. A message from the mailbox carries its own age.
void RobotSession::pass_on(Unfenced& one) {
  if (one.message.topic == names_.mailbox_topic(robot_)) {
    auto handed_on = decode_waiting(one.message.payload);
    if (!handed_on) {
      ++counts_.dropped;
      return;
    }
    handed_on->waited += one.message.waited;
    if (one.is_stale || state_ == State::sorting)
      actions_.push(RefuseStale{robot_, std::move(*handed_on), state_ == State::sorting});
    else
      actions_.push(TakeMessage{robot_, std::move(*handed_on), false});
  } else if (one.is_stale && !one.message.retain) {
    actions_.push(RefuseStale{robot_, std::move(one.message), state_ == State::sorting});
  } else {
    actions_.push(TakeMessage{robot_, std::move(one.message), one.is_unasked});
  }
}

std::optional<TimePoint> RobotSession::deadline() const {
  std::optional<TimePoint> next =
      earlier(earlier(marker_until_, note_until_), earlier(asks_again_at_, answers_until_));
  if (is_contested_) next = earlier(next, quiet_at_);
  for (const auto& [filter, entry] : filters_) next = earlier(next, entry.answer_due);
  return next;
}

void RobotSession::on_deadline(TimePoint now) {
  if (marker_until_ && now >= *marker_until_) {
    end_sorting();
    purge_when_sorted();
  }
  if (note_until_ && now >= *note_until_) end_note({});
  if (now >= quiet_at_) set_contested(false);
  if (asks_again_at_ && now >= *asks_again_at_) {
    asks_again_at_.reset();
    if (is_held()) ask_again(now);
  }
  if (answers_until_ && now >= *answers_until_) {
    answers_until_.reset();
    for (const std::string& filter : std::exchange(asked_, {}))
      if (const auto found = filters_.find(filter); is_held() && found != filters_.end())
        ask(filter, found->second, now);
  }
  grant_waiting(now);
}

}  // namespace slamgw::sessions
