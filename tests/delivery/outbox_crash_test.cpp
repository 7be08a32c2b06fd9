// SPDX-License-Identifier: Apache-2.0
// One script of an outage, run many times. The process is killed after each step in turn, or the
// store fails at each write in turn.
#include <gtest/gtest.h>

#include <functional>
#include <map>
#include <string>
#include <vector>

#include "tests/delivery/delivery_check.hpp"
#include "tests/delivery/outbox_rig.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

struct Play : test::OutboxRig {
  void say(const std::string& topic) {
    topics[++number] = topic;
    submit(topic, number);
  }
  void say_many(int count) {
    for (int i = 0; i < count; ++i) say(i % 3 == 0 ? "a" : i % 3 == 1 ? "b" : "c");
  }
  void acknowledge(int count) {
    for (int i = 0; i < count && !under_way.empty(); ++i) acknowledge_first();
  }
  void expect_promises() {
    settle();
    test::expect_promises_kept(*this, topics, interruptions);
    EXPECT_EQ(depth(), 0u);
    EXPECT_EQ(outbox->queued_bytes(), 0u);
    EXPECT_TRUE(store.rows.empty());
  }

  std::uint64_t number = 0;
  std::map<std::uint64_t, std::string> topics;
  std::size_t interruptions = 0;
};

using Step = std::function<void(Play&)>;

using Script = std::vector<Step>;

Step say(int count) {
  return [count](Play& play) { play.say_many(count); };
}
Step acknowledge(int count) {
  return [count](Play& play) { play.acknowledge(count); };
}
Step pass(Duration time) {
  return [time](Play& play) { play.pass(time); };
}
void serve(Play& play) { play.serve_store(); }
void up(Play& play) { play.link_up(); }
void down(Play& play) {
  ++play.interruptions;
  play.link_down(3);
}

/// Quick, away, back, stalled, quick again: with the store's answers as steps of their own.
Script outage_script() {
  Script script{say(2),  serve,  say(6),         serve,    up,    serve,  serve,
                say(30), serve,  acknowledge(5), serve,    down,  serve,  say(9),
                serve,   serve,  pass(1s),       say(400), serve, serve,  serve,
                up,      say(3), serve,          serve,    serve, say(5), acknowledge(40)};
  for (int i = 0; i < 6; ++i) {
    for (const Step& step : Script{serve, acknowledge(20), say(4), serve}) script.push_back(step);
  }
  const Script rest{pass(600ms),
                    serve,
                    serve,
                    down,
                    serve,
                    say(5),
                    serve,
                    up,
                    serve,
                    serve,
                    acknowledge(600),
                    serve,
                    acknowledge(600),
                    serve,
                    say(20),
                    pass(2s),
                    serve,
                    say(3),
                    serve,
                    serve,
                    acknowledge(9),
                    serve,
                    pass(1s),
                    serve,
                    say(20),
                    acknowledge(100),
                    serve};
  script.insert(script.end(), rest.begin(), rest.end());
  return script;
}

TEST(OutboxCrash, DeliversAcknowledgedMessagesInOrderWhenKilledAtAnyStep) {
  const Script script = outage_script();
  for (std::size_t dies_after = 0; dies_after <= script.size(); ++dies_after) {
    SCOPED_TRACE("dies after step " + std::to_string(dies_after));
    Play play;
    for (std::size_t i = 0; i < dies_after; ++i) script[i](play);
    play.die();
    ++play.interruptions;
    play.start();
    play.say_many(5);
    play.link_up();
    play.say_many(5);
    play.expect_promises();
    if (testing::Test::HasFailure()) return;
  }
}

TEST(OutboxCrash, LosesNothingWhenKilledBetweenAWriteAndItsAnswer) {
  const Script script = outage_script();
  for (std::size_t dies_after = 0; dies_after <= script.size(); ++dies_after) {
    SCOPED_TRACE("dies after step " + std::to_string(dies_after));
    Play play;
    for (std::size_t i = 0; i < dies_after; ++i) script[i](play);
    if (play.store.is_asked()) play.store.serve(play.now);
    play.die();
    ++play.interruptions;
    play.start();
    play.expect_promises();
    if (testing::Test::HasFailure()) return;
  }
}

TEST(OutboxCrash, LosesNothingWhenTheStoreFailsOnceAtAnyWrite) {
  const Script script = outage_script();
  for (std::size_t n = 1; n <= 25; ++n) {
    SCOPED_TRACE("write " + std::to_string(n) + " fails");
    Play play;
    play.store.fail_countdown = n;
    for (const Step& step : script) step(play);
    play.expect_promises();
    EXPECT_EQ(play.fired.size(), play.topics.size()) << "every receipt has fired in the end";
    if (testing::Test::HasFailure()) return;
  }
}

TEST(OutboxCrash, LosesNoAcknowledgedMessageWhenKilledAfterAFailedWrite) {
  const Script script = outage_script();
  for (std::size_t n = 1; n <= 12; n += 3) {
    for (std::size_t dies_after = n; dies_after <= script.size(); dies_after += 7) {
      SCOPED_TRACE("write " + std::to_string(n) + ", step " + std::to_string(dies_after));
      Play play;
      play.store.fail_countdown = n;
      for (std::size_t i = 0; i < dies_after; ++i) script[i](play);
      play.die();
      ++play.interruptions;
      play.start();
      play.expect_promises();
      if (testing::Test::HasFailure()) return;
    }
  }
}

}  // namespace
}  // namespace slamgw
