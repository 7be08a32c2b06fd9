// SPDX-License-Identifier: Apache-2.0
// The store on a real file: reopening, bounds, foreign files, unusable directories.
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>

#include <boost/crc.hpp>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>

#include "tests/storage/faulty_disk.hpp"
#include "tests/storage/store_user.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::test {
namespace {

mode_t mode_of(const std::string& path) {
  struct stat status {};
  return stat(path.c_str(), &status) == 0 ? status.st_mode & 0777 : 0;
}

std::uintmax_t bytes_in(const std::string& directory) {
  std::uintmax_t sum = 0;
  for (const auto& file : std::filesystem::recursive_directory_iterator(directory))
    if (file.is_regular_file()) sum += file.file_size();
  return sum;
}

TEST(DiskStore, OpensAnEmptyStoreAgainAndAgain) {
  const TempDir directory;
  for (int process = 0; process < 3; ++process) {
    StoreUser user(directory.path());
    const auto opened = user.await<StoreOpened>();
    ASSERT_TRUE(opened);
    EXPECT_EQ(opened->count, 0u);
    EXPECT_EQ(user.notices(), "");
  }
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 1));
}

TEST(DiskStore, NeverAssignsARowNumberTwice) {
  const TempDir directory;
  {
    StoreUser user(directory.path());
    ASSERT_TRUE(user.keep(1, 10));
    ASSERT_TRUE(user.forget(1, 10));
  }
  EXPECT_EQ(StoreUser(directory.path()).await<StoreOpened>()->last_row, 10u);
}

TEST(DiskStore, KeepsTheProvenanceOfAMessage) {
  const TempDir directory;
  const WallTime received{std::chrono::milliseconds{1700000000123}};
  {
    StoreUser user(directory.path());
    ASSERT_TRUE(user.await<StoreOpened>());
    WriteToStore write;
    write.keep.push_back({1, StoreUser::message(1, 3), {}});
    write.keep.back().message.provenance = Provenance{Mesh::ble, received};
    user.store().ask(std::move(write));
    ASSERT_TRUE(user.await<StoreWritten>());
  }
  StoreUser user(directory.path());
  ASSERT_TRUE(user.await<StoreOpened>());
  const auto loaded = user.load(0);
  ASSERT_TRUE(loaded && loaded->messages.size() == 1 && loaded->messages[0].message.provenance);
  EXPECT_EQ(loaded->messages[0].message.provenance->mesh, Mesh::ble);
  EXPECT_EQ(loaded->messages[0].message.provenance->received_at, received);
}

TEST(DiskStore, LoadsStoredMessagesAfterAReopen) {
  const TempDir directory;
  {
    StoreUser user(directory.path());
    ASSERT_TRUE(user.keep(1, 10));
    ASSERT_TRUE(user.forget(1, 2));
  }
  StoreUser user(directory.path());
  const auto opened = user.await<StoreOpened>();
  ASSERT_TRUE(opened);
  EXPECT_EQ(opened->count, 8u);
  EXPECT_EQ(opened->last_row, 10u);
  EXPECT_EQ(opened->bytes, 8 * stored_cost(25, 10));
  EXPECT_EQ(opened->topics.of("ntnu-slam/robot/r1/update"), 3u);
  EXPECT_EQ(opened->shares.of("ntnu-slam/robot/r1"), 3 * stored_cost(25, 10)) << "its three";
  const auto loaded = user.load(3);
  ASSERT_TRUE(loaded);
  ASSERT_EQ(loaded->messages.size(), 7u);
  for (std::size_t i = 0; i < 7; ++i) {
    const StoredMessage& stored = loaded->messages[i];
    const BrokerMessage expected = StoreUser::message(i + 4, 10);
    EXPECT_EQ(stored.row, i + 4);
    EXPECT_EQ(stored.message.topic, expected.topic);
    EXPECT_EQ(stored.message.payload, expected.payload);
    EXPECT_EQ(stored.message.qos, expected.qos);
    EXPECT_EQ(stored.message.retain, expected.retain);
  }
}

