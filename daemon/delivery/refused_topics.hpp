// SPDX-License-Identifier: Apache-2.0
// Topics whose messages the broker refuses at present. Other topics do not wait for them. A message
// of such a topic becomes a dead letter; where it cannot, it is not acknowledged. After growing
// pauses one message is tried. Once the broker accepts it, the topic is no longer refused. Pure;
// part of the outbox.
//
//   accused -> (lost alone, or refused) resting, or (accepted) gone
//   resting -> (due) trying, a dead letter of the topic or a new message -> resting, or accepted
//   accepted -> (asked for pages of dead letters, until none are left) gone
//
// Brokers also close the connection in place of refusing: Mosquitto for a packet that is too large,
// NATS for a `.` in a topic. Then the gateway must find out for which message. Only an unanswered
// message can be the cause, and a topic that was unanswered at two losses in a row is accused. A
// message of an accused topic is published alone, so that no other topic can be at fault when the
// connection is lost again.
//
// Some brokers close the connection after each refusal, which costs all robots. So the robot's
// other topics count as refused too, except those that the broker accepted last time, and are tried
// one by one. Otherwise a robot with a hundred forbidden topics would cost a hundred connections.
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
  std::size_t waiting = 0;  ///< messages of the topic that will be retried
  std::uint32_t tries = 0;  ///< consecutive failed tries
  TimePoint since{};
};

class RefusedTopics {
 public:
  static constexpr std::chrono::seconds first_pause{1};
  static constexpr std::chrono::seconds longest_pause{60};
  /// Longest pause of a topic for which the broker closes the connection: each try costs all robots
  /// one more connection.
  static constexpr std::chrono::hours longest_closing_pause{1};
  /// A topic without new messages and without dead letters is forgotten after this time.
  static constexpr std::chrono::hours forgotten_after{2};
  /// Limit of tries at once. While the broker closes the connection for them, the limit is one.
  static constexpr std::size_t most_tries = 4;
  /// Number of dead letters in one request, once the broker accepts their topic again.
  static constexpr std::size_t resend_page = 64;
  /// Number of written QoS 0 messages that are remembered, because they get no answer. It is
  /// usually more than the gateway writes before the broker's closing arrives.
  static constexpr std::size_t most_written = 64;
  /// A connection that ends earlier says little about the message that was under way.
  static constexpr std::chrono::seconds stable_after{1};
  /// Pause between requests to a failing store.
  static constexpr std::chrono::seconds store_pause{10};
  /// A loss within this time after a refusal is its consequence.
  static constexpr std::chrono::seconds refusal_to_loss{1};
  /// Further topics are not remembered: the broker refuses their messages one by one.
  static constexpr std::size_t max_topics = StoreOpened::max_dead_topics;

  enum class Turn : std::uint8_t {
    open,   ///< the topic is not refused
    rest,   ///< do not publish now
    next,   ///< publish, as the try of the topic
    alone,  ///< publish while nothing else is under way
  };

  bool empty() const { return topics_.empty(); }
  /// Returns whether and how the message `row` of `topic` may be published now. `can_ask`: there is
  /// a store, so that a dead letter of the topic is tried first.
  Turn turn_of(std::string_view topic, std::uint64_t row, bool can_ask, TimePoint now) const;
  /// Call only when turn_of() is not open.
  const Refusal& reason(std::string_view topic) const { return find(topic)->refusal; }
  std::uint32_t tries(std::string_view topic) const {
    const Topic* const known = find(topic);
    return known ? known->tries : 1;
  }

  /// Returns true while the store is asked for a dead letter, which is then tried.
  bool is_asked_for(std::string_view topic) const {
    const Topic* const known = find(topic);
    return known && known->asked_of;
  }

  /// Returns the reason to count `topic` as refused, when another topic of its robot has cost the
  /// connection. Returns null when there is no reason.
  const Refusal* refusal_of_flow(std::string_view topic) const {
    if (flows_.empty() || taken_.test(SlotSums::slot(topic))) return nullptr;
    const auto flow = flows_.find(SlotSums::slot(flow_of(topic)));
    return flow == flows_.end() ? nullptr : &flow->second;
  }

  /// Call when a message of `topic` was handed to the broker's client.
  void on_published(std::string_view topic);
  /// Call when a QoS 0 message was written to the network. `sequence` as in PublishAtBroker.
  void on_written(std::uint64_t sequence, std::string topic);
  /// Call when the broker has answered a message: it has read all messages sent before.
  void on_answered(std::uint64_t sequence);
  /// Call when the broker has accepted a message. Returns true when the topic was refused until
  /// now: its dead letters follow, page by page, as long as it is not refused again.
  bool on_accepted(const std::string& topic, TimePoint now);
  /// Call when the broker has refused a message. Returns true when topic or reason are new.
  bool on_refused(const std::string& topic, const Refusal& refusal, TimePoint now);
  /// Counts the topic as refused from now on, also without an answer of the broker. Returns true
  /// when topic or reason are new.
  bool refuse(const std::string& topic, const Refusal& refusal, TimePoint now);
  /// Call when a try says nothing about the topic, or was not made. The next try is after `pause`.
  void on_not_tried(std::string_view topic, Duration pause, TimePoint now);
  /// Records that a message of `topic` became a dead letter.
  void on_dead_letter(std::string_view topic);

