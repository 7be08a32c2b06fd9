// SPDX-License-Identifier: Apache-2.0
// Topics whose messages the broker does not take for now. Other topics do not wait for them. A
// message of such a topic becomes a dead letter, or is not acknowledged where that cannot be; after
// growing pauses one is tried. Once the broker takes it, the topic is refused no longer. Pure; part
// of the outbox.
//
//   resting -> (due) asked, for a dead letter of the topic -> trying -> resting, or gone
//
// Brokers also close the connection in place of refusing: Mosquitto for a packet that is too large,
// NATS for a `.` in a topic. Then one must find out for which message. Only what the broker had not
// answered can be the cause, and what was unanswered at two losses in a row is accused. An accused
// topic goes alone, so that a connection which is lost meanwhile is the fault of no other.
//
// Some brokers close the connection after each refusal, which costs all robots. So a robot's other
// topics, but for those that the broker took last time, count as refused there and are tried one by
// one. Else a robot with a hundred forbidden topics would cost as many connections.
#pragma once

#include <bitset>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/core/time.hpp"
#include "daemon/delivery/backlog.hpp"
#include "daemon/delivery/message_store.hpp"
#include "daemon/delivery/publish_window.hpp"

namespace slamgw {

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
  /// Number of dead letters in one request, once the broker accepts their topic again.
  static constexpr std::size_t resend_page = 64;
  /// QoS 0 that was written, which has no answer: more than a broker is sent in the time that
  /// its closing takes to arrive, as a rule.
  static constexpr std::size_t most_written = 64;
  /// Two losses that lie further apart have nothing to do with each other.
  static constexpr std::chrono::hours longest_between{1};
  /// A connection that ends earlier says little about the message that was under way.
  static constexpr std::chrono::seconds stable_after{1};
  /// Between requests to a store that fails.
  static constexpr std::chrono::seconds store_pause{10};
  /// A loss so soon after a refusal is its consequence.
  static constexpr std::chrono::seconds refusal_to_loss{1};
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
  /// May the message `row` of `topic` be published now? `can_ask`: there is a store, so that a dead
  /// letter goes first.
  Turn turn_of(std::string_view topic, std::uint64_t row, bool can_ask, TimePoint now) const;
  /// Only of a refused topic.
  const Refusal& reason(std::string_view topic) const { return find(topic)->refusal; }
  std::uint32_t tries(std::string_view topic) const {
    const Topic* const known = find(topic);
    return known ? known->tries : 1;
  }

  /// Why the broker is taken to refuse `topic`, of a robot with a refusal that cost the connection;
  /// null: there is no reason to.
  const Refusal* refusal_of_flow(std::string_view topic) const {
    if (flows_.empty() || taken_.test(TopicCounts::slot(topic))) return nullptr;
    const auto flow = flows_.find(TopicCounts::slot(flow_of(topic)));
    return flow == flows_.end() ? nullptr : &flow->second;
  }

  void on_published(std::string_view topic);
  /// QoS 0 went to the network. `sequence` as in PublishAtBroker.
  void on_written(std::uint64_t sequence, std::string topic);
  /// The broker has answered it, and so has read all that was sent before it.
  void on_answered(std::uint64_t sequence);
  /// The broker has accepted a message. Returns true when the topic was refused until now: its dead
  /// letters follow, page by page, as long as it is not refused again.
  bool on_accepted(const std::string& topic, TimePoint now);
  /// The broker has refused a message. Returns true when topic or reason are new.
  bool on_refused(const std::string& topic, const Refusal& refusal, TimePoint now);
  /// The topic is refused from now on, also without an answer. Returns true as on_refused().
  bool refuse(const std::string& topic, const Refusal& refusal, TimePoint now);
  /// The try says nothing about the topic, or could not be made; the next one is in `pause`.
  void on_not_tried(std::string_view topic, Duration pause, TimePoint now);
  /// Records that a message of `topic` became a dead letter.
  void on_dead_letter(std::string_view topic);

  void on_link_up(TimePoint now);
  /// The connection is lost: was it for a refusal? Refusals have to be rare then, so nothing is
  /// tried for a while, which grows until a message is accepted.
  bool on_loss_after_refusal(TimePoint now);
  /// It is lost for another reason, with these messages unanswered.
  void on_loss(const PublishWindow::Items& unanswered, TimePoint now);
  /// It is lost while a message of `topic` was under way alone. Returns true when the message is at
  /// fault: it is the second loss, the broker has answered other messages in between, and the
  /// connection was no short one, as those on a bad line are.
  bool on_lost_alone(const std::string& topic, TimePoint now);
  /// After one of these: tries under way will not be answered.
  void on_link_down(TimePoint now);

  /// What the store is to be asked for now, until there is nothing. It is asked only when it was
  /// given all dead letters, for it answers in order.
  std::optional<RetryDeadLetters> next_to_ask(const Backlog& backlog, TimePoint now);
  void on_revived(const DeadLettersRevived& revived, TimePoint now);
  /// An operator has made a message of a dead letter of `topic`: it is tried at once.
  void on_resent(std::string_view topic, TimePoint now);
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
    std::size_t asked_of = 0;  // `waiting` at the last request
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
  struct Written {
    std::uint64_t sequence = 0;
    std::string topic;
  };
  struct LastRefusal {
    std::string topic;
    Refusal refusal;
    TimePoint at{};
  };
  /// A topic that the broker takes again.
  struct Accepted {
    std::string topic;
    bool is_asked = false;
    TimePoint due{};  // of the next request, when the store has failed
  };

  Topic* find(std::string_view topic);
  const Topic* find(std::string_view topic) const;
  Topic* find_or_add(const std::string& topic, TimePoint now);
  bool may_try(TimePoint now) const;
  void grow_pause(Topic& topic, Duration longest, TimePoint now);
  static bool is_over(const Topic& topic, TimePoint now);
  void rest(Topic& topic, TimePoint due);
  void rest_all(TimePoint now);
  void put_off_tries(TimePoint now);
  void accuse(const std::string& topic, TimePoint now);
  void drop_oldest_written();
  const std::string* next_try(bool can_ask, TimePoint now);
  void on_letter(Topic& topic, std::uint64_t row, TimePoint now);

  Topics topics_;
  std::vector<Accepted> accepted_;
  std::size_t busy_ = 0;                    // asked or trying
  Duration caution_{};                      // the last time by which tries were put off
  std::optional<TimePoint> tries_put_off_;  // until then
  std::optional<TimePoint> wake_;

  std::uint64_t answers_ = 0;                                 // of the broker
  std::deque<Written, RecyclingAllocator<Written>> written_;  // after the last answer, in order
  std::set<std::string> last_unanswered_;
  TimePoint last_loss_{};
  TimePoint up_since_{};
  std::optional<LastRefusal> last_refusal_;         // of this connection
  std::unordered_map<std::size_t, Refusal> flows_;  // by slot, so there are few
  std::bitset<TopicCounts::slots> taken_;           // the broker's last answer for these topics
};

}  // namespace slamgw
