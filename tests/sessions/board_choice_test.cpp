// SPDX-License-Identifier: Apache-2.0
#include "daemon/sessions/board_choice.hpp"

#include <gtest/gtest.h>

namespace slamgw::sessions {
namespace {

using namespace std::chrono_literals;

constexpr int usual_level_db = -60;

/// This gateway's board hears a robot whose session room-a holds.
class BoardOfRoomB : public testing::Test {
 protected:
  BoardOfRoomB() { choice.on_board(true); }

  /// Lets the robot send five messages a second, which both boards hear if they can; room-a
  /// publishes what it hears. Returns how long it took until this gateway took the robot.
  std::optional<Duration> run(Duration time) {
    const TimePoint begin = now;
    for (; now < begin + time; now += 200ms) {
      if (is_heard_here) choice.on_heard("r1", SignalLevel{level_here_db}, now);
      if (is_heard_there) heard_there = now;
      if (speaks && now >= next_hears) {
        Hears hears{is_board_up_there, {}};
        if (is_board_up_there && heard_there)
          hears.rows.push_back(
              {"r1", level_there_db,
               std::chrono::duration_cast<std::chrono::milliseconds>(now - *heard_there)});
        choice.on_hears("room-a", hears, now);
        next_hears = now + BoardChoice::hears_interval;
      }
      if (choice.should_take("r1", "room-a", now)) return now - begin;
    }
    return std::nullopt;
  }