  void on_link_up(TimePoint now);
  /// Returns true when the connection was lost right after a refusal. Then nothing is tried for a
  /// pause, which grows until a message is accepted, because each refusal costs the connection.
  bool on_loss_after_refusal(TimePoint now);
  /// Call when the connection was lost for another reason, with these messages unanswered.
  void on_loss(const PublishWindow::Items& unanswered, TimePoint now);
  /// Call when the connection was lost while a message of `topic` was under way alone, or after the
  /// broker has skipped it. Returns true when the message is at fault: this is the second loss, and
  /// the broker has answered other messages in between. Short connections, as on a bad line, do not
  /// count.
  bool on_lost_alone(const std::string& topic, const Refusal& refusal, TimePoint now);
  /// Call after one of the three above: tries under way will not be answered.
  void on_link_down(TimePoint now);

  /// Returns the next request to the store; call until there is none. The store is asked only after
  /// it was given all dead letters, because it answers in order.
  std::optional<RetryDeadLetters> next_to_ask(const Backlog& backlog, TimePoint now);
  void on_revived(const DeadLettersRevived& revived, TimePoint now);
  /// Call when an operator has discarded a dead letter, or it is lost.
  void on_taken_away(const FormerLetter& letter);
  /// Call when an operator has revived a dead letter: its topic is tried at once.
  void on_resent(const FormerLetter& letter, TimePoint now);
  /// Call when a page of the store was read: the next page of dead letters may follow.
  void on_page_read(TimePoint now) { wake_ = topics_.empty() ? wake_ : now; }
  /// Takes over the dead topics of the store.
  void on_store_opened(std::vector<DeadTopic> dead_topics, TimePoint now);
  /// Call when the store has lost messages, perhaps a requested dead letter.
  void on_rows_lost(TimePoint now);
  /// Call when the store has not taken dead letters on which requests rely.
  void on_write_failed();

  /// Returns when next_to_ask() or turn_of() may return something new.
  std::optional<TimePoint> deadline() const { return wake_; }
  bool is_wake_due(TimePoint now) const { return wake_ && now >= *wake_; }

  /// Returns at most `most` refused topics, without those that are only accused.
  std::vector<RefusedTopic> list(std::size_t most) const;
  /// Returns the number of refused topics.
  std::size_t count() const;

 private:
  enum class Phase : std::uint8_t {
    accused,   ///< its messages are published alone
    resting,   ///< until the next try
    trying,    ///< a message of the topic is under way, or the store is asked for a dead letter
    accepted,  ///< no longer refused, but dead letters are left
  };
  struct Topic {
    Phase phase = Phase::accused;
    Refusal refusal;
    std::uint32_t tries = 0;
    std::size_t waiting = 0;
    /// How many of `waiting` are gone if the store finds none; set while it is asked.
    std::optional<std::size_t> asked_of;
    TimePoint since{};
    Duration pause{};
    TimePoint due{};                    // of the next try or request; the time of an accusation
    std::uint64_t row = 0;              // of the dead letter that is tried
    std::uint32_t losses = 0;           // of the connection while a message was alone, in a row
    std::uint64_t answers_at_loss = 0;  // `answers_` at the first of these losses
    bool is_refused() const { return phase == Phase::resting || phase == Phase::trying; }
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
  Topic* find(std::string_view topic);
  const Topic* find(std::string_view topic) const;
  Topic* find_or_add(const std::string& topic, TimePoint now);
  bool may_try(TimePoint now) const;
  void enter(Topic& topic, Phase phase);
  void grow_pause(Topic& topic, Duration longest, TimePoint now);
  static bool is_over(const Topic& topic, TimePoint now);
  void rest(Topic& topic, TimePoint due);
  void accept(Topics::iterator known, TimePoint now);
  void put_off_tries(TimePoint now);
  void accuse(const std::string& topic, TimePoint now);
  void drop_oldest_written();
  Topics::value_type* next_due(const Backlog& backlog, TimePoint now);

  Topics topics_;
  std::size_t busy_ = 0;                    // topics that are trying
  Duration caution_{};                      // the last time by which tries were put off
  std::optional<TimePoint> tries_put_off_;  // no try before this time
  std::optional<TimePoint> wake_;

  std::uint64_t answers_ = 0;                                 // number of the broker's answers
  std::deque<Written, RecyclingAllocator<Written>> written_;  // after the last answer, in order
  std::set<std::string> last_unanswered_;
  TimePoint up_since_{};
  std::optional<LastRefusal> last_refusal_;         // of this connection
  std::unordered_map<std::size_t, Refusal> flows_;  // refusals that cost the connection, by slot
  std::bitset<SlotSums::slots> taken_;              // topics that were accepted last time, by slot
};

}  // namespace slamgw
