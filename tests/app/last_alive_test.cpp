// SPDX-License-Identifier: Apache-2.0
// When a gateway last ran here, as the next process reads it.
#include "daemon/app/last_alive.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <array>
#include <boost/asio/io_context.hpp>

#include "tests/support/eventually.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

class LastAliveTest : public testing::Test {
 protected:
  std::string file() const { return directory / "alive"; }
  /// As if a gateway had ended so long ago; negative: the clock was set back since.
  void ended(std::chrono::seconds ago) const {
    test::write_file(file(), "");
    const auto then = std::chrono::system_clock::now() - ago;
    const timespec time{std::chrono::system_clock::to_time_t(then), 0};
    ASSERT_EQ(::utimensat(AT_FDCWD, file().c_str(), std::array{time, time}.data(), 0), 0);
  }
  WallTime changed() const {
    struct stat status {};
    if (::stat(file().c_str(), &status) != 0) return {};
    return std::chrono::system_clock::from_time_t(status.st_mtime);
  }
  Duration age_found() {
    const auto found = LastAlive(io, directory.path()).before_start();
    return found ? std::chrono::steady_clock::now() - *found : Duration::max();
  }

  test::TempDir directory;
  boost::asio::io_context io;
};

TEST_F(LastAliveTest, KnowsWhenTheProcessBeforeThisOneEnded) {
  ended(1h);
  const Duration age = age_found();
  EXPECT_GE(age, 1h);
  EXPECT_LT(age, 2h);
}

TEST_F(LastAliveTest, KnowsNothingWhereNoProcessHasRun) {
  EXPECT_FALSE(LastAlive(io, directory.path()).before_start());
  EXPECT_FALSE(LastAlive(io, directory / "missing").before_start());
}

TEST_F(LastAliveTest, TakesATimeThatIsStillToComeForNow) {
  ended(-1h);
  const Duration age = age_found();
  EXPECT_GE(age, 0s);
  EXPECT_LT(age, 1h);
}

TEST_F(LastAliveTest, TouchesTheFileFromTheStartOn) {
  ended(24h);
  LastAlive alive(io, directory.path());
  alive.start();
  const WallTime today = std::chrono::system_clock::now() - 1h;
  EXPECT_TRUE(test::eventually(io, [&] { return changed() > today; }));
  alive.stop();
  ASSERT_TRUE(alive.before_start());
  EXPECT_GE(std::chrono::steady_clock::now() - *alive.before_start(), 24h)
      << "what this process found";
}

TEST_F(LastAliveTest, TouchesTheFileWhenItStops) {
  LastAlive alive(io, directory.path());
  alive.start();
  ASSERT_TRUE(test::eventually(io, [&] { return changed() != WallTime{}; }));
  ended(24h);
  alive.stop();
  EXPECT_GT(changed(), std::chrono::system_clock::now() - 1h);
}

TEST_F(LastAliveTest, LivesWithADirectoryThatCannotBeWritten) {
  LastAlive alive(io, directory / "missing");
  alive.start();
  alive.stop();
  EXPECT_FALSE(LastAlive(io, directory / "missing").before_start());
}

}  // namespace
}  // namespace slamgw