TEST(DiskStore, KeepsEmptyPayloadsAndLoadsByPages) {
  const TempDir directory;
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 1, 0));
  ASSERT_TRUE(user.keep(2, 9, 1000));
  const auto by_count = user.load(0, 4);
  ASSERT_EQ(by_count->messages.size(), 4u);
  EXPECT_TRUE(by_count->messages.front().message.payload.empty());
  EXPECT_EQ(user.load(1, 100, 2000)->messages.size(), 2u);
  EXPECT_EQ(user.load(1, 100, 1)->messages.size(), 1u) << "one, however large";
  EXPECT_TRUE(user.load(10)->messages.empty());
}

TEST(DiskStore, CreatesDirectoryAndFilesForItsOwnerOnly) {
  const TempDir directory;
  const std::string inner = directory / "a/b";
  StoreUser user(inner);
  ASSERT_TRUE(user.keep(1, 1));
  EXPECT_EQ(mode_of(inner), 0700u);
  EXPECT_EQ(mode_of(inner + "/messages"), 0700u);
  ASSERT_TRUE(user.forget(1, 1));
  std::size_t files = 0;
  for (const auto& file : std::filesystem::directory_iterator(inner + "/messages")) {
    EXPECT_EQ(mode_of(file.path()), 0600u) << file.path();
    ++files;
  }
  EXPECT_EQ(files, 3u) << "segment, list of erased records, tally";
}

TEST(DiskStore, StaysWithinItsBoundAndFreesItsSpace) {
  const TempDir directory;
  const std::uint64_t max_bytes = 4u << 20;
  StoreUser user(directory.path(), max_bytes);
  std::uint64_t cost = 0;
  std::uint64_t rows = 0;
  const std::size_t sizes[] = {20, 100, 900, 2100, 3000, 5000, 9000};
  for (std::size_t i = 0; cost + 20 * stored_cost(25, 9000) < max_bytes; ++i) {
    ASSERT_TRUE(user.keep(rows + 1, 20, sizes[i % 7]));
    rows += 20;
    cost += 20 * stored_cost(25, sizes[i % 7]);
  }
  EXPECT_LE(bytes_in(directory.path()), max_bytes) << "stored_cost is an upper bound";
  ASSERT_TRUE(user.forget(1, rows));
  EXPECT_LT(bytes_in(directory.path()), 1u << 20);
}

TEST(DiskStore, SecondProcessRunsWithoutTheStoreAndReportsWhy) {
  const TempDir directory;
  StoreUser first(directory.path());
  ASSERT_TRUE(first.await<StoreOpened>());
  StoreUser second(directory.path());
  ASSERT_TRUE(second.await<StoreAbsent>());
  EXPECT_NE(second.notices().find("another process uses it, perhaps a second "
                                  "slam-gatewayd: stop one of them. Robots get "),
            std::string::npos)
      << second.notices();
  EXPECT_TRUE(first.keep(1, 1)) << "the first process is not disturbed";
}

TEST(DiskStore, LeavesTheLogOfANewerVersionAlone) {
  const TempDir directory;
  {
    StoreUser user(directory.path());
    ASSERT_TRUE(user.keep(1, 1));
  }
  const std::string path = StoreUser::newest_segment(directory.path());
  std::string octets = read_file(path);
  octets[7] = '2';
  boost::crc_32_type crc;
  const std::string id = path.substr(path.size() - 20, 16);
  const std::uint64_t number = std::stoull(id, nullptr, 16);
  crc.process_bytes(&number, 8);
  crc.process_bytes(octets.data(), 28);
  const std::uint32_t sum = crc.checksum();
  std::memcpy(octets.data() + 28, &sum, 4);
  write_file(path, octets, 0600);
  StoreUser user(directory.path());
  ASSERT_TRUE(user.await<StoreAbsent>());
  EXPECT_NE(user.notices().find("newer version (format 2, supported: 1)"), std::string::npos)
      << user.notices();
  EXPECT_EQ(read_file(path), octets);
}

TEST(DiskStore, LeavesFilesOfOthersAlone) {
  const TempDir directory;
  std::filesystem::create_directory(directory / "messages");
  write_file(directory / "messages/notes.log", "foreign file");
  std::filesystem::create_directory(directory / "messages/00000001-0123456789abcdef.log");
  mkfifo((directory / "messages/00000002-0123456789abcdef.log").c_str(), 0600);
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 1));
  EXPECT_EQ(read_file(directory / "messages/notes.log"), "foreign file");
}

