// SPDX-License-Identifier: Apache-2.0
// Topics whose messages the broker does not take for now. Other topics do not wait for them. A
// message of such a topic becomes a dead letter, or is not acknowledged where that cannot be; after
// growing pauses one is tried. Once the broker takes it, the topic is refused no longer. Pure; part
// of the outbox.
//
//   resting -> (due) asked, for a dead letter of the topic -> trying -> resting, or gone
//
// Brokers also close the connection in place of refusing: Mosquitto for a packet that is too large,
// NATS for a `.` in a topic. Then one must find out for which message: see LossCauses. A topic that
// is accused goes alone, so that a connection which is lost meanwhile is the fault of no other.
#pragma once

#include <bitset>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <unordered_map>
#include <utility>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/core/time.hpp"
#include "daemon/delivery/message_store.hpp"
#include "daemon/delivery/publish_window.hpp"

namespace slamgw {

/// For which topics a broker may have closed the connection. Only what it had not answered can be
/// the cause, and what was unanswered at two losses in a row is accused. Pure; part of the outbox.
class LossCauses {
 public:
  /// QoS 0 that was written, which has no answer: more than a broker is sent in the time that
  /// its closing takes to arrive, as a rule.
  static constexpr std::size_t most_written = 64;
  /// Two losses that lie further apart have nothing to do with each other.
  static constexpr std::chrono::hours longest_between{1};
  /// Debian 12's Mosquitto closes the connection after each PUBACK that refuses.
  static constexpr std::chrono::seconds refusal_to_loss{1};

  struct Refused {
    std::string topic;
    Refusal refusal;
    TimePoint at{};
  };

  /// QoS 0 went to the network. `sequence` as in PublishAtBroker.
  void on_written(std::uint64_t sequence, std::string topic);
  /// The broker has answered it, and so has read all that was sent before it.
  void on_answered(std::uint64_t sequence);
  void on_refused(Refused refused) { refused_ = std::move(refused); }
  /// The refusal for which the broker has closed the connection; null: there was none.
  const Refused* explanation(TimePoint now) const {
    return refused_ && now - refused_->at < refusal_to_loss ? &*refused_ : nullptr;
  }
  /// The connection is lost, and nothing explains it. Returns the topics that were unanswered at
  /// the loss before too.
  std::vector<std::string> on_loss(const PublishWindow::Items& unanswered, TimePoint now);
  /// Forgets what was written to the old connection.
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
  std::optional<Refused> refused_;  // the last one of this connection
};

/// Robots of which the broker has refused a topic and then closed the connection, as Debian 12's
/// Mosquitto does after each refusal. Every refusal costs all robots the connection; so a robot's
/// other topics, but for those that the broker took last time, count as refused and are tried one
/// by one. Else a robot with a hundred forbidden topics would cost a hundred connections. Pure;
/// part of the outbox.
class RefusedFlows {
 public:
  void on_accepted(std::string_view topic) { accepted_.set(TopicCounts::slot(topic)); }
  /// The broker has refused a message on `topic` and closed the connection.
  void add(std::string_view topic, const Refusal& refusal) {
    accepted_.reset(TopicCounts::slot(topic));
    flows_[slot(topic)] = {refusal.code, "another topic of this robot is: " + refusal.why};
  }
  /// Why the broker is taken to refuse `topic`; null: there is no reason to.
  const Refusal* reason(std::string_view topic) const {
    if (flows_.empty() || accepted_.test(TopicCounts::slot(topic))) return nullptr;
    const auto flow = flows_.find(slot(topic));
    return flow == flows_.end() ? nullptr : &flow->second;
  }
  /// No topic is refused any more.
  void clear() { flows_.clear(); }

 private:
  /// Two flows may share a number; so there are no more than TopicCounts::slots.
  static std::size_t slot(std::string_view topic) { return TopicCounts::slot(flow_of(topic)); }

  std::unordered_map<std::size_t, Refusal> flows_;
  std::bitset<TopicCounts::slots> accepted_;  // the broker's last answer for these topics
};

/// A refused topic, for `status`.
struct RefusedTopic {
  std::string topic;
  Refusal refusal;
  std::size_t waiting = 0;  ///< dead letters of it that will be retried
  std::uint32_t tries = 0;  ///< consecutive failed tries
  TimePoint since{};
};

class RefusedTopics {
 public:
  static constexpr std::chrono::seconds first_pause{1};
  static constexpr std::chrono::seconds longest_pause{60};
  /// Of a topic for which the broker closes the connection of all: each try is one more closing.
  static constexpr std::chrono::hours longest_closing_pause{1};
  /// A topic without new messages and without dead letters is forgotten after this time.
  static constexpr std::chrono::hours forgotten_after{2};
  /// Tries at once; one while the broker closes the connection for them.
  static constexpr std::size_t most_tries = 4;
  /// Further topics are not remembered: their messages are refused by the broker one by one.
  static constexpr std::size_t max_topics = 4096;

