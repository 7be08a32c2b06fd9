// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/filter_suspects.hpp"

#include <gtest/gtest.h>

#include <set>

namespace slamgw {
namespace {

using namespace std::chrono_literals;

struct FilterSuspectsTest : testing::Test {
  void send(const std::string& filter) { suspects.on_sent({filter, Qos::at_least_once, 1}); }
  std::string lose(Duration after = 1s) { return suspects.on_lost(now += after).value_or(""); }
  std::string next_trial() {
    const auto next = suspects.next_trial();
    return next ? next->filter : "";
  }
  /// As Upstream does: the suspect was sent alone, and the connection broke.
  std::string lose_alone() {
    EXPECT_EQ(next_trial(), "bad");
    return lose();
  }

  TimePoint now{24h};
  FilterSuspects suspects;
};

TEST_F(FilterSuspectsTest, AFilterThatLosesTheConnectionAloneTwiceIsSetAside) {
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(next_trial(), "");
    send("bad");
    EXPECT_TRUE(suspects.has_unanswered());
    EXPECT_EQ(lose(), "");
  }
  EXPECT_EQ(lose_alone(), "");
  EXPECT_EQ(lose_alone(), "bad");
  EXPECT_EQ(next_trial(), "");
  EXPECT_TRUE(suspects.is_aside("bad", now + 59min));
  EXPECT_FALSE(suspects.is_aside("bad", now + 61min)) << "the broker may have changed";
}

TEST_F(FilterSuspectsTest, WhatIsSentTogetherWithItGoesOn) {
  send("good");
  suspects.on_answered("good");
  for (int i = 0; i < 2; ++i) {
    send("good");
    send("bad");
    lose();
  }
  EXPECT_EQ(lose_alone(), "") << "one that was answered before needs more to be suspected";
  EXPECT_EQ(lose_alone(), "bad");
  EXPECT_EQ(next_trial(), "");
  EXPECT_FALSE(suspects.is_aside("good", now));
}

TEST_F(FilterSuspectsTest, ANetworkThatBreaksSetsNothingAside) {
  for (int life = 0; life < 50; ++life) {
    for (const char* filter : {"a", "b"}) send(filter);
    EXPECT_EQ(lose(), "");
    while (!next_trial().empty()) suspects.on_answered(next_trial());
  }
}

TEST_F(FilterSuspectsTest, LossesThatLieFarApartTellNothing) {
  for (int i = 0; i < 9; ++i) {
    send("a");
    lose(61min);
    EXPECT_EQ(next_trial(), "");
  }
}

TEST_F(FilterSuspectsTest, AFilterThatABrokerHasTakenCanTurnBadToo) {
  send("bad");
  suspects.on_answered("bad");
  for (unsigned i = 0; i < FilterSuspects::losses_of_answered; ++i) {
    EXPECT_EQ(next_trial(), "");
    send("bad");
    lose();
  }
  EXPECT_EQ(lose_alone(), "");
  EXPECT_EQ(lose_alone(), "bad");
}

TEST_F(FilterSuspectsTest, WithoutAnAnswerInTimeNobodyIsToBlame) {
  for (int i = 0; i < 2; ++i) {
    send("bad");
    lose();
  }
  EXPECT_EQ(next_trial(), "bad");
  suspects.acquit_all();
  EXPECT_EQ(next_trial(), "");
  EXPECT_EQ(lose(), "") << "it is no longer on trial";
}

TEST_F(FilterSuspectsTest, RemembersABoundedNumber) {
  for (std::size_t i = 0; i < 2 * FilterSuspects::most_aside; ++i) {
    const std::string filter = "f" + std::to_string(i);
    for (int loss = 0; loss < 4; ++loss) {
      if (next_trial().empty()) send(filter);
      lose();
    }
  }
  EXPECT_FALSE(suspects.is_aside("f0", now));
  EXPECT_TRUE(suspects.is_aside("f" + std::to_string(2 * FilterSuspects::most_aside - 1), now));
}

TEST_F(FilterSuspectsTest, TheOtherSuspectsAreTriedNextWhenOneIsSetAside) {
  const std::set<std::string> bad{"bad0", "bad1", "bad2"};
  const std::size_t needed = 2 + bad.size() * FilterSuspects::losses_alone;
  std::set<std::string> aside;
  for (std::size_t losses = 0; losses < needed; ++losses) {
    if (next_trial().empty()) {
      send("good");
      for (const std::string& filter : bad) send(filter);
    }
    if (const std::string filter = lose(); !filter.empty()) aside.insert(filter);
  }
  EXPECT_EQ(aside, bad);
  EXPECT_EQ(next_trial(), "good");
  suspects.on_answered("good");
  EXPECT_FALSE(suspects.has_suspects());
}

TEST_F(FilterSuspectsTest, WhatIsForgottenOnTrialIsNotRemembered) {
  for (int i = 0; i < 2; ++i) {
    send("a");
    lose();
  }
  ASSERT_EQ(next_trial(), "a");
  suspects.forget("a");
  EXPECT_EQ(lose(), "");
  EXPECT_FALSE(suspects.has_suspects());
  EXPECT_EQ(next_trial(), "");
}

TEST_F(FilterSuspectsTest, WhatNobodyWantsIsForgotten) {
  send("a");
  lose();
  send("a");
  suspects.forget("a");
  lose();
  EXPECT_EQ(next_trial(), "");
}

}  // namespace
}  // namespace slamgw
