// SPDX-License-Identifier: Apache-2.0
#include "daemon/delivery/refused_topics.hpp"

#include <algorithm>
#include <utility>

#include "daemon/core/protocol_machine.hpp"
#include "daemon/core/spare_buffers.hpp"

namespace slamgw {

RefusedTopics::Topic* RefusedTopics::find(std::string_view topic) {
  if (topics_.empty()) return nullptr;
  const auto known = topics_.find(topic);
  return known == topics_.end() ? nullptr : &known->second;
}

const RefusedTopics::Topic* RefusedTopics::find(std::string_view topic) const {
  return const_cast<RefusedTopics*>(this)->find(topic);
}

RefusedTopics::Topic* RefusedTopics::find_or_add(const std::string& topic, TimePoint now) {
  if (Topic* const known = find(topic)) return known;
  if (topics_.size() >= max_topics) return nullptr;
  Topic& added = topics_[topic];
  added.since = now;
  return &added;
}

bool RefusedTopics::may_try(TimePoint now) const {
  if (tries_put_off_ && now < *tries_put_off_) return false;
  return busy_ < (caution_ > Duration::zero() ? 1 : most_tries);
}

RefusedTopics::Turn RefusedTopics::turn_of(std::string_view topic, std::uint64_t row, bool can_ask,
                                           TimePoint now) const {
  const Topic* const known = find(topic);
  if (!known) return Turn::open;
  if (known->phase == Phase::accused) return Turn::alone;
  if (!known->is_refused()) return Turn::open;
  const bool is_letter = known->phase == Phase::trying && row == known->row;
  const bool is_due = known->phase == Phase::resting && now >= known->due && may_try(now) &&
                      !(can_ask && known->waiting > 0);
  if (!is_letter && !is_due) return Turn::rest;
  return known->refusal.code == 0 ? Turn::alone : Turn::next;
}

bool RefusedTopics::is_over(const Topic& topic, TimePoint now) {
  const bool is_idle = topic.phase == Phase::resting || topic.phase == Phase::accused;
  return is_idle && topic.waiting == 0 && now >= topic.due + forgotten_after;
}

void RefusedTopics::enter(Topic& topic, Phase phase) {
  if (phase == Phase::trying) ++busy_;
  if (std::exchange(topic.phase, phase) == Phase::trying) --busy_;
}

/// Ends the topic's try; the next one is `due`.
void RefusedTopics::rest(Topic& topic, TimePoint due) {
  enter(topic, Phase::resting);
  topic.row = 0;
  topic.due = due;
  wake_ = earlier(wake_, due);
}

/// Ends refusal and accusation. Keeps the topic until the store has answered, and its dead letters
/// have been fetched. The last refused topic of a flow frees the flow's other topics.
void RefusedTopics::accept(Topics::iterator known, TimePoint now) {
  Topic& topic = known->second;
  enter(topic, Phase::accepted);
  topic.tries = topic.losses = 0;
  topic.pause = {};
  topic.due = now;
  wake_ = now;
  const std::string_view flow = flow_of(known->first);
  const auto is_refused_in_flow = [&](const auto& other) {
    return other.second.is_refused() && flow_of(other.first) == flow;
  };
  if (!flows_.empty() && std::ranges::none_of(topics_, is_refused_in_flow))
    flows_.erase(SlotSums::slot(flow));
  if (topic.waiting == 0 && !topic.asked_of) topics_.erase(known);
}

void RefusedTopics::on_rows_lost(TimePoint now) {
  for (auto& [name, topic] : topics_)
    if (topic.phase == Phase::trying && topic.row != 0) rest(topic, now);
}

void RefusedTopics::on_write_failed() {
  for (auto& [name, topic] : topics_)
    if (topic.asked_of) topic.asked_of = 0;
}

void RefusedTopics::grow_pause(Topic& topic, Duration longest, TimePoint now) {
  ++topic.tries;
  topic.pause = std::clamp<Duration>(2 * topic.pause, first_pause, longest);
  rest(topic, now + topic.pause);
  wake_ = now;  // another topic may have its try
}

/// A dead letter that is tried is queued again, for the next connection.
void RefusedTopics::on_link_down(TimePoint now) {
  for (auto& [name, topic] : topics_)
    if (topic.phase == Phase::trying && topic.row == 0 && !topic.asked_of) rest(topic, now);
}

void RefusedTopics::on_written(std::uint64_t sequence, std::string topic) {
  written_.push_back({sequence, std::move(topic)});
  if (written_.size() > most_written) drop_oldest_written();
}

void RefusedTopics::on_answered(std::uint64_t sequence) {
  ++answers_;
  while (!written_.empty() && written_.front().sequence < sequence) drop_oldest_written();
}

void RefusedTopics::drop_oldest_written() {
  SpareBuffers<std::string>::give_back(std::move(written_.front().topic));
  written_.pop_front();
}

void RefusedTopics::on_link_up(TimePoint now) {
  up_since_ = now;
  written_.clear();
  last_refusal_.reset();
}

bool RefusedTopics::on_loss_after_refusal(TimePoint now) {
  if (!last_refusal_ || now - last_refusal_->at >= refusal_to_loss) return false;
  const auto& [topic, refusal, at] = *last_refusal_;
  if (!refusal.is_permanent()) {
    taken_.reset(SlotSums::slot(topic));
    flows_[SlotSums::slot(flow_of(topic))] = {
        refusal.code, "another topic of this robot is refused: " + refusal.why};
  }
  put_off_tries(now);
  return true;
}

void RefusedTopics::on_loss(const PublishWindow::Items& unanswered, TimePoint now) {
  std::set<std::string> topics;
  for (const OutboxItem* item : unanswered) topics.insert(item->message.topic);
  for (Written& written : written_) topics.insert(std::move(written.topic));
  written_.clear();
  for (const std::string& topic : topics)
    if (last_unanswered_.contains(topic)) accuse(topic, now);
  last_unanswered_ = std::move(topics);
}

bool RefusedTopics::on_refused(const std::string& topic, const Refusal& refusal, TimePoint now) {
  last_refusal_ = {topic, refusal, now};
  if (!refusal.is_permanent()) return refuse(topic, refusal, now);
  on_not_tried(topic, {}, now);
  return false;
}

bool RefusedTopics::refuse(const std::string& topic, const Refusal& refusal, TimePoint now) {
  Topic* const known = find_or_add(topic, now);
  if (!known) return false;
  const bool is_new = !known->is_refused();
  const bool is_news = is_new || known->refusal.code != refusal.code;
  if (is_new) known->since = now;
  known->refusal = refusal;
  known->losses = 0;
  // While the store is asked for a letter, this is the answer to an earlier message.
  const bool is_try = known->phase == Phase::trying && !known->asked_of;
  if (is_new || is_try) grow_pause(*known, longest_pause, now);  // else the pause has begun already
  // Wait until it is clear whether the broker closes the connection for this refusal.
  if (is_try && caution_ > Duration::zero()) tries_put_off_ = now + refusal_to_loss;
  return is_news;
}

void RefusedTopics::accuse(const std::string& topic, TimePoint now) {
  Topic* const known = find_or_add(topic, now);
  if (!known || known->is_refused()) return;
  enter(*known, Phase::accused);
  known->due = now;
  wake_ = earlier(wake_, now + forgotten_after);
}

bool RefusedTopics::on_lost_alone(const std::string& topic, const Refusal& refusal, TimePoint now) {
  put_off_tries(now);
  Topic* const known = find_or_add(topic, now);
  if (!known) return false;
  known->refusal = refusal;
  if (now - up_since_ >= stable_after && ++known->losses == 1) known->answers_at_loss = answers_;
  grow_pause(*known, longest_closing_pause, now);
  const bool is_at_fault = known->losses >= losses_at_fault && answers_ > known->answers_at_loss;
  if (is_at_fault) known->losses = 0;
  return is_at_fault;
}

void RefusedTopics::put_off_tries(TimePoint now) {
  caution_ = std::clamp<Duration>(2 * caution_, 2 * first_pause, longest_pause);
  tries_put_off_ = now + caution_;
}

void RefusedTopics::on_published(std::string_view topic) {
  Topic* const known = find(topic);
  if (known && known->is_refused()) enter(*known, Phase::trying);
}

bool RefusedTopics::on_accepted(const std::string& topic, TimePoint now) {
  taken_.set(SlotSums::slot(topic));
  const auto known = topics_.find(topic);
  if (known == topics_.end()) return false;
  const bool was_refused = known->second.is_refused();
  if (was_refused || known->second.phase == Phase::accused) accept(known, now);
  if (!was_refused) return false;
  caution_ = Duration::zero();
  tries_put_off_.reset();
  return true;
}

void RefusedTopics::on_not_tried(std::string_view topic, Duration pause, TimePoint now) {
  const auto known = topics_.find(topic);
  if (known == topics_.end()) return;
  if (known->second.phase == Phase::accused) return accept(known, now);
  if (known->second.phase == Phase::resting) {
    known->second.due = std::max(known->second.due, now + pause);
  } else if (known->second.is_refused()) {
    rest(known->second, now + pause);
    wake_ = now;
  }
}

void RefusedTopics::on_dead_letter(std::string_view topic) {
  Topic* const known = find(topic);
  if (!known) return;
  if (known->waiting++ == 0) wake_ = earlier(wake_, known->due);
}

std::optional<RetryDeadLetters> RefusedTopics::next_to_ask(const Backlog& backlog, TimePoint now) {
  if (!is_wake_due(now)) return std::nullopt;
  auto* const next = next_due(backlog, now);
  if (!next) return std::nullopt;
  if (!backlog.can_keep() || !backlog.has_written_dead_letters()) {
    wake_ = earlier(wake_, now + first_pause);
    return std::nullopt;
  }
  auto& [name, topic] = *next;
  wake_ = now;
  topic.asked_of = topic.waiting;
  const bool is_page = topic.phase == Phase::accepted;
  if (!is_page) enter(topic, Phase::trying);
  return RetryDeadLetters{name, is_page ? resend_page : 1};
}

/// Returns the topic for which the store is asked next, or null, and sets `wake_`.
RefusedTopics::Topics::value_type* RefusedTopics::next_due(const Backlog& backlog, TimePoint now) {
  for (auto known = topics_.begin(); known != topics_.end();)
    if (const auto one = known++; is_over(one->second, now)) accept(one, now);
  if (tries_put_off_ && now >= *tries_put_off_) tries_put_off_.reset();
  wake_ = tries_put_off_;
  Topics::value_type* next = nullptr;
  for (auto& known : topics_) {
    Topic& topic = known.second;
    if (topic.phase == Phase::accused && now >= topic.due + forgotten_after)
      enter(topic, Phase::accepted);  // its letters need not wait for a message that tells
    const bool is_page = topic.phase == Phase::accepted;
    const bool is_idle =
        topic.phase == Phase::accused || (topic.phase == Phase::resting && topic.waiting == 0);
    if (is_idle && topic.due <= now) {
      wake_ = earlier(wake_, topic.due + forgotten_after);
    } else if ((is_page || topic.phase == Phase::resting) && topic.due > now) {
      wake_ = earlier(wake_, topic.due);
    } else if (topic.asked_of) {
      continue;                                            // the store's answer wakes
    } else if (is_page ? !backlog.has_unread(known.first)  // the last page was read
                       : topic.phase == Phase::resting && may_try(now)) {
      if (!next || topic.due < next->second.due) next = &known;
    }
  }
  return next;
}

void RefusedTopics::on_revived(const DeadLettersRevived& revived, TimePoint now) {
  const auto known = topics_.find(revived.retried_topic);
  if (known == topics_.end()) return;
  Topic& topic = known->second;
  const std::size_t asked_of = std::exchange(topic.asked_of, std::nullopt).value_or(0);
  const bool is_none = revived.why_failed.empty() && revived.messages.empty();
  topic.waiting -= std::min(topic.waiting, is_none ? asked_of : revived.messages.size());
  wake_ = now;
  if (topic.phase == Phase::accepted) {
    if (is_none) return accept(known, now);
    if (!revived.why_failed.empty()) topic.due = now + store_pause;
  } else if (topic.phase == Phase::trying) {
    if (!revived.messages.empty())
      topic.row = revived.messages.front().row;
    else
      rest(topic, is_none ? now : now + store_pause);
  }
}

void RefusedTopics::on_taken_away(const FormerLetter& letter) {
  Topic* const known = find(letter.topic);
  if (!known || !letter.was_retried) return;
  if (known->waiting > 0) --known->waiting;
  if (known->asked_of.value_or(0) > 0) --*known->asked_of;
}

void RefusedTopics::on_resent(const FormerLetter& letter, TimePoint now) {
  on_taken_away(letter);
  Topic* const known = find(letter.topic);
  if (!known) return;
  if (known->phase == Phase::resting) rest(*known, now);
  tries_put_off_.reset();
}

void RefusedTopics::on_store_opened(std::vector<DeadTopic> dead_topics, TimePoint now) {
  for (DeadTopic& dead : dead_topics) {
    Topic* const known = find_or_add(dead.topic, now);
    if (!known) break;
    known->waiting += dead.count;
    if (known->phase == Phase::accused) {
      known->tries = 1;
      known->refusal = std::move(dead.refusal);
      rest(*known, now);
    }
  }
  wake_ = now;
}

std::size_t RefusedTopics::count() const {
  return static_cast<std::size_t>(
      std::ranges::count_if(topics_, [](const auto& known) { return known.second.is_refused(); }));
}

std::vector<RefusedTopic> RefusedTopics::list(std::size_t most) const {
  std::vector<RefusedTopic> listed;
  for (const auto& [name, topic] : topics_) {
    if (listed.size() == most) break;
    if (!topic.is_refused()) continue;
    listed.push_back({name, topic.refusal, topic.waiting, topic.tries, topic.since});
  }
  return listed;
}

}  // namespace slamgw
