// SPDX-License-Identifier: Apache-2.0
// Bans are added and removed in the site's own file; no change is lost.
#include <gtest/gtest.h>

#include <thread>
#include <vector>

#include "ctl/connection.hpp"
#include "ctl/host/installation.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::ctl {
namespace {

class Bans : public testing::Test {
 protected:
  Bans() { test::write_file(configuration(), "{}"); }
  std::string configuration() const { return directory_ / "gateway.json"; }
  std::vector<std::string> bans() const {
    return Installation(configuration()).parsed().config.bans;
  }

  test::TempDir directory_;
};

TEST_F(Bans, LastUntilTheyAreRemoved) {
  const Installation installation(configuration());
  change_bans(installation, "tank", true);
  EXPECT_EQ(bans(), std::vector<std::string>{"tank"});
  change_bans(installation, "tank", false);
  EXPECT_TRUE(bans().empty());
  EXPECT_THROW(change_bans(installation, "tank", false), Failure);
}

TEST_F(Bans, LoseNoneThatIsAddedAtTheSameTime) {
  const Installation installation(configuration());
  std::vector<std::thread> writers;
  for (int i = 0; i < 8; ++i)
    writers.emplace_back([&, i] { change_bans(installation, "r" + std::to_string(i), true); });
  for (std::thread& writer : writers) writer.join();
  EXPECT_EQ(bans().size(), 8U);
}

}  // namespace
}  // namespace slamgw::ctl
