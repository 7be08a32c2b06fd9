// SPDX-License-Identifier: Apache-2.0
// When a gateway was last online, as the next process reads it.
#include "daemon/app/last_alive.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <array>
#include <boost/asio/io_context.hpp>
#include <optional>
#include <string>

#include "tests/support/eventually.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

class LastAliveTest : public testing::Test {
 protected:
  std::string file() const { return directory / "alive"; }
  static std::chrono::seconds up() {
    return std::chrono::floor<std::chrono::seconds>(
        std::chrono::steady_clock::now().time_since_epoch());
  }
  /// Writes the file of a gateway that ended at `steady`, and `wall_ago` before now by the wall
  /// clock (negative: the clock was set back).
  void ended(std::chrono::seconds steady, std::chrono::seconds wall_ago,
             const std::string& uri = broker) const {
    test::write_file(file(), std::to_string(steady.count()) + " " + uri + "\n");
    const auto then = std::chrono::system_clock::now() - wall_ago;
    const timespec time{std::chrono::system_clock::to_time_t(then), 0};
    ASSERT_EQ(::utimensat(AT_FDCWD, file().c_str(), std::array{time, time}.data(), 0), 0);
  }
  std::optional<Duration> age_found() {
    const auto found = LastAlive(io, directory.path()).before_start();
    if (!found) return {};
    return std::chrono::steady_clock::now() - found->time;
  }
  /// Returns whether the file is as `ended(0s, ...)` wrote it.
  bool is_still_old() const { return test::read_file(file()).starts_with("0 "); }

  static constexpr const char* broker = "mqtt://broker:1883";
  test::TempDir directory;
  boost::asio::io_context io;
};

TEST_F(LastAliveTest, ReadsEndOfPreviousProcess) {
  ended(up(), 0s);
  const auto age = age_found();
  ASSERT_TRUE(age);
  EXPECT_GE(*age, 0s);
  EXPECT_LT(*age, 1h);
}

TEST_F(LastAliveTest, TakesTheLargerAgeOfTwoClocks) {
  ended(up(), 1h);
  ASSERT_TRUE(age_found());
  EXPECT_GE(*age_found(), 1h);
  ended(0s, 0s);
  ASSERT_TRUE(age_found());
  EXPECT_GE(*age_found(), up() - 1s) << "the wall clock stood still";
}

TEST_F(LastAliveTest, FindsNothingWithoutFile) {
  EXPECT_FALSE(age_found());
  EXPECT_FALSE(LastAlive(io, directory / "missing").before_start());
}

TEST_F(LastAliveTest, FindsNothingAfterReboot) {
  ended(up() + 1h, 0s);
  EXPECT_FALSE(age_found());
}

TEST_F(LastAliveTest, FindsNothingWhenTimeIsInTheFuture) {
  ended(up(), -1h);
  EXPECT_FALSE(age_found());
}

TEST_F(LastAliveTest, ReadsBrokerOfPreviousProcess) {
  ended(up(), 0s, "mqtt://elsewhere:1883");
  const auto found = LastAlive(io, directory.path()).before_start();
  ASSERT_TRUE(found);
  EXPECT_EQ(found->uri, "mqtt://elsewhere:1883");
}

TEST_F(LastAliveTest, FindsNothingInInvalidText) {
  for (const char* const text :
       {"", "x", "-1 mqtt://broker:1883", "1", "9999999999999999999999 b"}) {
    test::write_file(file(), text);
    EXPECT_FALSE(age_found()) << text;
  }
}

TEST_F(LastAliveTest, WritesTheFileWhileTheBrokerIsOnline) {
  ended(0s, 24h);
  LastAlive alive(io, directory.path());
  alive.on_broker_up(broker);
  EXPECT_TRUE(test::eventually(io, [&] { return !is_still_old(); }));
  ended(0s, 24h);
  alive.stop();
  EXPECT_FALSE(is_still_old());
  ASSERT_TRUE(age_found());
  EXPECT_LT(*age_found(), 1h);
  ASSERT_TRUE(alive.before_start());
  EXPECT_GE(std::chrono::steady_clock::now() - alive.before_start()->time, 24h)
      << "the time that was found at the start";
}

TEST_F(LastAliveTest, DoesNotWriteBeforeBrokerIsOnline) {
  ended(0s, 24h);
  LastAlive(io, directory.path()).stop();
  EXPECT_TRUE(is_still_old());
}

TEST_F(LastAliveTest, DoesNotWriteWhileBrokerIsOffline) {
  LastAlive alive(io, directory.path());
  alive.on_broker_up(broker);
  ASSERT_TRUE(test::eventually(io, [&] { return !test::read_file(file()).empty(); }));
  alive.on_broker_down();
  ended(0s, 24h);
  alive.stop();
  EXPECT_TRUE(is_still_old());
}

/// A process that ends before it holds the robots' sessions must not make old commands look fresh.
TEST_F(LastAliveTest, KeepsOldTimeWhenProcessEndsAtOnce) {
  ended(0s, 24h);
  LastAlive alive(io, directory.path());
  alive.on_broker_up(broker);
  alive.stop();
  EXPECT_TRUE(is_still_old());
}

TEST_F(LastAliveTest, KeepsTimeOfOtherBrokerWhenItReturnsToFirst) {
  LastAlive alive(io, directory.path());
  alive.on_broker_up("mqtt://second:1883");
  ASSERT_TRUE(test::eventually(io, [&] { return !test::read_file(file()).empty(); }));
  alive.on_broker_down();
  alive.on_broker_up(broker);
  alive.stop();
  EXPECT_NE(test::read_file(file()).find("mqtt://second:1883"), std::string::npos);
}

TEST_F(LastAliveTest, WritesAtOnceAfterAShortTimeOffline) {
  ended(up() - 1s, 0s);
  const std::string before = test::read_file(file());
  LastAlive alive(io, directory.path());
  alive.on_broker_up(broker);
  alive.stop();
  EXPECT_NE(test::read_file(file()), before);
}

TEST_F(LastAliveTest, ToleratesDirectoryThatItCannotWrite) {
  LastAlive alive(io, directory / "missing");
  alive.on_broker_up(broker);
  alive.stop();
  EXPECT_FALSE(LastAlive(io, directory / "missing").before_start());
}

}  // namespace
}  // namespace slamgw
