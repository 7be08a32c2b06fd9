// SPDX-License-Identifier: Apache-2.0
// Topics whose messages the broker does not take for now. Other topics do not wait for them. The
// oldest message of each is tried again after growing pauses, one at a time, which keeps the order.
// Messages on disk stay there: only their rows are known here. Pure; part of the outbox.
//
//   paused -> wanting (a row is to be loaded) -> loading -> runnable -> waiting (for the answer)
//
// Refused, the topic pauses again. Accepted, it goes on at wanting or runnable until nothing of it
// is left here; then it is held no longer. Two topics may share a slot of TopicCounts, and then are
// held together.
//
// A suspect (ConnectionSuspects) is held until a message of it was answered. Its messages are tried
// alone, so that a connection that is lost meanwhile accuses this message and no other. Without
// messages it is idle, and the next one that comes is tried.
#pragma once

#include <bitset>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <unordered_map>
#include <utility>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/core/protocol_machine.hpp"
#include "daemon/core/time.hpp"
#include "daemon/delivery/message_store.hpp"
#include "daemon/delivery/publish_window.hpp"

namespace slamgw {

/// Which topics a broker may have closed the connection for. Brokers close it in place of refusing:
/// Mosquitto for a packet that is too large, NATS for a `.` in a topic. Only what the broker had
/// not answered can be the cause, and who was unanswered at two losses in a row is a suspect;
/// HeldTopics tries suspects alone. Pure; part of the outbox.
class ConnectionSuspects {
 public:
  /// QoS 0 that was written, which has no answer: more than a broker is sent in the time that
  /// its closing takes to arrive, as a rule.
  static constexpr std::size_t most_written = 64;
  /// Two losses that lie further apart have nothing to do with each other.
  static constexpr std::chrono::hours longest_between{1};
  /// Debian 12's Mosquitto closes the connection after each PUBACK that refuses.
  static constexpr std::chrono::seconds refusal_to_loss{1};

  /// QoS 0 went to the network. `sequence` as in PublishAtBroker.
  void on_written(std::uint64_t sequence, std::string topic);
  /// The broker has answered it, and so has read all that was sent before it.
  void on_answered(std::uint64_t sequence);
  struct Refused {
    std::string topic;
    Refusal refusal;
    TimePoint at{};
  };
  void on_refused(Refused refused) { refused_ = std::move(refused); }
  /// The refusal for which the broker has closed the connection; null: there was none.
  const Refused* explanation(TimePoint now) const {
    return refused_ && now - refused_->at < refusal_to_loss ? &*refused_ : nullptr;
  }
  /// The connection is lost, and nothing explains it. Returns the topics that were unanswered at
  /// the loss before too.
  std::vector<std::string> on_loss(const OutboxEntries& unanswered, TimePoint now);
  /// A new connection: what was written to the old one is the past.
  void on_link_up();

 private:
  struct Written {
    std::uint64_t sequence = 0;
    std::string topic;
  };

  void drop_oldest();

  std::deque<Written, RecyclingAllocator<Written>>
      written_;  // by rising sequence, after the last answer
  std::set<std::string> last_unanswered_;
  TimePoint last_loss_{};
  std::optional<Refused> refused_;  ///< the last one of this connection
};

/// Robots of which the broker has refused a topic and then closed the connection, as Debian 12's
/// Mosquitto does after each refusal. Every refusal costs all robots the connection; so a robot's
/// other topics, but for those that the broker took last time, are held as if refused and tried one
/// by one. Else a robot with a hundred forbidden topics would cost a hundred connections. A flow is
/// as in FairQueue: what a topic has in front of its last level. Pure; part of the outbox.
class DoubtedFlows {
 public:
  void on_accepted(std::string_view topic) { accepted_.set(TopicCounts::slot(topic)); }
  /// The broker has refused a message on `topic` and closed the connection.
  void add(std::string_view topic, const Refusal& refusal) {
    accepted_.reset(TopicCounts::slot(topic));
    flows_[flow_of(topic)] = {refusal.code, "another topic of this robot is: " + refusal.why};
  }
  /// Why the broker is taken to refuse `topic`; null: there is no reason to.
  const Refusal* reason(std::string_view topic) const {
    if (flows_.empty() || accepted_.test(TopicCounts::slot(topic))) return nullptr;
    const auto doubted = flows_.find(flow_of(topic));
    return doubted == flows_.end() ? nullptr : &doubted->second;
  }
  /// No topic is refused any more.
  void clear() { flows_.clear(); }

