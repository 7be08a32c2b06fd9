// SPDX-License-Identifier: Apache-2.0
#include "daemon/delivery/held_topics.hpp"

#include <algorithm>
#include <cstdint>
#include <iterator>

#include "daemon/core/spare_buffers.hpp"

namespace slamgw {

void ConnectionSuspects::on_written(std::uint64_t sequence, std::string topic) {
  written_.push_back({sequence, std::move(topic)});
  if (written_.size() > most_written) drop_oldest();
}

void ConnectionSuspects::on_answered(std::uint64_t sequence) {
  while (!written_.empty() && written_.front().sequence < sequence) drop_oldest();
}

void ConnectionSuspects::drop_oldest() {
  SpareBuffers<std::string>::give_back(std::move(written_.front().topic));
  written_.pop_front();
}

std::vector<std::string> ConnectionSuspects::on_loss(const OutboxEntries& unanswered,
                                                     TimePoint now) {
  std::set<std::string> topics;
  for (const OutboxEntry& entry : unanswered) topics.insert(entry.message.topic);
  for (Written& written : written_) topics.insert(std::move(written.topic));
  written_.clear();
  std::vector<std::string> suspects;
  if (now - last_loss_ <= longest_between)
    std::set_intersection(topics.begin(), topics.end(), last_unanswered_.begin(),
                          last_unanswered_.end(), std::back_inserter(suspects));
  last_unanswered_ = std::move(topics);
  last_loss_ = now;
  return suspects;
}

void ConnectionSuspects::on_link_up() {
  written_.clear();
  refused_.reset();
}

HeldTopics::Lane* HeldTopics::find(std::string_view topic) {
  if (lanes_.empty()) return nullptr;
  const auto known = lanes_.find(TopicCounts::slot(topic));
  return known == lanes_.end() ? nullptr : &known->second;
}

void HeldTopics::pause(Slot slot, Lane& lane, TimePoint due) {
  end_pause(slot, lane);
  lane.phase = Phase::paused;
  lane.due = due;
  pauses_.emplace(due, slot);
}

void HeldTopics::end_pause(Slot slot, Lane& lane) {
  if (lane.phase == Phase::paused || lane.phase == Phase::idle) pauses_.erase({lane.due, slot});
  lane.phase = Phase::waiting;
}

void HeldTopics::wait_idle(Slot slot, Lane& lane) {
  pause(slot, lane, lane.suspected + suspicion_lasts);
  lane.phase = Phase::idle;
}

/// Nothing holds it back any more.
void HeldTopics::advance(Slot slot) {
  Lane& lane = lanes_.at(slot);
  end_pause(slot, lane);
  if (lane.under_way > 0) {
    lane.phase = Phase::waiting;
  } else if (!lane.loaded.empty()) {
    lane.phase = Phase::runnable;
    runnable_.push_back(slot);
  } else if (!lane.rows.empty()) {
    lane.phase = Phase::wanting;
    wanting_.push_back(slot);
  } else if (!is_done(lane)) {
    lane.phase = Phase::runnable;  // next() checks whether it may go
    runnable_.push_back(slot);
  } else if (lane.is_suspect && !lane.is_accepted) {
    wait_idle(slot, lane);
  } else {
    for (OutboxEntry& entry : lane.unstored) {
      unstored_bytes_ -= entry.cost();
      released_.push_back(std::move(entry));
    }
    lanes_.erase(slot);
  }
}

/// No reason is left to hold it. When it was accepted, what is still on its way from the disk goes
/// the usual way; else it would be refused again.
bool HeldTopics::is_done(const Lane& lane) const {
  if (!lane.rows.empty() || !lane.loaded.empty()) return false;
  if (lane.is_accepted) return true;
  return lane.unstored.empty() && !stored_.has(lane.topic);
}

bool HeldTopics::hold(const std::string& topic, const Refusal& refusal, std::size_t under_way,
                      TimePoint now) {
  const Slot slot = TopicCounts::slot(topic);
  const auto [known, is_new] = lanes_.try_emplace(slot);
  Lane& lane = known->second;
  const bool is_news = is_new || lane.refusal.code != refusal.code;
  lane.refusal = refusal;
  if (is_new) {
    lane.topic = topic;
    lane.since = now;
    lane.under_way = under_way;
  } else if (lane.phase == Phase::paused) {
    return is_news;  // it was under way when the pause began
  }
  if (std::exchange(lane.is_accepted, false)) {  // it begins anew
    lane.tries = 0;
    lane.since = now;
    lane.pause = Duration::zero();
  }
  lane.is_suspect = false;
  grow_pause(slot, lane, longest_pause, now);
  return is_news;
}

void HeldTopics::grow_pause(Slot slot, Lane& lane, Duration longest, TimePoint now) {
  ++lane.tries;
  lane.pause = std::clamp<Duration>(2 * lane.pause, first_pause, longest);
  unload(lane);
  pause(slot, lane, now + lane.pause);
}

bool HeldTopics::suspect(const std::string& topic, TimePoint now) {
  const auto [known, is_new] = lanes_.try_emplace(TopicCounts::slot(topic));
  Lane& lane = known->second;
  if (std::exchange(lane.is_accepted, false)) lane.tries = 0;
  lane.is_suspect = true;
  lane.suspected = now;
  if (!is_new) return false;
  lane.topic = topic;
  lane.since = now;
  return true;
}

bool HeldTopics::on_lost_alone(const std::string& topic, std::uint64_t answers, TimePoint now) {
  constexpr std::uint32_t losses_that_convict = 2;
  const Slot slot = TopicCounts::slot(topic);
  Lane& lane = lanes_.at(slot);
  lane.suspected = now;
  lane.refusal = {0, "the connection is lost when they are sent"};
  if (++lane.losses == 1) lane.answers_at_loss = answers;
  grow_pause(slot, lane, longest_pause_of_suspect, now);
  put_off_tries(now);
  const bool is_convicted = lane.losses >= losses_that_convict && answers > lane.answers_at_loss;
  if (is_convicted) lane.losses = 0;
  return is_convicted;
}

bool HeldTopics::wants_probe(std::string_view topic) const {
  const auto known = lanes_.find(TopicCounts::slot(topic));
  if (known == lanes_.end() || known->second.phase != Phase::idle || !may_go(known->second))
    return false;
  // Tries of refused topics that are put off do not count: there is always one of several.
  const bool is_others_turn =
      !wanting_.empty() || !loading_.empty() || std::ranges::any_of(runnable_, [this](Slot slot) {
        const auto lane = lanes_.find(slot);
        return lane != lanes_.end() && lane->second.phase == Phase::runnable &&
               may_go(lane->second);
      });
  return !is_others_turn;
}

void HeldTopics::put_off_tries(TimePoint now) {
  caution_ = std::clamp<Duration>(2 * caution_, 2 * first_pause, longest_pause);
  tries_put_off_ = now + caution_;
}

/// What was loaded may no longer be the oldest: it is loaded again when its turn comes.
void HeldTopics::unload(Lane& lane) {
  loaded_ -= lane.loaded.size();
  for (const OutboxEntry& entry : lane.loaded) lane.rows.push_back(entry.row);
  lane.loaded.clear();
  std::sort(lane.rows.begin(), lane.rows.end());
}

void HeldTopics::add_row(std::string_view topic, std::uint64_t row) {
  Lane& lane = lanes_.at(TopicCounts::slot(topic));
  lane.rows.insert(std::upper_bound(lane.rows.begin(), lane.rows.end(), row), row);
  if (lane.phase == Phase::idle) advance(TopicCounts::slot(topic));
}

void HeldTopics::add(OutboxEntry entry) {
  const Slot slot = TopicCounts::slot(entry.message.topic);
  Lane& lane = lanes_.at(slot);
  const auto after = std::upper_bound(
      lane.unstored.begin(), lane.unstored.end(), entry.order,
      [](std::uint64_t order, const OutboxEntry& other) { return order < other.order; });
  unstored_bytes_ += entry.cost();
  lane.unstored.insert(after, std::move(entry));
  if (lane.phase == Phase::idle) advance(slot);
}

OutboxEntries HeldTopics::take_unstored() {
  OutboxEntries taken;
  for (auto& [slot, lane] : lanes_) {
    std::move(lane.unstored.begin(), lane.unstored.end(), std::back_inserter(taken));
    lane.unstored.clear();
  }
  unstored_bytes_ = 0;
  return taken;
}

std::size_t HeldTopics::unstored() const {
  std::size_t count = 0;
  for (const auto& [slot, lane] : lanes_) count += lane.unstored.size();
  return count;
}

std::vector<std::uint64_t> HeldTopics::rows_to_load(std::size_t most) {
  while (!wanting_.empty() && loaded_ + loading_.size() < most) {
    const Slot slot = wanting_.front();
    wanting_.pop_front();
    const auto known = lanes_.find(slot);
    if (known == lanes_.end() || known->second.phase != Phase::wanting) continue;
    Lane& lane = known->second;
    if (lane.rows.empty() || !lane.loaded.empty()) {
      advance(slot);
      continue;
    }
    const std::size_t count = lane.is_accepted ? rows_at_once : 1;
    for (std::size_t i = 0; i < std::min(count, lane.rows.size()); ++i)
      loading_.push_back(lane.rows[i]);
    lane.phase = Phase::loading;
    loading_lanes_.push_back(slot);
  }
  std::sort(loading_.begin(), loading_.end());
  return loading_;
}

std::vector<std::string> HeldTopics::on_loaded(StoreLoaded loaded, TimePoint now) {
  // The answer may end early; rows that it passes over are not in the store.
  std::uint64_t answered_up_to = loaded.damaged.empty() ? 0 : loaded.damaged.back();
  if (!loaded.messages.empty())
    answered_up_to = std::max(answered_up_to, loaded.messages.back().row);
  if (answered_up_to == 0) answered_up_to = UINT64_MAX;
  const auto end = std::upper_bound(loading_.begin(), loading_.end(), answered_up_to);
  for (StoredMessage& stored : loaded.messages) {
    Lane* const lane = find(stored.message.topic);
    if (!lane || lane->phase != Phase::loading) continue;  // refused, or the link was lost
    lane->loaded.push_back(entry_from_store(std::move(stored), now));
    ++loaded_;
  }
  std::vector<std::string> gone;
  for (const Slot slot : loading_lanes_) {
    Lane& lane = lanes_.at(slot);
    if (lane.phase != Phase::loading) continue;
    const std::size_t answered = std::erase_if(lane.rows, [&](std::uint64_t row) {
      return std::binary_search(loading_.begin(), end, row);
    });
    gone.insert(gone.end(), answered - std::min(answered, lane.loaded.size()), lane.topic);
  }
  end_loading();
  return gone;
}

void HeldTopics::on_load_failed() { end_loading(); }

void HeldTopics::end_loading() {
  loading_.clear();
  for (const Slot slot : std::exchange(loading_lanes_, {})) {
    if (lanes_.at(slot).phase == Phase::loading) advance(slot);
  }
}

OutboxEntries HeldTopics::on_store_opened(TimePoint now) {
  OutboxEntries in_memory;
  for (auto& [slot, lane] : lanes_) {
    std::move(lane.loaded.begin(), lane.loaded.end(), std::back_inserter(in_memory));
    lane.loaded.clear();
    lane.rows.clear();
    if (lane.phase != Phase::paused && lane.phase != Phase::idle)
      pause(slot, lane, now + first_pause);
  }
  loaded_ = 0;
  loading_.clear();
  loading_lanes_.clear();
  return in_memory;
}

void HeldTopics::count_stored(TopicCounts& counts) const {
  for (const auto& [slot, lane] : lanes_) {
    for (std::size_t i = 0; i < lane.rows.size() + lane.loaded.size(); ++i) counts.add(lane.topic);
  }
}

/// While tries are put off, only those go on that were not refused, or no longer are.
bool HeldTopics::may_go(const Lane& lane) const {
  return !tries_put_off_ || lane.is_accepted || !is_refused(lane);
}

const OutboxEntry* HeldTopics::next(TimePoint now) {
  for (std::size_t left = runnable_.size(); left > 0; --left) {
    const Slot slot = runnable_.front();
    const auto known = lanes_.find(slot);
    const bool is_runnable = known != lanes_.end() && known->second.phase == Phase::runnable;
    if (is_runnable && may_go(known->second)) {
      Lane& lane = known->second;
      if (!lane.loaded.empty()) return &lane.loaded.front();
      if (!lane.unstored.empty() && !stored_.has(lane.topic)) return &lane.unstored.front();
      pause(slot, lane, now + first_pause);  // for what is on its way to the disk or from there
    } else if (is_runnable) {
      runnable_.push_back(slot);
    }
    runnable_.pop_front();
  }
  return nullptr;
}

OutboxEntry HeldTopics::take_next() {
  Lane& lane = lanes_.at(runnable_.front());
  runnable_.pop_front();
  lane.phase = Phase::waiting;
  const bool is_stored = !lane.loaded.empty();
  OutboxEntries& source = is_stored ? lane.loaded : lane.unstored;
  OutboxEntry entry = std::move(source.front());
  source.pop_front();
  if (is_stored) {
    --loaded_;
  } else {
    unstored_bytes_ -= entry.cost();
  }
  return entry;
}

void HeldTopics::put_off_next(TimePoint now) {
  const Slot slot = runnable_.front();
  runnable_.pop_front();
  pause(slot, lanes_.at(slot), now + longest_pause);
}

void HeldTopics::on_published(std::string_view topic) {
  if (Lane* const lane = find(topic)) ++lane->under_way;
}

bool HeldTopics::on_answered(std::string_view topic, Answer answer) {
  Lane* const lane = find(topic);
  if (!lane) return false;
  if (lane->under_way > 0) --lane->under_way;
  if (answer == Answer::refused) return false;
  const bool is_first = answer == Answer::accepted && !std::exchange(lane->is_accepted, true);
  const bool ends_pause = is_first && (lane->phase == Phase::paused || lane->phase == Phase::idle);
  const bool is_news = is_first && is_refused(*lane);
  if (is_first) {
    caution_ = Duration::zero();
    tries_put_off_.reset();
    lane->is_suspect = false;
    lane->losses = 0;
  }
  if (ends_pause || lane->phase == Phase::waiting) advance(TopicCounts::slot(topic));
  return is_news;
}

void HeldTopics::on_link_down() {
  runnable_.clear();
  wanting_.clear();
  for (auto& [slot, lane] : lanes_) {
    lane.under_way = 0;
    unload(lane);
    if (lane.phase != Phase::paused && lane.phase != Phase::idle) lane.phase = Phase::waiting;
  }
}

void HeldTopics::on_link_up(TimePoint now) {
  for (auto& [slot, lane] : lanes_) {
    lane.is_accepted = false;
    // A suspect waits until what else a connection begins with is through.
    const TimePoint earliest = lane.is_suspect ? now + first_pause : now;
    if (lane.phase != Phase::paused || lane.due < earliest) pause(slot, lane, earliest);
  }
  on_deadline(now);
}

void HeldTopics::on_deadline(TimePoint now) {
  if (tries_put_off_ && *tries_put_off_ <= now) tries_put_off_.reset();
  while (!pauses_.empty() && pauses_.begin()->first <= now) {
    const Slot slot = pauses_.begin()->second;
    Lane& lane = lanes_.at(slot);
    if (lane.phase == Phase::idle) lane.is_suspect = false;
    advance(slot);
  }
}

std::size_t HeldTopics::refused() const {
  return static_cast<std::size_t>(std::count_if(
      lanes_.begin(), lanes_.end(), [](const auto& lane) { return is_refused(lane.second); }));
}

std::vector<HeldTopic> HeldTopics::list(std::size_t most) const {
  std::vector<HeldTopic> listed;
  for (const auto& [slot, lane] : lanes_) {
    if (listed.size() == most) break;
    if (!is_refused(lane)) continue;
    const std::size_t waiting =
        lane.rows.size() + lane.loaded.size() + lane.unstored.size() + lane.under_way;
    listed.push_back({lane.topic, lane.refusal, waiting, lane.tries, lane.since});
  }
  return listed;
}

}  // namespace slamgw