  enum class Turn : std::uint8_t {
    open,   ///< as all others: it is not refused
    rest,   ///< not now
    next,   ///< it is the try
    alone,  ///< so that nothing else is under way with it
  };

  bool empty() const { return topics_.empty(); }
  bool has(std::string_view topic) const { return find(topic) != nullptr; }
  /// May a message of `topic` be published now? `row`: in the store, 0: none. `can_ask`: there is a
  /// store, so that a dead letter goes first.
  Turn turn_of(std::string_view topic, std::uint64_t row, bool can_ask, TimePoint now) const;
  /// Only of a refused topic.
  const Refusal& reason(std::string_view topic) const { return find(topic)->refusal; }
  std::uint32_t tries(std::string_view topic) const {
    const Topic* const known = find(topic);
    return known ? known->tries : 1;
  }

  /// The broker has refused a message, or is taken to refuse it. True when topic or reason are new.
  bool on_refused(const std::string& topic, const Refusal& refusal, TimePoint now);
  /// The connection was lost twice with a message of it unanswered.
  void accuse(const std::string& topic, TimePoint now);
  /// The connection was lost while a message of `topic` was under way alone. Returns true when the
  /// message is at fault: it is the second loss, and the broker has answered other messages in
  /// between. `answers`: the number of its answers so far.
  bool on_lost_alone(const std::string& topic, std::uint64_t answers, TimePoint now);
  /// The broker closes the connection after a refusal, so refusals have to be rare: nothing is
  /// tried for a while, which grows until a message is accepted.
  void on_loss_after_refusal(TimePoint now) { put_off_tries(now); }
  void on_published(std::string_view topic);
  /// The broker has accepted a message. Returns true when the topic was refused until now.
  bool on_accepted(std::string_view topic, TimePoint now);
  /// The try says nothing about the topic, or could not be made; the next one is in `pause`.
  void on_not_tried(std::string_view topic, Duration pause, TimePoint now);
  /// Records that a message of `topic` became a dead letter.
  void on_dead_letter(std::string_view topic);

  /// The topic of which a dead letter is to be asked for now. Answered by on_letter().
  std::optional<std::string> next_to_ask(bool can_ask, TimePoint now);
  /// `row`: where the letter is stored again; 0: there is none.
  void on_letter(std::string_view topic, std::uint64_t row, TimePoint now);

  /// Tries under way will not be answered.
  void on_link_down(TimePoint now);
  /// Takes over the dead topics of a newly opened store.
  void on_store_changed(std::vector<DeadTopic> dead_topics, TimePoint now);
  /// The store has lost messages, perhaps a requested dead letter.
  void on_rows_lost(TimePoint now) { rest_all(now); }

  /// When next_to_ask() or turn_of() may have something new.
  std::optional<TimePoint> deadline() const { return wake_; }
  bool is_wake_due(TimePoint now) const { return wake_ && now >= *wake_; }

  /// Returns at most `most` refused topics, without those that are only accused.
  std::vector<RefusedTopic> list(std::size_t most) const;
  /// Returns the number of refused topics.
  std::size_t count() const;

 private:
  enum class Phase : std::uint8_t { resting, asked, trying };
  struct Topic {
    Refusal refusal;
    std::uint32_t tries = 0;  // 0: it is accused
    std::size_t waiting = 0;
    TimePoint since{};
    Duration pause{};
    TimePoint due{};  // of the next try; since when it is accused
    Phase phase = Phase::resting;
    std::uint64_t row = 0;              // of the letter that was asked for
    std::uint32_t losses = 0;           // of the connection while one was alone, in a row
    std::uint64_t answers_at_loss = 0;  // at the first of them
    bool is_accused() const { return tries == 0; }
  };
  using Topics = std::map<std::string, Topic, std::less<>>;

  Topic* find(std::string_view topic);
  const Topic* find(std::string_view topic) const;
  Topic* find_or_add(const std::string& topic, TimePoint now);
  bool may_try(TimePoint now) const;
  void grow_pause(Topic& topic, Duration longest, TimePoint now);
  static bool is_over(const Topic& topic, TimePoint now);
  void rest(Topic& topic, TimePoint due);
  void rest_all(TimePoint now);
  void put_off_tries(TimePoint now);

  Topics topics_;
  std::size_t busy_ = 0;                    // asked or trying
  Duration caution_{};                      // the last time by which tries were put off
  std::optional<TimePoint> tries_put_off_;  // until then
  std::optional<TimePoint> wake_;
};

}  // namespace slamgw
