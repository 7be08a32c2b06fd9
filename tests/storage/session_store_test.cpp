// SPDX-License-Identifier: Apache-2.0
// Sessions on a real file: what comes back, who may read it, and what damage does.
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <thread>

#include "daemon/storage/sqlite_session_store.hpp"
#include "tests/storage/faulty_disk.hpp"
#include "tests/storage/store_user.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::test {
namespace {

/// One process's store.
struct Process {
  explicit Process(const std::string& directory)
      : store(
            io, directory, [this](const Notice& notice) { notices += notice.text + "\n"; },
            short_patience),
        loaded(store.load()) {}

  void save(const std::string& id, std::optional<Bytes> content) {
    store.save({{id, std::move(content)}});
  }
  bool is_written() {
    return eventually(io, [this] { return !store.is_busy(); });
  }
  bool says(const std::string& text) {
    return eventually(io, [&] { return notices.find(text) != std::string::npos; });
  }
  std::string names() const {
    std::string all;
    for (const auto& session : loaded) all += session.id + " ";
    return all;
  }

  boost::asio::io_context io;
  std::string notices;
  SqliteSessionStore store;
  std::vector<SessionStore::Session> loaded;
};

std::size_t count_aside(const std::string& directory) {
  std::size_t count = 0;
  for (const auto& entry : std::filesystem::directory_iterator(directory))
    count += entry.path().string().find("sessions.db.corrupt-") != std::string::npos ? 1 : 0;
  return count;
}

TEST(SqliteSessionStore, BringsBackTheLastOfEachSession) {
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

TEST(SqliteSessionStore, KeepsWhatIsWrittenWhenTheProcessDies) {
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

TEST(SqliteSessionStore, TellsWhatBecameOfEachWrite) {
  const TempDir directory;
  std::vector<bool> told;
  {
    Process process(directory.path());
    process.store.watch([&](bool is_written) { told.push_back(is_written); });
    process.save("r1", to_bytes("x"));
    EXPECT_TRUE(told.empty()) << "never from inside the call";
    EXPECT_TRUE(eventually(process.io, [&] { return !told.empty(); }));
  }
  EXPECT_EQ(told, std::vector<bool>{true});
  Process without("/proc/nowhere");
  without.store.watch([&](bool is_written) { told.push_back(is_written); });
  without.save("r1", to_bytes("x"));
  EXPECT_TRUE(eventually(without.io, [&] { return told.size() > 2; })) << "it is tried again";
  EXPECT_FALSE(told[1]);
  EXPECT_FALSE(told[2]);
}

TEST(SqliteSessionStore, IsReadableForItsOwnerOnly) {
  const TempDir directory;
  Process process(directory.path() + "/made");
  struct stat status {};
  ASSERT_EQ(stat((directory.path() + "/made/sessions.db").c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777, 0600U);
}

TEST(SqliteSessionStore, MovesADamagedFileAsideAndGoesOn) {
  const TempDir directory;
  write_file(directory.path() + "/sessions.db", std::string(5000, 'x'));
  {
    Process process(directory.path());
    EXPECT_TRUE(process.loaded.empty());
    EXPECT_TRUE(process.says("damaged"));
    process.save("r1", to_bytes("x"));
  }
  EXPECT_EQ(Process(directory.path()).names(), "r1 ");
  EXPECT_EQ(count_aside(directory.path()), 1U);
}

TEST(SqliteSessionStore, WaitsForADiskThatFailsForAMoment) {
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
  EXPECT_EQ(count_aside(directory.path()), 0U);
}

TEST(SqliteSessionStore, SavesWhatIsLeftOfADamagedFile) {
  const TempDir directory;
  {
    Process process(directory.path());
    for (int i = 100; i < 300; ++i)
      process.save("robot-" + std::to_string(i), Bytes(100, static_cast<std::uint8_t>(i)));
  }
  for (const std::size_t page : {0, 1, 4}) {
    std::fstream file(directory / "sessions.db", std::ios::in | std::ios::out | std::ios::binary);
    file.seekp(static_cast<std::streamoff>(page * 4096));
    file << std::string(512, '\0');
  }
  Process process(directory.path());
  EXPECT_GE(process.loaded.size(), 120U);
  EXPECT_LT(process.loaded.size(), 200U);
  for (const auto& session : process.loaded)
    EXPECT_EQ(session.content,
              Bytes(100, static_cast<std::uint8_t>(std::stoi(session.id.substr(6)))));
  EXPECT_TRUE(process.says(std::to_string(process.loaded.size()) + " were saved"));
}

TEST(SqliteSessionStore, DropsASessionWhoseOctetsHaveChanged) {
  const TempDir directory;
  {
    Process process(directory.path());
    process.save("r1", to_bytes("its content"));
    process.save("r2", to_bytes("another"));
  }
  std::string octets = read_file(directory / "sessions.db");
  octets[octets.find("its content") + 5] = 'X';
  write_file(directory / "sessions.db", octets, 0600);
  Process process(directory.path());
  EXPECT_EQ(process.names(), "r2 ");
  EXPECT_TRUE(process.says("1 sessions in"));
  EXPECT_EQ(Process(directory.path()).notices, "") << "told once";
}

TEST(SqliteSessionStore, TakesOverTheFileOfThePreviousVersion) {
  const TempDir directory;
  write_file(directory / "sessions.db", "", 0600);
  {
    SqliteDatabase file(directory / "sessions.db", 0);
    file.execute(
        "CREATE TABLE sessions(id TEXT PRIMARY KEY, content BLOB NOT NULL) WITHOUT ROWID; INSERT "
        "INTO sessions VALUES('r1', x'0102'); PRAGMA user_version = 1");
  }
  for (int process = 0; process < 2; ++process) {
    Process next(directory.path());
    ASSERT_EQ(next.names(), "r1 ");
    EXPECT_EQ(next.loaded[0].content, (Bytes{1, 2}));
  }
}

TEST(SqliteSessionStore, LeavesTheFileOfANewerVersionAlone) {
  const TempDir directory;
  const std::string path = directory.path() + "/sessions.db";
  { Process process(directory.path()); }
  {
    SqliteDatabase database(path, 0);
    database.execute("PRAGMA user_version = 99");
  }
  Process process(directory.path());
  EXPECT_TRUE(process.says("newer version"));
  process.save("r1", to_bytes("x"));
  process.store.stop();
  SqliteDatabase database(path, 0);
  EXPECT_EQ(database.query_number("PRAGMA user_version"), 99);
  EXPECT_EQ(database.query_number("SELECT count(*) FROM sessions"), 0);
}

TEST(SqliteSessionStore, WorksWithoutADirectoryAndSaysSo) {
  const TempDir directory;
  write_file(directory.path() + "/file", "");
  Process process(directory.path() + "/file/below");
  EXPECT_TRUE(process.loaded.empty());
  EXPECT_TRUE(process.says("not kept"));
  process.save("r1", to_bytes("x"));
  process.store.stop();
}

}  // namespace
}  // namespace slamgw::test
