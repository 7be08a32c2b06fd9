// SPDX-License-Identifier: Apache-2.0
// Seeded random walks: robots talk, the broker comes, goes, stalls and refuses, the store works,
// fails, is full or late, the process dies. The promises hold in all of them.
#include <gtest/gtest.h>

#include <random>
#include <string>

#include "tests/delivery/delivery_check.hpp"
#include "tests/delivery/outbox_rig.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

class Walk : public test::OutboxRig {
 public:
  /// `refusing`: the share of messages on the first three topics that the broker refuses, in
  /// percent. `closing_topic`: the topic for which it closes the connection; -1: none.
  Walk(unsigned seed, std::uint64_t store_max_bytes, int refusing, int closing_topic)
      : test::OutboxRig(store_max_bytes),
        random_(seed),
        refusing_(refusing),
        closing_topic_(closing_topic) {}

  void step() {
    const int choice = below(100);
    if (choice < 35) return say(1 + below(4));
    if (choice < 60) return acknowledge(below(12));
    if (choice < 80) return serve(below(4));
    if (choice < 92) return pass(std::chrono::milliseconds{below(900)});
    if (choice < 93 && closing_topic_ >= 0) return close_for_poison();
    if (choice < 95) return below(8) == 0 ? resend() : toggle_link();
    if (choice < 96) return say(100 + below(400));
    if (choice < 97) return say_state();
    if (choice < 98) return is_store_late_ && below(2) == 0 ? open_late_store() : pass(3s);
    if (choice < 99) {
      store.is_failing = below(3) == 0;
      return;
    }
    if (below(3) == 0) restart();
  }

  void check_bounds() const {
    ASSERT_LE(outbox->queued_bytes(), Outbox::max_queued_bytes);
    ASSERT_LE(outbox->backlog().bytes(), max_bytes);
    ASSERT_LE(under_way.size(), window + PublishWindow::max_unacknowledged);
    ASSERT_GE(depth(), under_way.size());
  }

  void finish() {
    store.is_failing = false;
    if (is_store_late_) open_late_store();
    closing_topic_ = -1;
    pass(60s);
    settle();
    pass(3h);  // the longest pause
    settle();
    EXPECT_TRUE(outbox->refused_topics().empty());
    test::expect_promises_kept(*this, topics_, interruptions_);
    EXPECT_EQ(depth(), 0u);
    EXPECT_EQ(outbox->queued_bytes(), 0u);
    EXPECT_EQ(outbox->backlog().bytes(), 0u);
    EXPECT_TRUE(store.rows.empty());
    if (last_state_ != 0 && max_bytes >= 1u << 28) {
      ASSERT_FALSE(received_of(state_topic).empty());
      EXPECT_EQ(received_of(state_topic).back(), std::to_string(last_state_));
    }
  }

 private:
  /// The broker takes the messages before the first one of that topic, and closes the connection.
  void close_for_poison() {
    if (!is_up) return link_up();
    while (!under_way.empty() && first_topic() != topic(closing_topic_)) acknowledge_first();
    if (under_way.empty()) return;
    ++interruptions_;
    link_down();
    if (below(30) == 0) closing_topic_ = -1;
  }
  int below(int bound) { return std::uniform_int_distribution<int>(0, bound - 1)(random_); }