  BoardChoice choice;
  TimePoint now{1h};
  TimePoint next_hears{};
  std::optional<TimePoint> heard_there;
  bool speaks = true;
  bool is_board_up_there = true;
  bool is_heard_here = true;
  bool is_heard_there = true;
  int level_here_db = usual_level_db;
  int level_there_db = usual_level_db;
};

TEST_F(BoardOfRoomB, LeavesTheRobotToAHolderThatHearsItAsWell) { EXPECT_FALSE(run(5min)); }

TEST_F(BoardOfRoomB, TakesARobotThatNoGatewayHolds) {
  EXPECT_FALSE(choice.should_take("r1", "", now)) << "not heard";
  choice.on_heard("r1", std::nullopt, now);
  EXPECT_TRUE(choice.should_take("r1", "", now));
  EXPECT_FALSE(choice.should_take("r1", "", now + BoardChoice::recent)) << "it has gone";
}

TEST_F(BoardOfRoomB, TakesTheRobotOfABoardThatIsDown) {
  run(10s);
  is_board_up_there = false;
  const auto taken = run(10s);
  ASSERT_TRUE(taken);
  EXPECT_LE(*taken, BoardChoice::hears_interval);
}

TEST_F(BoardOfRoomB, TakesARobotThatItsHolderDoesNotHear) {
  run(10s);
  is_heard_there = false;
  const auto taken = run(10s);
  ASSERT_TRUE(taken);
  EXPECT_GE(*taken, BoardChoice::deaf_after);
  EXPECT_LE(*taken, 2 * BoardChoice::deaf_after);
}

TEST_F(BoardOfRoomB, LeavesARobotWhoseHolderHasMissedTwoMessagesOnly) {
  run(10s);
  is_heard_there = false;
  EXPECT_FALSE(run(400ms));
  is_heard_here = false;  // the robot sends no more
  EXPECT_FALSE(run(4s));
}

/// The holder has no board in this mesh, or only an older presence shows the robot.
TEST_F(BoardOfRoomB, TakesTheRobotOfAHolderThatDoesNotPublishWhatItHears) {
  speaks = false;
  const auto taken = run(20s);
  ASSERT_TRUE(taken);
  EXPECT_GE(*taken, BoardChoice::silent_after);
  EXPECT_LE(*taken, 2 * BoardChoice::silent_after);
}

TEST_F(BoardOfRoomB, TakesARobotThatItHearsClearlyBetterForAWhile) {
  run(10s);
  level_here_db = usual_level_db + BoardChoice::clearly_better_db + 2;
  const auto taken = run(20s);
  ASSERT_TRUE(taken);
  EXPECT_GE(*taken, BoardChoice::better_for);
  EXPECT_LE(*taken, 2 * BoardChoice::better_for);
}

TEST_F(BoardOfRoomB, LeavesARobotThatItHearsALittleBetterOrForAMoment) {
  level_here_db = usual_level_db + BoardChoice::clearly_better_db - 1;
  EXPECT_FALSE(run(1min));
  for (int i = 0; i < 10; ++i) {
    level_here_db = usual_level_db + 2 * BoardChoice::clearly_better_db;
    EXPECT_FALSE(run(4s));
    level_here_db = usual_level_db;
    EXPECT_FALSE(run(4s));
  }
}

TEST_F(BoardOfRoomB, LeavesARobotToAThirdBoardThatHearsItStillBetter) {
  level_here_db = usual_level_db + 2 * BoardChoice::clearly_better_db;
  for (int i = 0; i < 30; ++i) {
    choice.on_hears("room-c", {true, {{"r1", level_here_db + 5, 0ms}}}, now);
    EXPECT_FALSE(run(1s)) << i;
  }
  EXPECT_TRUE(run(20s)) << "room-c has gone";
}

TEST_F(BoardOfRoomB, TakesNothingWhileItIsDown) {
  run(10s);
  EXPECT_EQ(choice.candidates(now), std::vector<std::string>{"r1"});
  is_board_up_there = false;
  choice.on_board(false);
  EXPECT_FALSE(run(10s));
  EXPECT_FALSE(choice.should_take("r1", "", now));
  EXPECT_TRUE(choice.candidates(now).empty());
}

TEST_F(BoardOfRoomB, PublishesOnceASecondWhatItHears) {
  choice.on_heard("r1", SignalLevel{-50}, now);
  choice.on_heard("r2", std::nullopt, now + 1s);
  const auto hears = choice.next_hears(now + 1500ms);
  ASSERT_TRUE(hears);
  EXPECT_EQ(to_json_text(*hears), R"({"rows":[["r1",-50,1500],["r2",-1000,500]],"up":true})");
  EXPECT_FALSE(choice.next_hears(now + 2s));
  EXPECT_TRUE(choice.next_hears(now + 2500ms));
  choice.on_board(false);
  ASSERT_TRUE(choice.next_hears(now + 2600ms)) << "at once";
  choice.on_board(true);
  EXPECT_TRUE(choice.next_hears(now + 2min)->rows.empty());
}

TEST_F(BoardOfRoomB, KeepsABoundedNumberOfBoardsAndRobots) {
  for (std::size_t i = 0; i < 2 * BoardChoice::max_robots; ++i)
    choice.on_heard(std::string(64, 'r') + std::to_string(i), std::nullopt, now);
  const auto hears = choice.next_hears(now);
  EXPECT_EQ(hears->rows.size(), Hears::max_rows);
  EXPECT_LE(to_json_text(*hears).size(), Hears::max_octets);
  for (std::size_t i = 0; i < BoardChoice::max_boards; ++i)
    choice.on_hears("gone-" + std::to_string(i), {true, {}}, now);
  is_board_up_there = false;
  now += BoardChoice::forget_after;
  choice.next_hears(now);
  EXPECT_TRUE(run(2s)) << "boards that have gone free their places";
}

TEST(Hears, AreReadAsTheyAreWritten) {
  const Hears hears{true, {{"nr1", -60, 120ms}, {"r\"2", Hears::lowest_level_db, 0ms}}};
  const auto read = read_hears(to_bytes(to_json_text(hears)));
  ASSERT_TRUE(read);
  EXPECT_EQ(to_json_text(*read), to_json_text(hears));
  EXPECT_EQ(read->rows.at(0).age, 120ms);
}

TEST(Hears, AreIgnoredWhenMalformed) {
  std::string rows = R"(["r",-60,1])";
  for (std::size_t i = 1; i < Hears::max_rows; ++i) rows += R"(,["r",-60,1])";
  const auto with_rows = [](const std::string& text) {
    return read_hears(to_bytes(R"({"up":true,"rows":[)" + text + "]}"));
  };
  EXPECT_TRUE(with_rows(rows));
  EXPECT_FALSE(with_rows(rows + R"(,["r",-60,1])"));
  EXPECT_FALSE(with_rows(std::string(Hears::max_octets, ' '))) << "too large";
  for (const char* row :
       {"1", "{}", "[]", R"(["r",-60])", R"(["r",-60,1,1])", R"(["a/b",-60,1])", R"([1,-60,1])",
        R"(["r",-1001,1])", R"(["r",101,1])", R"(["r",1.5,1])", R"(["r",18446744073709551615,1])",
        R"(["r",-60,-1])", R"(["r",-60,3600001])", R"(["r",-60,"1"])"})
    EXPECT_FALSE(with_rows(row)) << row;
  for (const char* text : {"", "1", "[]", "{}", R"({"up":true})", R"({"rows":[]})",
                           R"({"up":1,"rows":[]})", R"({"up":true,"rows":{}})", R"({"up":true,)"})
    EXPECT_FALSE(read_hears(to_bytes(text))) << text;
}

}  // namespace
}  // namespace slamgw::sessions