 private:
  /// Two flows may share a number; so there are no more than TopicCounts::slots.
  static std::size_t flow_of(std::string_view topic) {
    return TopicCounts::slot(topic.substr(0, topic.rfind('/')));
  }

  std::unordered_map<std::size_t, Refusal> flows_;
  std::bitset<TopicCounts::slots> accepted_;  // the broker's last answer for these topics
};

/// A held topic, for `status`.
struct HeldTopic {
  std::string topic;
  Refusal refusal;
  std::size_t waiting = 0;  ///< messages, as far as the backlog was read
  std::uint32_t tries = 0;
  TimePoint since{};
};

class HeldTopics {
 public:
  static constexpr std::chrono::seconds first_pause{1};
  static constexpr std::chrono::seconds longest_pause{60};
  /// Of a topic for which the broker closes the connection of all: each try is one more closing.
  static constexpr std::chrono::hours longest_pause_of_suspect{1};
  /// An idle suspect is forgotten after this time.
  static constexpr std::chrono::hours suspicion_lasts{2};
  /// How long the whole link waits for the answer to a suspect's message.
  static constexpr std::chrono::seconds trial_patience{5};
  /// Rows of an accepted topic that are loaded together.
  static constexpr std::size_t rows_at_once = 32;

  /// `stored`: topics of which messages are on disk, or on their way there or back.
  explicit HeldTopics(const TopicCounts& stored) : stored_(stored) {}

  bool empty() const { return lanes_.empty(); }
  bool has(std::string_view topic) const {
    return !lanes_.empty() && lanes_.contains(TopicCounts::slot(topic));
  }

  /// A message of `topic` was refused; `under_way` more of it are not answered yet. True when the
  /// topic or the reason are new.
  bool hold(const std::string& topic, const Refusal& refusal, std::size_t under_way, TimePoint now);
  /// The connection was lost twice with messages of `topic` unanswered. True when it was not held.
  bool suspect(const std::string& topic, TimePoint now);
  /// The connection was lost while the oldest message of the suspect `topic` was under way alone.
  /// True when that convicts the message: it has happened twice in a row, and the broker has
  /// answered others meanwhile. The next message is judged by itself. `answers`: how many the
  /// broker has given so far.
  bool on_lost_alone(const std::string& topic, std::uint64_t answers, TimePoint now);
  /// QoS 0 never waits: a suspect without messages takes the next one for its trial, after those
  /// that have messages.
  bool wants_probe(std::string_view topic) const;
  /// The broker closes the connection after a refusal, so refusals have to be rare: nothing is
  /// tried for a while, which grows until a message is accepted.
  void on_loss_after_refusal(TimePoint now) { put_off_tries(now); }
  /// Closings were the answer to tries, so one is tried at a time.
  bool is_cautious() const { return caution_ > Duration::zero(); }
  /// Of a held topic: how often it was refused in a row.
  std::uint32_t tries(std::string_view topic) const {
    return lanes_.at(TopicCounts::slot(topic)).tries;
  }

  /// Of a held topic: a message on disk. Rows may come in any order.
  void add_row(std::string_view topic, std::uint64_t row);
  /// Of a held topic: a message of QoS 1 or 2 in memory only. Goes after those on disk, in the
  /// order of submission.
  void add(OutboxEntry entry);
  /// All that are in memory only, to find their places anew.
  OutboxEntries take_unstored();
  std::size_t unstored() const;
  std::size_t unstored_bytes() const { return unstored_bytes_; }

  /// The rows that are to be loaded now, rising; empty when there are none.
  std::vector<std::uint64_t> rows_to_load(std::size_t most);
  /// The answer to the last rows_to_load(). Returns the topic of each row that is not in the store
  /// (any more).
  std::vector<std::string> on_loaded(StoreLoaded loaded, TimePoint now);
  void on_load_failed();
  /// Another store: rows mean nothing any more. Returns what was loaded from the former one.
  OutboxEntries on_store_opened(TimePoint now);

  /// Counts all that are on disk, in `counts`.
  void count_stored(TopicCounts& counts) const;

