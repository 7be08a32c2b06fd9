// SPDX-License-Identifier: Apache-2.0
// A message store in memory that answers and fails on the test's command. It keeps its durable rows
// when the outbox of one "process" is replaced by the next one's.
#pragma once

#include <algorithm>
#include <deque>
#include <map>
#include <set>
#include <utility>
#include <variant>

#include "daemon/delivery/message_store.hpp"

namespace slamgw::test {

class FakeStore {
 public:
  struct Row {
    BrokerMessage message;
    TimePoint stored{};
  };

  void ask(StoreRequest request) { requests_.push_back(std::move(request)); }
  bool is_asked() const { return !requests_.empty(); }
  /// Drops the requests that were not served.
  void on_process_died() { requests_.clear(); }

  StoreOpened open(TimePoint now) {
    StoreOpened opened;
    for (const auto& [row, kept] : rows) {
      opened.last_row = row;
      ++opened.count;
      opened.bytes += stored_cost(kept.message);
      opened.shares.add_named(flow_of(kept.message.topic), stored_cost(kept.message));
      opened.oldest_age = std::max(opened.oldest_age, now - kept.stored);
      opened.topics.add(kept.message.topic, 1);
    }
    if (!dead_letters.empty())
      opened.last_row = std::max(opened.last_row, dead_letters.rbegin()->first);
    opened.dead_letters = count_dead_letters();
    for (const auto& [id, letter] : dead_letters) {
      const std::string& topic = letter.message.topic;
      opened.shares.add_named(flow_of(topic), stored_cost(letter.message));
      if (!is_retried(letter.why.code, letter.why.tries)) continue;
      const auto known = std::ranges::find(opened.dead_topics, topic, &DeadTopic::topic);
      if (known != opened.dead_topics.end()) {
        ++known->count;
      } else {
        opened.dead_topics.push_back({topic, {letter.why.code, letter.why.reason}, 1});
      }
    }
    if (is_failing) opened.why_read_only = "read-only file system";
    return opened;
  }

  /// Serves the first request.
  StoreEvent serve(TimePoint now) {
    auto request = std::move(requests_.front());
    requests_.pop_front();
    return std::visit([&](auto& what) { return serve(what, now); }, request);
  }

  struct Letter {
    BrokerMessage message;
    NewDeadLetter why;
  };

  DeadLetterCounts count_dead_letters() const {
    DeadLetterCounts counts{dead_letters.size(), 0};
    for (const auto& [id, letter] : dead_letters) counts.bytes += stored_cost(letter.message);
    return counts;
  }
  /// Makes messages of all dead letters, as an operator orders.
  DeadLettersRevived revive_all(TimePoint now) {
    std::vector<std::uint64_t> ids;
    for (const auto& [id, letter] : dead_letters) ids.push_back(id);
    return revive(ids, {}, now);
  }
  DeadLettersChanged discard_all() {
    DeadLettersChanged changed;
    for (const auto& [id, letter] : std::exchange(dead_letters, {}))
      changed.discarded.push_back({id, letter.message.topic, stored_cost(letter.message),
                                   is_retried(letter.why.code, letter.why.tries)});
    return changed;
  }
  DeadLettersRevived revive_one(std::uint64_t id, TimePoint now) { return revive({id}, {}, now); }

  std::map<std::uint64_t, Row> rows;
  std::map<std::uint64_t, Letter> dead_letters;
  std::set<std::uint64_t> damaged;  ///< rows whose content has changed on disk
  bool is_failing = false;
  bool is_full = false;            ///< takes erasures only
  std::size_t fail_countdown = 0;  ///< the n-th write from now fails; 0: none
  std::size_t commits = 0;
  std::size_t largest_page = 0;
  std::size_t loads = 0;

 private:
  StoreEvent serve(WriteToStore& write, TimePoint now) {
    const bool is_counted_out = fail_countdown > 0 && --fail_countdown == 0;
    const bool is_without_room = is_full && !(write.keep.empty() && write.dead_letters.empty());
    if (is_failing || is_counted_out || is_without_room)
      return StoreWriteFailed{"no space left on device"};
    ++commits;
    for (StoredMessage& stored : write.keep) rows[stored.row] = {std::move(stored.message), now};
    for (NewDeadLetter& letter : write.dead_letters) {
      const auto row = rows.find(letter.row);
      if (row == rows.end()) continue;
      dead_letters[letter.row] = {std::move(row->second.message), std::move(letter)};
      rows.erase(row);
    }
    for (const std::uint64_t row : write.forget) rows.erase(row);
    return StoreWritten{};
  }
  StoreEvent serve(const LoadFromStore& load, TimePoint now) {
    ++loads;
    StoreLoaded loaded;
    for (auto row = rows.upper_bound(load.after);
         row != rows.end() && loaded.messages.size() < load.max_messages;) {
      if (damaged.contains(row->first)) {
        loaded.damaged.push_back(row->first);
        loaded.damaged_bytes += stored_cost(row->second.message);
        dead_letters[row->first] = {std::move(row->second.message),
                                    {row->first, "damaged", 0, losses_at_fault}};
        row = rows.erase(row);
        continue;
      }
      loaded.messages.push_back({row->first, row->second.message, now - row->second.stored});
      ++row;
    }
    largest_page = std::max(largest_page, loaded.messages.size());
    return loaded;
  }

  StoreEvent serve(const RetryDeadLetters& retry, TimePoint now) {
    if (is_failing || is_full)
      return DeadLettersRevived{{}, retry.topic, "no space left on device"};
    std::vector<std::uint64_t> ids;
    const auto take = [&](bool has_lost_connection) {
      for (const auto& [id, letter] : dead_letters) {
        const bool is_wanted =
            letter.message.topic == retry.topic && is_retried(letter.why.code, letter.why.tries) &&
            (letter.why.code == 0 && letter.why.tries > 0) == has_lost_connection;
        if (is_wanted && ids.size() < retry.max_letters) ids.push_back(id);
      }
    };
    take(true);
    take(false);
    return revive(ids, retry.topic, now);
  }
  DeadLettersRevived revive(const std::vector<std::uint64_t>& ids, const std::string& topic,
                            TimePoint now) {
    DeadLettersRevived revived;
    revived.retried_topic = topic;
    for (const std::uint64_t id : ids) {
      Letter letter = std::move(dead_letters.extract(id).mapped());
      BrokerMessage& message = letter.message;
      revived.messages.push_back(
          {id, message.topic, stored_cost(message), is_retried(letter.why.code, letter.why.tries)});
      rows[id] = {std::move(message), now};
    }
    return revived;
  }

  std::deque<StoreRequest> requests_;
};

}  // namespace slamgw::test