TEST(DiskStore, RunsWithoutAUsableDirectoryAndReportsWhy) {
  const TempDir directory;
  write_file(directory / "file", "");
  StoreUser user(directory / "file/store");
  ASSERT_TRUE(user.await<StoreAbsent>());
  EXPECT_NE(user.notices().find("no store:"), std::string::npos);
  EXPECT_NE(user.notices().find("Not a directory"), std::string::npos) << user.notices();
}

TEST(DiskStore, ReportsAFullDiskAndWorksOnceThereIsRoomAgain) {
  const TempDir directory;
  StoreUser user(directory.path());
  ASSERT_TRUE(user.keep(1, 1));
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  const auto old_handler = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit small{64 * 1024, before.rlim_max};
  setrlimit(RLIMIT_FSIZE, &small);
  WriteToStore write;
  for (std::uint64_t row = 2; row < 200; ++row) {
    write.keep.push_back({row, StoreUser::message(row, 1000), {}});
  }
  user.store().ask(write);
  const auto failed = user.await<StoreWriteFailed>();
  setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, old_handler);
  ASSERT_TRUE(failed);
  EXPECT_FALSE(failed->why.empty());
  EXPECT_EQ(user.load(0)->messages.size(), 1u) << "all or nothing";
  user.store().ask(std::move(write));
  ASSERT_TRUE(user.await<StoreWritten>());
  EXPECT_EQ(user.load(0)->messages.size(), 199u);
}

TEST(DiskStore, ReadsAReadOnlyDiskAndKeepsMessagesOnceItCanBeWritten) {
  const FaultyDisk disk;
  const TempDir directory;
  {
    StoreUser user(directory.path());
    ASSERT_TRUE(user.keep(1, 20));
  }
  {
    FaultyDisk::is_read_only = true;
    StoreUser user(directory.path());
    const auto opened = user.await<StoreOpened>();
    ASSERT_TRUE(opened) << user.notices();
    EXPECT_EQ(opened->count, 20u);
    EXPECT_EQ(opened->why_read_only, directory.path() + ": Read-only file system");
    EXPECT_EQ(user.load(0)->messages.size(), 20u);
    user.store().ask(WriteToStore{{}, {1, 2, 3}});
    const auto failed = user.await<StoreWriteFailed>();
    ASSERT_TRUE(failed);
    EXPECT_NE(failed->why.find("Read-only file system"), std::string::npos) << failed->why;
    EXPECT_EQ(user.load(0)->messages.size(), 20u);

    FaultyDisk::is_read_only = false;
    EXPECT_TRUE(user.forget(1, 10));
    EXPECT_TRUE(user.keep(21, 1));
    EXPECT_TRUE(StoreUser(directory.path()).reports("another process uses it")) << "it is locked";
    EXPECT_EQ(user.notices(), "") << "no file had to be restored";
  }
  StoreUser again(directory.path());
  const auto opened = again.await<StoreOpened>();
  EXPECT_EQ(opened->count, 11u);
  EXPECT_EQ(opened->why_read_only, "");
  EXPECT_EQ(again.load(0)->messages.front().row, 11u);
  EXPECT_EQ(again.notices(), "");
}

TEST(DiskStore, ReportsAReadOnlyDiskOnWhichItNeverWas) {
  const FaultyDisk disk;
  const TempDir directory;
  FaultyDisk::is_read_only = true;
  StoreUser user(directory.path());
  ASSERT_TRUE(user.await<StoreAbsent>());
  EXPECT_NE(user.notices().find("tally: Read-only file system"), std::string::npos);
  FaultyDisk::is_read_only = false;
  EXPECT_TRUE(user.await<StoreOpened>());
  EXPECT_TRUE(user.keep(1, 1));
}

TEST(DiskStore, ServesPendingRequestsBeforeItStops) {
  const TempDir directory;
  {
    StoreUser user(directory.path());
    ASSERT_TRUE(user.await<StoreOpened>());
    user.store().ask(WriteToStore{{{1, StoreUser::message(1, 10), {}}}, {}});
    user.store().stop();
  }
  StoreUser user(directory.path());
  EXPECT_EQ(user.await<StoreOpened>()->count, 1u);
}

}  // namespace
}  // namespace slamgw::test
