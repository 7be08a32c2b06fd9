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

/// Returns the flow of a topic, which is the part before its last level: all types of one robot are
/// one flow.
inline std::string_view flow_of(std::string_view topic) {
  return topic.substr(0, topic.rfind('/'));
}

/// Sums by name in bounded memory: one for each hash of a name, stored only while it is not zero.
/// Names with the same hash share a sum. Used by the backlog for messages by topic, where a sum of
/// another topic only costs a detour through the store, and for bytes by flow.
class SlotSums {
 public:
  struct Sum {
    std::string name;
    std::uint64_t value = 0;
  };
  /// A thousand robots with three topics each rarely share a slot.
  static constexpr std::size_t slots = 65536;

  static std::size_t slot(std::string_view name) {
    return std::hash<std::string_view>{}(name) % slots;
  }

  void add(std::string_view name, std::uint64_t value) { sums_[slot(name)].value += value; }
  /// Also keeps the name, for largest().
  void add_named(std::string_view name, std::uint64_t value) {
    Sum& sum = sums_[slot(name)];
    if (sum.value == 0) sum.name = name;
    sum.value += value;
  }
  /// Removes what was added before; a larger number removes the whole sum.
  void remove(std::string_view name, std::uint64_t value) {
    const auto sum = sums_.find(slot(name));
    if (sum == sums_.end()) return;
    sum->second.value -= std::min(sum->second.value, value);
    if (sum->second.value == 0) sums_.erase(sum);
  }
  std::uint64_t of(std::string_view name) const {
    if (sums_.empty()) return 0;
    const auto sum = sums_.find(slot(name));
    return sum == sums_.end() ? 0 : sum->second.value;
  }
  /// Visits every sum.
  Sum largest() const {
    Sum largest;
    for (const auto& [slot, sum] : sums_)
      if (sum.value > largest.value) largest = sum;
    return largest;
  }

 private:
  std::unordered_map<std::size_t, Sum> sums_;  // by slot; none is 0
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
  std::uint64_t bytes = 0;  ///< its stored_cost()
  std::string topic = {};   ///< in case the disk cannot read it
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
/// `dead_letters` are not an error. `forget` alone needs no room on the disk.
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
  SlotSums topics;       ///< messages by topic
  SlotSums shares = {};  ///< bytes by flow, dead letters too
  DeadLetterCounts dead_letters;
  /// At most `max_dead_topics`.
  std::vector<DeadTopic> dead_topics = {};
  /// Not empty: the store can be read, but not be written yet.
  std::string why_read_only = {};

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
inline std::uint64_t stored_cost(const BrokerMessage& message) {
  return stored_cost(message.topic.size(), message.payload.size());
}

}  // namespace slamgw
