// SPDX-License-Identifier: Apache-2.0
// Bans are added and removed in a drop-in file; no change is lost.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <string>
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

TEST_F(Bans, EndForAllEqualEntries) {
  const Installation installation(configuration());
  test::write_file(
      configuration(),
      R"({"bans": ["127.0.0.1/8", "::ffff:10.0.0.1", "127.0.0.0/8", "10.0.0.1", "r"]})");
  change_bans(installation, "127.3.2.1/8", false);
  EXPECT_EQ(bans(), (std::vector<std::string>{"::ffff:10.0.0.1", "10.0.0.1", "r"}));
  change_bans(installation, "10.0.0.1", false);
  EXPECT_EQ(bans(), std::vector<std::string>{"r"});
  change_bans(installation, "fd00::1/64", true);
  change_bans(installation, "fd00::/64", true);
  EXPECT_EQ(bans(), (std::vector<std::string>{"r", "fd00::/64"})) << "one entry of equal ones";
}

TEST_F(Bans, LeaveNoFileThatOverrulesLaterOnes) {
  const Installation installation(configuration());
  const std::string file = directory_ / "gateway.d/bans.json";
  change_bans(installation, "tank", true);
  EXPECT_TRUE(std::filesystem::exists(file));
  change_bans(installation, "tank", false);
  EXPECT_FALSE(std::filesystem::exists(file));
  test::write_file(configuration(), R"({"bans": ["mole"]})");
  EXPECT_EQ(bans(), std::vector<std::string>{"mole"});
  change_bans(installation, "mole", false);
  EXPECT_TRUE(bans().empty());
  EXPECT_TRUE(std::filesystem::exists(file)) << "it overrules the ban of the other file";
}

TEST_F(Bans, CreateDirectoryThatServiceCanRead) {
  const mode_t before = umask(0077);
  change_bans(Installation(configuration()), "tank", true);
  umask(before);
  EXPECT_EQ(std::filesystem::status(directory_ / "gateway.d").permissions(),
            std::filesystem::perms(0755));
}

TEST_F(Bans, KeepAllWhenAddedConcurrently) {
  const Installation installation(configuration());
  std::vector<std::thread> writers;
  for (int i = 0; i < 8; ++i)
    writers.emplace_back([&, i] { change_bans(installation, "r" + std::to_string(i), true); });
  for (std::thread& writer : writers) writer.join();
  EXPECT_EQ(bans().size(), 8U);
}

TEST_F(Bans, DoNotWaitForForeignLockOfDirectory) {
  const int directory = open(directory_.path().c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  ASSERT_EQ(flock(directory, LOCK_EX), 0);
  change_bans(Installation(configuration()), "tank", true);
  close(directory);
  EXPECT_EQ(bans(), std::vector<std::string>{"tank"});
  EXPECT_EQ(std::filesystem::status(directory_ / ".lock").permissions(),
            std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
}

/// Returns the message of the Failure.
std::string failure_of(const Installation& installation) {
  try {
    change_bans(installation, "tank", true);
    return "";
  } catch (const Failure& failure) {
    return failure.what();
  }
}

TEST_F(Bans, RefuseToChangeInvalidFile) {
  const Installation installation(configuration());
  change_bans(installation, "mole", true);
  const std::string file = directory_ / "gateway.d/bans.json";
  test::write_file(file, R"({"bans": ["mole", "rat"})");
  const std::string output = failure_of(installation);
  EXPECT_NE(output.find("fix it first"), output.npos) << output;
  EXPECT_EQ(test::read_file(file), R"({"bans": ["mole", "rat"})");
}

TEST_F(Bans, NameFileThatOverridesThem) {
  const Installation installation(configuration());
  change_bans(installation, "mole", true);
  const std::string file = directory_ / "gateway.d/site.json";
  test::write_file(file, R"({"bans": ["rat"]})");
  const std::string output = failure_of(installation);
  EXPECT_EQ(output.find(file + " sets `bans` too"), 0U) << output;
  std::filesystem::remove(file);
  EXPECT_EQ(bans(), (std::vector<std::string>{"rat", "tank"}))
      << "the bans in force and the new one";
}

}  // namespace
}  // namespace slamgw::ctl
