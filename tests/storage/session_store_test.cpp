// SPDX-License-Identifier: Apache-2.0
// Sessions on a real file: loading, file permissions, damage.
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <optional>
#include <set>
#include <thread>

#include "daemon/storage/disk_session_store.hpp"
#include "daemon/storage/record_log.hpp"
#include "tests/storage/faulty_disk.hpp"
#include "tests/storage/store_user.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::test {
namespace {

/// One process's store.
struct Process {
  explicit Process(const std::string& directory)
      : store(
            io, directory, DiskSessionStore::mqttsn_sessions(),
            [this](const Notice& notice) { notices += notice.text + "\n"; }, short_patience),
        loaded(store.load()) {}

  void save(const std::string& id, std::optional<Bytes> content) {
    store.save({{id, std::move(content)}});
  }
  bool is_written() {
    return eventually(io, [this] { return !store.is_busy(); });
  }
  bool reports(const std::string& text) {
    return eventually(io, [&] { return notices.find(text) != std::string::npos; });
  }
  std::string names() const {
    std::string all;
    for (const auto& session : loaded) all += session.id + " ";
    return all;
  }

  boost::asio::io_context io;
  std::string notices;
  DiskSessionStore store;
  std::vector<SessionStore::Session> loaded;
};

TEST(DiskSessionStore, LoadsTheLastSavedContentOfEachSession) {
  const TempDir directory;
  {
    Process first(directory.path());
    EXPECT_TRUE(first.loaded.empty());
    first.save("r1", to_bytes("old"));
    first.save("r2", Bytes{0, 1, 255});
    first.save("r3", to_bytes("leaves"));
    EXPECT_TRUE(first.is_written());
    first.save("r1", to_bytes("new"));
    first.save("r3", std::nullopt);
  }
  Process second(directory.path());
  ASSERT_EQ(second.names(), "r1 r2 ");
  EXPECT_EQ(second.loaded[0].content, to_bytes("new"));
  EXPECT_EQ(second.loaded[1].content, (Bytes{0, 1, 255}));
  EXPECT_TRUE(second.notices.empty()) << second.notices;
}

TEST(DiskSessionStore, KeepsWhatIsWrittenWhenTheProcessDies) {
  const TempDir directory;
  const pid_t child = fork();
  if (child == 0) {
    Process process(directory.path());
    process.save("r1", to_bytes("x"));
    _exit(process.is_written() ? 0 : 1);  // no destructor, as after SIGKILL
  }
  int status = -1;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  ASSERT_EQ(status, 0);
  EXPECT_EQ(Process(directory.path()).names(), "r1 ");
}

TEST(DiskSessionStore, ReportsTheResultOfEachWrite) {
  const TempDir directory;
  std::vector<bool> results;
  {
    Process process(directory.path());
    process.store.watch([&](bool is_written) { results.push_back(is_written); });
    process.save("r1", to_bytes("x"));
    EXPECT_TRUE(results.empty()) << "never from inside the call";
    EXPECT_TRUE(eventually(process.io, [&] { return !results.empty(); }));
  }
  EXPECT_EQ(results, std::vector<bool>{true});
  Process without("/proc/nowhere");
  without.store.watch([&](bool is_written) { results.push_back(is_written); });
  without.save("r1", to_bytes("x"));
  EXPECT_TRUE(eventually(without.io, [&] { return results.size() > 2; })) << "it is tried again";
  EXPECT_FALSE(results[1]);
  EXPECT_FALSE(results[2]);
}

TEST(DiskSessionStore, IsReadableForItsOwnerOnly) {
  const TempDir directory;
  Process process(directory.path() + "/made");
  struct stat status {};
  ASSERT_EQ(stat((directory.path() + "/made/sessions/tally").c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777, 0600U);
}

TEST(DiskSessionStore, LoadsNoSessionsOfAReadOnlyDiskBecauseTheyMayBeOld) {
  const FaultyDisk disk;
  const TempDir directory;
  {
    Process process(directory.path());
    process.save("r1", to_bytes("x"));
  }
  FaultyDisk::is_read_only = true;
  Process process(directory.path());
  EXPECT_EQ(process.names(), "");
  EXPECT_TRUE(process.reports("Read-only file system"));
  process.save("r1", to_bytes("y"));
  FaultyDisk::is_read_only = false;
  EXPECT_TRUE(process.is_written());
  EXPECT_TRUE(process.reports("are kept again"));
}

TEST(DiskSessionStore, WaitsForADiskThatFailsForAMoment) {
  const FaultyDisk disk;
  const TempDir directory;
  {
    Process process(directory.path());
    process.save("r1", to_bytes("x"));
  }
  FaultyDisk::fails_reads = true;
  std::thread repair([] {
    eventually([] { return FaultyDisk::failed_reads > 30; });
    FaultyDisk::fails_reads = false;
  });
  Process process(directory.path());
  repair.join();
  EXPECT_EQ(process.names(), "r1 ");
  EXPECT_EQ(process.notices, "");
}

TEST(DiskSessionStore, ErasesASessionThatEndedWhileTheDiskCouldNotBeWritten) {
  const FaultyDisk disk;
  for (const bool comes_back : {false, true}) {
    const TempDir directory;
    {
      Process process(directory.path());
      process.save("r1", to_bytes("old"));
      EXPECT_TRUE(process.is_written());
      FaultyDisk::fails_writes = true;
      process.store.save({{"r1", std::nullopt}, {"r2", to_bytes("x")}});
      EXPECT_TRUE(process.reports("not kept"));
      if (comes_back) process.save("r1", to_bytes("new"));
      FaultyDisk::fails_writes = false;
      EXPECT_TRUE(process.is_written());
    }
    Process next(directory.path());
    ASSERT_EQ(next.names(), comes_back ? "r1 r2 " : "r2 ");
    EXPECT_EQ(next.loaded[0].content, to_bytes(comes_back ? "new" : "x"));
  }
}

TEST(DiskSessionStore, ErasesASessionWhoseErasureFailedAtFirst) {
  const TempDir directory;
  {
    Process process(directory.path());
    process.save("r1", to_bytes("x"));
    process.save("r2", to_bytes("x"));
    EXPECT_TRUE(process.is_written());
    const std::string list = StoreUser::newest_segment(directory.path(), "sessions") + ".erased";
    std::filesystem::create_directory(list);  // so it cannot be written
    process.save("r1", std::nullopt);
    EXPECT_TRUE(process.is_written());
    std::filesystem::remove(list);
  }
  EXPECT_EQ(Process(directory.path()).names(), "r2 ");
}

TEST(DiskSessionStore, LoadsTheIntactSessionsOfADamagedFile) {
  const TempDir directory;
  {
    Process process(directory.path());
    for (int i = 100; i < 300; ++i)
      process.save("robot-" + std::to_string(i), Bytes(100, static_cast<std::uint8_t>(i)));
  }
  const std::string path = StoreUser::newest_segment(directory.path(), "sessions");
  for (const std::size_t page : {0, 1, 4}) {
    std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
    file.seekp(static_cast<std::streamoff>(page * 4096));
    file << std::string(512, '\0');
  }
  Process process(directory.path());
  EXPECT_GE(process.loaded.size(), 180U);
  EXPECT_LT(process.loaded.size(), 200U);
  for (const auto& session : process.loaded)
    EXPECT_EQ(session.content,
              Bytes(100, static_cast<std::uint8_t>(std::stoi(session.id.substr(6)))));
  EXPECT_TRUE(process.reports(std::to_string(200 - process.loaded.size()) +
                              " sessions of MQTT-SN clients in"));
}

TEST(DiskSessionStore, DropsASessionWhoseOctetsHaveChanged) {
  const TempDir directory;
  {
    Process process(directory.path());
    process.save("r1", to_bytes("its content"));
    process.save("r2", to_bytes("another"));
  }
  const std::string path = StoreUser::newest_segment(directory.path(), "sessions");
  std::string octets = read_file(path);
  octets[octets.find("its content") + 5] = 'X';
  write_file(path, octets, 0600);
  Process process(directory.path());
  EXPECT_EQ(process.names(), "r2 ");
  EXPECT_TRUE(process.reports("1 sessions of MQTT-SN clients in"));
  process.store.stop();
  Process next(directory.path());
  next.save("r3", to_bytes("x"));
  EXPECT_TRUE(next.is_written());
  EXPECT_EQ(next.notices, "") << "reported once";
}

/// Sessions change all the time; one that never changes must not keep the others' records.
TEST(DiskSessionStore, DoesNotGrow) {
  const TempDir directory;
  {
    Process process(directory.path());
    process.save("rests", to_bytes("since long ago"));
    for (int i = 0; i < 400; ++i) {
      process.save("r" + std::to_string(i % 10), Bytes(20000, static_cast<std::uint8_t>(i)));
      ASSERT_TRUE(process.is_written());
    }
    std::uintmax_t bytes = 0;
    for (const auto& file : std::filesystem::directory_iterator(directory / "sessions"))
      bytes += file.file_size();
    EXPECT_LT(bytes, 3u << 20) << "8 MB were written";
  }
  Process process(directory.path());
  EXPECT_EQ(process.loaded.size(), 11U);
  EXPECT_EQ(process.loaded.back().content, to_bytes("since long ago"));
  EXPECT_EQ(process.loaded.front().content, Bytes(20000, static_cast<std::uint8_t>(390)));
}

TEST(DiskSessionStore, RestoresAnOldSegmentThatIsRemovedWhileItIsOpen) {
  const TempDir directory;
  { Process(directory.path()).save("rests", to_bytes("since long ago")); }
  const std::string old = StoreUser::newest_segment(directory.path(), "sessions");
  {
    Process process(directory.path());
    process.save("r1", to_bytes("x"));
    EXPECT_TRUE(process.is_written());
    std::filesystem::remove(old);
    process.save("r2", to_bytes("x"));
    EXPECT_TRUE(process.is_written());
  }
  Process process(directory.path());
  EXPECT_EQ(process.names(), "r1 r2 rests ");
  EXPECT_EQ(process.notices, "");
}

TEST(DiskSessionStore, WorksWithoutADirectoryAndReportsThat) {
  const TempDir directory;
  write_file(directory.path() + "/file", "");
  Process process(directory.path() + "/file/below");
  EXPECT_TRUE(process.loaded.empty());
  EXPECT_TRUE(process.reports("not kept"));
  process.save("r1", to_bytes("x"));
  process.store.stop();
}

/// A log whose segments hold one commit each, on a disk that may fail.
struct SmallLog {
  SmallLog() { reopen(); }
  RecordLog::Summary reopen() {
    log.reset();
    return log.emplace(path, 1).open(false);
  }
  void write(std::uint64_t key, std::size_t octets = 10) {
    log->put(key, Bytes(octets, 1));
    log->commit(false);
  }

  const FaultyDisk disk;
  const TempDir directory;
  const std::string path = directory.path() + "/log";
  std::optional<RecordLog> log;
};

std::set<std::string> segments_in(const std::string& directory) {
  std::set<std::string> found;
  for (const auto& entry : std::filesystem::directory_iterator(directory))
    if (entry.path().extension() == ".log") found.insert(entry.path());
  return found;
}

TEST(RecordLog, KeepsReplacedRecordsUntilTheNewOnesAreDurable) {
  for (const bool moves_records : {false, true}) {
    SmallLog small;
    if (moves_records) small.log->put(2, Bytes(10, 2));
    small.write(1, 4000);
    small.log->synchronise();
    const std::string first = *segments_in(small.path).begin();
    FaultyDisk::fails_syncs = true;
    small.write(1);
    EXPECT_EQ(segments_in(small.path).size(), moves_records ? 3U : 2U);
    EXPECT_THROW(small.log->synchronise(), LogError);
    small.write(3);
    EXPECT_TRUE(std::filesystem::exists(first)) << "it is still the only durable copy";
    FaultyDisk::fails_syncs = false;
    small.log->synchronise();
    small.write(4);
    EXPECT_FALSE(std::filesystem::exists(first));
  }
}

/// Linux reports a failed write once, and then counts the pages as written.
TEST(RecordLog, RewritesASegmentThatTheDiskFailedToWrite) {
  SmallLog small;
  small.write(1);
  const std::string segment = *segments_in(small.path).begin();
  FaultyDisk::fails_syncs = true;
  EXPECT_THROW(small.log->synchronise(), LogError);
  FaultyDisk::fails_syncs = false;
  const auto long_ago = std::filesystem::last_write_time(segment) - std::chrono::hours(1);
  std::filesystem::last_write_time(segment, long_ago);
  small.log->synchronise();
  EXPECT_GT(std::filesystem::last_write_time(segment), long_ago);
  std::filesystem::last_write_time(segment, long_ago);
  small.write(2);
  small.log->synchronise();
  EXPECT_EQ(std::filesystem::last_write_time(segment), long_ago) << "once is enough";
}

TEST(RecordLog, ErasesRecordsOfASegmentThatItFailedToRemove) {
  SmallLog small;
  small.write(1);
  small.write(2);
  FaultyDisk::fails_syncs = true;
  small.log->erase(1);
  small.log->commit(false);
  FaultyDisk::fails_syncs = false;
  EXPECT_EQ(segments_in(small.path).size(), 2U);
  small.reopen();
  EXPECT_FALSE(small.log->has(1));
  EXPECT_TRUE(small.log->has(2));
}

/// A full disk may have no room for the list of erased records, nor for a new segment.
TEST(RecordLog, FreesTheRoomOfItsLastRecordsAfterAFailedWrite) {
  SmallLog small;
  small.log->put(1, Bytes(1000, 1));
  small.log->put(2, Bytes(1000, 2));
  small.log->commit(true);
  const std::string segment = *segments_in(small.path).begin();
  FaultyDisk::fails_writes = true;
  small.log->put(3, Bytes(1000, 3));
  EXPECT_THROW(small.log->commit(true), LogError);
  FaultyDisk::fails_writes = false;
  small.log->erase(1);
  small.log->commit(true);
  EXPECT_GT(std::filesystem::file_size(segment), 2000U) << "one record is needed";
  small.log->erase(2);
  small.log->commit(true);
  EXPECT_EQ(std::filesystem::file_size(segment), 32U) << "the header";
  EXPECT_EQ(small.reopen().lost_at_most, 0U);
  EXPECT_EQ(small.log->last_key(), 2U);
  EXPECT_FALSE(small.log->has(1) || small.log->has(2));
  small.write(3);
  EXPECT_EQ(small.reopen().lost_at_most, 0U);
  EXPECT_TRUE(small.log->has(3));
}

TEST(RecordLog, LeavesNoFileForEachFailedCommit) {
  SmallLog small;
  small.log->put(1, Bytes(10, 1));
  small.log->commit(true);
  FaultyDisk::fails_syncs = true;
  for (int attempt = 0; attempt < 20; ++attempt) {
    small.log->put(2, Bytes(10, 2));
    EXPECT_THROW(small.log->commit(true), LogError);
  }
  EXPECT_LE(segments_in(small.path).size(), 2U);
  FaultyDisk::fails_syncs = false;
  small.log->put(3, Bytes(10, 3));
  small.log->commit(true);
  EXPECT_EQ(small.reopen().lost_at_most, 0U);
  EXPECT_TRUE(small.log->has(1));
  EXPECT_FALSE(small.log->has(2));
  EXPECT_TRUE(small.log->has(3));
}

}  // namespace
}  // namespace slamgw::test
