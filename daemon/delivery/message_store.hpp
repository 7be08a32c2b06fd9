// SPDX-License-Identifier: Apache-2.0
// The border between the outbox and the store of undelivered messages on disk: three requests, and
// the events that answer them. DiskStore is behind it in the daemon, a fake with state in tests.
// Events come in the order of the requests, on the loop's thread, never from inside a request. The
// first event is StoreOpened, or StoreAbsent when the store cannot be opened yet. Requests come
// after StoreOpened only, because a store that is open stays open.
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

/// Counts messages by topic in bounded memory: one counter for each hash of a topic, stored only
/// while it is not zero. Topics with the same hash share a counter, so has() may return true for
/// another topic's messages, which only costs a detour through the store. Used by the backlog.
class TopicCounts {
 public:
  /// A thousand robots with three topics each rarely share a slot.
  static constexpr std::size_t slots = 65536;

  static std::size_t slot(std::string_view topic) {
    return std::hash<std::string_view>{}(topic) % slots;
  }

  void add(std::string_view topic) { ++counts_[slot(topic)]; }
  /// Call only for a message that was added.
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

/// Returns the flow of a topic, which is the part before its last level: all types of one robot are
/// one flow.
inline std::string_view flow_of(std::string_view topic) {
  return topic.substr(0, topic.rfind('/'));
}

/// Bytes of each flow in the store, dead letters too, so that no flow takes all of it. Memory is
/// bounded as in TopicCounts: flows whose names share a slot share one limit. Used by the backlog.
class StoreShares {
 public:
  struct Share {
    std::string flow;
    std::uint64_t bytes = 0;
  };
  /// The robots that one gateway knows rarely share a slot.
  static constexpr std::size_t slots = 65536;

  void add(std::string_view topic, std::uint64_t bytes) {
    Share& share = shares_[slot(topic)];
    if (share.bytes == 0) share.flow = flow_of(topic);
    share.bytes += bytes;
  }
  /// Removes what was added before; a larger number removes the whole share.
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
  /// Visits every share.
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

/// A stored message becomes a dead letter, which is not among the messages. It stays on disk, with
/// its row and age, until it is a message again or an operator discards it.
struct NewDeadLetter {
  std::uint64_t row = 0;    ///< stored, or among `keep` of the same request
  std::string reason;       ///< for people: "topic name invalid"
  int code = 0;             ///< MQTT 5 reason code of the refusal; 0: the connection was lost
  std::uint32_t tries = 0;  ///< how often it was published without success
};

/// After this many losses of the connection with a message alone under way, the message is at
/// fault.
inline constexpr std::uint32_t losses_at_fault = 2;

/// Returns true when a dead letter is retried by itself once the broker accepts its topic again.
/// All others wait for an operator, because the message itself is at fault.
inline bool is_retried(int code, std::uint32_t tries) {
  return code == 0 ? tries < losses_at_fault : !Refusal{code, {}}.is_permanent();
}

/// Number and size of the dead letters on disk; the size counts against `store.max_bytes`.
struct DeadLetterCounts {
  std::size_t count = 0;
  std::uint64_t bytes = 0;  ///< sum of stored_cost()
  bool operator==(const DeadLetterCounts&) const = default;
};

/// One transaction: all of it is durable when StoreWritten comes, nothing of it when
/// StoreWriteFailed comes. `keep` is carried out before the others; unknown rows in `forget` and
/// `dead_letters` are not an error.
struct WriteToStore {
  std::vector<StoredMessage> keep;
  std::vector<std::uint64_t> forget;
  std::vector<NewDeadLetter> dead_letters = {};
};
/// Requests the first messages with rows above `after`: at most `max_messages` and about
/// `max_bytes`, but at least one message if there is one.
struct LoadFromStore {
  std::uint64_t after = 0;
  std::size_t max_messages = 0;
  std::size_t max_bytes = 0;
};
/// Turns the first dead letters of `topic` that are retried (is_retried) into messages again;
/// DeadLettersRevived is the answer. Letters that have lost a connection (code 0 and one try) come
/// first, so that none hides behind others; then the oldest.
struct RetryDeadLetters {
  std::string topic;
  std::size_t max_letters = 0;
};
using StoreRequest = std::variant<WriteToStore, LoadFromStore, RetryDeadLetters>;

/// A topic with dead letters that are retried.
struct DeadTopic {
  std::string topic;
  Refusal refusal;
  std::size_t count = 0;
};

/// The store is open and has these contents. Comes once.
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

  /// As many as RefusedTopics remembers; letters of further topics wait for the next start.
  static constexpr std::size_t max_dead_topics = 4096;
};
/// The store cannot be opened yet; the shell has logged `why`. Comes once at most.
struct StoreAbsent {
  std::string why;
};
struct StoreWritten {};
struct StoreWriteFailed {
  std::string why;
};
/// Messages by rising row; both lists are empty when there is no row above `after`.
struct StoreLoaded {
  std::vector<StoredMessage> messages;
  /// Rows whose contents were damaged: they are lost, and no longer among the messages.
  std::vector<std::uint64_t> damaged = {};
  std::uint64_t damaged_bytes = 0;  ///< sum of their stored_cost()
};
struct StoreLoadFailed {
  std::string why;
};
/// Damage has destroyed at most `count` messages or dead letters; `text` is the line for the log.
struct MessagesLost {
  std::size_t count = 0;
  std::string text;
};
/// A message that is no longer a dead letter. It has its old row.
struct FormerLetter {
  std::uint64_t row = 0;
  std::string topic;
  std::uint64_t bytes = 0;   ///< its stored_cost()
  bool was_retried = false;  ///< is_retried()
};
/// Comes whenever the number of dead letters has changed, and after each write of dead letters:
/// damage may have taken some of them.
struct DeadLettersChanged {
  DeadLetterCounts dead_letters;
  std::vector<FormerLetter> discarded = {};
};
/// Answers the outbox (RetryDeadLetters), or reports what an operator has revived.
struct DeadLettersRevived {
  std::vector<FormerLetter> messages;
  /// The topic of RetryDeadLetters, which found no letter when `messages` is empty. Empty after an
  /// operator's request.
  std::string retried_topic = {};
  std::string why_failed = {};  ///< the disk's error; the letters are still dead letters
};
using StoreEvent =
    std::variant<StoreOpened, StoreAbsent, StoreWritten, StoreWriteFailed, StoreLoaded,
                 StoreLoadFailed, MessagesLost, DeadLettersChanged, DeadLettersRevived, Notice>;

/// Returns the bytes that a message takes on disk at most, as counted against `store.max_bytes`.
inline std::uint64_t stored_cost(std::size_t topic_bytes, std::size_t payload_bytes) {
  constexpr std::size_t overhead = 64;  // a record's header and fields, and its erasure
  return topic_bytes + payload_bytes + overhead;
}

}  // namespace slamgw