  /// What is to be tried next; null while there is nothing.
  const OutboxEntry* next(TimePoint now);
  /// Whether that is a suspect's message.
  bool is_next_suspect() const { return lanes_.at(runnable_.front()).is_suspect; }
  /// Only while next() is not null.
  OutboxEntry take_next();
  /// What is under way does not end, so this suspect cannot be tried alone for now.
  void put_off_next(TimePoint now);

  /// `neither`: it says nothing about the topic (QoS 0, or this message alone can't be taken);
  /// after `refused` comes hold().
  enum class Answer : std::uint8_t { accepted, refused, neither };
  /// A message was handed to the broker, and was answered, from memory or disk. Of topics that
  /// are not held nothing happens. True when it is the first that was accepted.
  void on_published(std::string_view topic);
  bool on_answered(std::string_view topic, Answer answer);
  /// The next message of a topic that is no longer held, from those that were only in memory.
  std::optional<OutboxEntry> take_released() {
    if (released_.empty()) return std::nullopt;
    std::optional<OutboxEntry> first(std::move(released_.front()));
    released_.pop_front();
    return first;
  }

  void on_link_down();
  /// Pauses go on: Debian 12's Mosquitto closes the connection after each PUBACK that refuses, and
  /// would close the new one too.
  void on_link_up(TimePoint now);

  std::optional<TimePoint> deadline() const {
    const auto pause = pauses_.empty() ? std::nullopt : std::optional(pauses_.begin()->first);
    return earlier(pause, tries_put_off_);
  }
  void on_deadline(TimePoint now);

  /// At most `most` of them; suspects against which there is no evidence yet are left out.
  std::vector<HeldTopic> list(std::size_t most) const;
  /// How many there are of those.
  std::size_t refused() const;

 private:
  using Slot = std::size_t;  // TopicCounts::slot
  enum class Phase : std::uint8_t {
    paused,    ///< in pauses_
    wanting,   ///< in wanting_: its first row is to be loaded
    loading,   ///< in loading_: that was asked for
    runnable,  ///< in runnable_: its first message is in memory
    waiting,   ///< for answers to what is under way
    idle,      ///< in pauses_: a suspect without messages
  };
  struct Lane {
    std::string topic;
    Refusal refusal;
    std::uint32_t tries = 0;
    TimePoint since{};
    Duration pause{};
    Phase phase = Phase::waiting;
    TimePoint due{};           ///< while paused
    bool is_accepted = false;  ///< the broker has taken a message since
    bool is_suspect = false;
    TimePoint suspected{};              ///< last
    std::uint32_t losses = 0;           ///< in a row, while its oldest message was alone
    std::uint64_t answers_at_loss = 0;  ///< at the first of them
    std::size_t under_way = 0;
    std::deque<std::uint64_t> rows;  ///< on disk, rising
    OutboxEntries loaded;            ///< from there
    OutboxEntries unstored;          ///< in memory only
  };

  Lane* find(std::string_view topic);
  static bool is_refused(const Lane& lane) { return lane.tries > 0; }
  bool may_go(const Lane& lane) const;
  void put_off_tries(TimePoint now);
  void wait_idle(Slot slot, Lane& lane);
  void grow_pause(Slot slot, Lane& lane, Duration longest, TimePoint now);
  void pause(Slot slot, Lane& lane, TimePoint due);
  void end_pause(Slot slot, Lane& lane);
  void advance(Slot slot);
  void unload(Lane& lane);
  void end_loading();
  bool is_done(const Lane& lane) const;

  const TopicCounts& stored_;
  std::unordered_map<Slot, Lane> lanes_;
  std::set<std::pair<TimePoint, Slot>> pauses_;
  // A lane that has left the phase is passed over.
  std::deque<Slot> wanting_;
  std::deque<Slot> runnable_;
  std::vector<std::uint64_t> loading_;  // rows, rising
  std::vector<Slot> loading_lanes_;
  Duration caution_{};                      // the last time by which tries were put off
  std::optional<TimePoint> tries_put_off_;  // of topics that were not accepted since
  std::size_t loaded_ = 0;                  // in all lanes
  std::size_t unstored_bytes_ = 0;
  OutboxEntries released_;
};

}  // namespace slamgw
