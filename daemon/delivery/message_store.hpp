// SPDX-License-Identifier: Apache-2.0
// The border between the outbox and the store of undelivered messages on disk: three requests, and
// the events that answer them. DiskStore is behind it in the daemon, a fake with state in tests.
// Events come in the order of the requests, on the loop's thread, never from inside a request.
//
// `generation`: how many StoreOpened and StoreAbsent the outbox had seen when it asked. A store
// passes over requests from before its last one without an answer: they meant another file.
#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <unordered_map>
#include <variant>
#include <vector>

#include "daemon/core/messages.hpp"

namespace slamgw {

/// How many messages of each topic are in a place, in bounded memory: counters by the topic's hash,
/// only those that are not zero, for as a rule there are none. Two topics may share a counter;
/// "none" is always true, "some" may mean the other topic, and costs that one a detour through the
/// store. Used by the backlog.
class TopicCounts {
 public:
  /// A thousand robots with three topics each rarely share a slot.
  static constexpr std::size_t slots = 65536;

  static std::size_t slot(std::string_view topic) {
    return std::hash<std::string_view>{}(topic) % slots;
  }

  void add(std::string_view topic) { ++counts_[slot(topic)]; }
  /// Only what was added before.
  void remove(std::string_view topic) {
    const auto count = counts_.find(slot(topic));
    if (count != counts_.end() && --count->second == 0) counts_.erase(count);
  }
  bool has(std::string_view topic) const {
    return !counts_.empty() && counts_.contains(slot(topic));
  }

 private:
  std::unordered_map<std::size_t, std::uint32_t> counts_;  // by slot
};

// What each flow has in the store, so that none takes all of it. A flow is what a topic has in
// front of its last level: all types of one robot are one flow. In bounded memory, as TopicCounts:
// flows whose names share a slot share what they may have. Used by the backlog.

inline std::string_view flow_of(std::string_view topic) {
  return topic.substr(0, topic.rfind('/'));
}

class StoreShares {
 public:
  struct Share {
    std::string flow;
    std::uint64_t bytes = 0;
  };
  /// As many robots as a gateway knows rarely share one.
  static constexpr std::size_t slots = 65536;

  void add(std::string_view topic, std::uint64_t bytes) {
    Share& share = shares_[slot(topic)];
    if (share.bytes == 0) share.flow = flow_of(topic);
    share.bytes += bytes;
  }
  /// What was added before, or less.
  void remove(std::string_view topic, std::uint64_t bytes) {
    const auto share = shares_.find(slot(topic));
    if (share == shares_.end()) return;
    share->second.bytes -= std::min(share->second.bytes, bytes);
    if (share->second.bytes == 0) shares_.erase(share);
  }
  std::uint64_t bytes_of(std::string_view topic) const {
    const auto share = shares_.find(slot(topic));
    return share == shares_.end() ? 0 : share->second.bytes;
  }
  /// Looks at all of them.
  Share largest() const {
    Share largest;
    for (const auto& [slot, share] : shares_)
      if (share.bytes > largest.bytes) largest = share;
    return largest;
  }

 private:
  static std::size_t slot(std::string_view topic) {
    return std::hash<std::string_view>{}(flow_of(topic)) % slots;
  }