  void say(int count) {
    for (int i = 0; i < count; ++i) {
      const std::string topic = Walk::topic(below(6));
      topics_[++number_] = topic;
      const Qos qos = static_cast<Qos>(below(8) == 0 ? 0 : 1 + below(2));
      const bool is_owed = qos != Qos::at_most_once && below(5) > 0;
      outbox->submit(
          {topic, to_bytes(std::to_string(number_)), qos, false, Provenance{Mesh::thread, {}}},
          {Mesh::thread, is_owed ? number_ : 0}, now);
      drain();
    }
  }
  /// A retained message of the gateway itself: the last one counts.
  void say_state() {
    last_state_ = ++number_;
    outbox->submit({state_topic, to_bytes(std::to_string(number_)), Qos::at_least_once, true},
                   no_receipt, now);
    drain();
  }
  void acknowledge(int count) {
    for (int i = 0; i < count && !under_way.empty(); ++i) {
      const bool may_be_refused =
          under_way.front().message.qos != Qos::at_most_once && first_topic() < topic(3);
      const bool is_refused =
          may_be_refused && (below(100) < refusing_ || refused_topic_ == first_topic());
      const bool is_permanent = first_topic() != state_topic && below(10) == 0;
      if (is_refused) {
        refuse_first(is_permanent ? topic_name_invalid : quota_exceeded);
      } else {
        below(3) == 0 ? acknowledge_quickest() : acknowledge_first();
      }
    }
    if (refusing_ > 0 && below(50) == 0) refused_topic_ = below(2) ? topic(below(3)) : "";
  }
  void serve(int count) {
    for (int i = 0; i < count; ++i) serve_store();
  }
  void toggle_link() {
    if (!is_up) return link_up(static_cast<std::uint16_t>(1 + below(40)));
    ++interruptions_;
    const auto received = static_cast<std::size_t>(below(20));
    below(4) == 0 ? leave(received) : link_down(received);
  }
  /// Resends all dead letters, as an operator orders, after the store has served its requests.
  void resend() {
    while (store.is_asked() && below(3) > 0) serve_store();
    if (store.is_failing || is_store_late_) return;
    outbox->on_store_event(store.revive_all(now), now);
    drain();
  }
  void restart() {
    ++interruptions_;
    if (store.is_asked() && below(2) == 0) store.serve(now);
    die();
    last_state_ = 0;                     // a gateway that starts publishes it again
    refused_topics.insert(state_topic);  // a message replaced just before may come once more
    is_store_late_ = below(3) == 0;
    if (!is_store_late_) return start();
    outbox = std::make_unique<Outbox>(window, max_bytes);
    if (store.rows.empty() && store.dead_letters.empty())
      outbox->on_store_event(StoreAbsent{}, now);
    drain();
  }
  void open_late_store() {
    is_store_late_ = false;
    open_store();
  }

  static constexpr const char* state_topic = "gateway/g/state";
  static std::string topic(int which) {
    return "r/" + std::to_string(which / 2) + "/" + std::to_string(which % 2);
  }
  const std::string& first_topic() const { return under_way.front().message.topic; }
  static constexpr int quota_exceeded = 0x97;

  std::mt19937 random_;
  int refusing_;
  int closing_topic_;
  std::string refused_topic_;  // the broker refuses each of its messages
  std::uint64_t number_ = 0;
  std::uint64_t last_state_ = 0;  // 0: none in this process
  bool is_store_late_ = false;    // it can be opened only later
  std::map<std::uint64_t, std::string> topics_;
  std::size_t interruptions_ = 0;
};

void walk(unsigned seed, std::uint64_t store_max_bytes, int refusing = 0, int closing_topic = -1) {
  SCOPED_TRACE("seed " + std::to_string(seed));
  Walk walk(seed, store_max_bytes, refusing, closing_topic);
  for (int i = 0; i < 1000; ++i) {
    walk.step();
    walk.check_bounds();
    if (testing::Test::HasFailure()) return;
  }
  walk.finish();
}

TEST(OutboxWalk, KeepsThePromisesWithRoomInTheStore) {
  for (unsigned seed = 1; seed <= 8 && !testing::Test::HasFailure(); ++seed) walk(seed, 1u << 28);
}

TEST(OutboxWalk, KeepsThePromisesWithAStoreThatIsOftenFull) {
  for (unsigned seed = 1; seed <= 8 && !testing::Test::HasFailure(); ++seed) walk(seed, 20000);
}

TEST(OutboxWalk, KeepsThePromisesWithABrokerThatRefuses) {
  for (unsigned seed = 1; seed <= 8 && !testing::Test::HasFailure(); ++seed)
    walk(seed, 1u << 28, 3);
  for (unsigned seed = 1; seed <= 8 && !testing::Test::HasFailure(); ++seed)
    walk(seed, 1u << 28, 40);
}

TEST(OutboxWalk, KeepsThePromisesWithABrokerThatRefusesAndAStoreThatIsOftenFull) {
  for (unsigned seed = 1; seed <= 8 && !testing::Test::HasFailure(); ++seed) walk(seed, 20000, 10);
}

TEST(OutboxWalk, KeepsThePromisesWithABrokerThatClosesTheConnectionForATopic) {
  for (unsigned seed = 1; seed <= 8 && !testing::Test::HasFailure(); ++seed)
    walk(seed, 1u << 28, 0, 2);
  for (unsigned seed = 1; seed <= 8 && !testing::Test::HasFailure(); ++seed)
    walk(seed, 20000, 5, 3);
}

}  // namespace
}  // namespace slamgw