  std::unordered_map<std::size_t, Share> shares_;  // by slot; none is empty
};

/// `row` is the outbox's number for a stored message: rows rise in the order of storing, and
/// messages of one topic are delivered in the order of their rows.
struct StoredMessage {
  std::uint64_t row = 0;
  BrokerMessage message;
  Duration age{};  ///< since it was stored; only in StoreLoaded
};

/// A stored message becomes a dead letter: it is no longer among the messages and stays on disk,
/// with its row and age, until it is a message again or an operator discards it.
struct NewDeadLetter {
  std::uint64_t row = 0;    ///< stored, or among `keep` of the same request
  std::string reason;       ///< for people: "topic name invalid"
  int code = 0;             ///< MQTT 5 reason code of the refusal; 0: the connection was lost
  std::uint32_t tries = 0;  ///< how often it was published without success
};

/// How many losses of the connection with a message alone under way are that message's fault.
inline constexpr std::uint32_t losses_that_convict = 2;

/// Whether a dead letter goes up by itself once the broker takes its topic again. All others wait
/// for an operator, for the message itself is at fault.
inline bool is_retried(int code, std::uint32_t tries) {
  return code == 0 ? tries < losses_that_convict : !Refusal{code, {}}.is_permanent();
}

/// What the dead letters take on disk; it counts against `store.max_bytes`.
struct DeadLetterCounts {
  std::size_t count = 0;
  std::uint64_t bytes = 0;  ///< sum of stored_cost()
  bool operator==(const DeadLetterCounts&) const = default;
};

/// One transaction: all of it is durable when StoreWritten comes, nothing of it when
/// StoreWriteFailed comes. `keep` comes before the others; unknown rows in `forget` and
/// `dead_letters` are no error.
struct WriteToStore {
  std::uint64_t generation = 0;
  std::vector<StoredMessage> keep;
  std::vector<std::uint64_t> forget;
  std::vector<NewDeadLetter> dead_letters = {};
};
/// The first messages with rows above `after`, at most `max_messages` and about `max_bytes`, but
/// one if there is one.
struct LoadFromStore {
  std::uint64_t generation = 0;
  std::uint64_t after = 0;
  std::size_t max_messages = 0;
  std::size_t max_bytes = 0;
};
/// The first dead letters of `topic` that are retried (is_retried) become messages again, which
/// DeadLettersRevived answers. First come those that have lost a connection (code 0 and one try),
/// so that none hides behind others; then the oldest.
struct RetryDeadLetters {
  std::uint64_t generation = 0;
  std::string topic;
  std::size_t max_letters = 0;
};

/// A topic of which there are dead letters that are retried.
struct DeadTopic {
  std::string topic;
  Refusal refusal;
  std::size_t count = 0;
};

/// There is a store and this is what it holds. Comes again when a store had to begin anew (then it
/// holds nothing), or could be opened after all.
struct StoreOpened {
  std::uint64_t last_row = 0;
  std::size_t count = 0;
  std::uint64_t bytes = 0;  ///< sum of stored_cost()
  Duration oldest_age{};
  TopicCounts topics;
  StoreShares shares = {};
  DeadLetterCounts dead_letters;
  /// At most `max_dead_topics`.
  std::vector<DeadTopic> dead_topics = {};

  static constexpr std::size_t max_dead_topics = 1024;
};
/// There is no store for now; the shell has logged `why`.
struct StoreAbsent {
  std::string why;
};
struct StoreWritten {};
struct StoreWriteFailed {
  std::string why;
};
/// By rising row; both empty when there is none above `after`.
struct StoreLoaded {
  std::vector<StoredMessage> messages;
  /// Rows that are not what was stored: they are lost, and no longer among the messages.
  std::vector<std::uint64_t> damaged = {};
  std::uint64_t damaged_bytes = 0;  ///< sum of their stored_cost()
};
struct StoreLoadFailed {
  std::string why;
};
/// Damage has taken messages, or dead letters: `count` at most, as `text` says to people.
struct MessagesLost {
  std::size_t count = 0;
  std::string text;
};
/// Comes after each change of them: there is another one, or one was discarded.
struct DeadLettersChanged {
  DeadLetterCounts dead_letters;
};
/// A dead letter that is a message again, under its old row.
struct RevivedMessage {
  std::uint64_t row = 0;
  std::string topic;
  std::uint64_t bytes = 0;  ///< its stored_cost()
};
/// As the outbox or an operator has asked.
struct DeadLettersRevived {
  std::vector<RevivedMessage> messages;
  /// Of RetryDeadLetters: its topic; then `messages` is empty when there is none.
  std::string retried_topic = {};
  std::string why_failed = {};  ///< the disk does not take it; they are dead letters still
};
using StoreEvent =
    std::variant<StoreOpened, StoreAbsent, StoreWritten, StoreWriteFailed, StoreLoaded,
                 StoreLoadFailed, MessagesLost, DeadLettersChanged, DeadLettersRevived, Notice>;

/// What a message takes on disk at most, as counted against `store.max_bytes`.
inline std::uint64_t stored_cost(std::size_t topic_bytes, std::size_t payload_bytes) {
  constexpr std::size_t overhead = 64;  // a record's header and fields, and its erasure
  return topic_bytes + payload_bytes + overhead;
}

}  // namespace slamgw
