// SPDX-License-Identifier: Apache-2.0
// Sessions on a real file: what comes back, who may read it, and what damage does.
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>

#include "daemon/storage/sqlite_session_store.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::test {
namespace {

/// One process's store.
struct Process {
  explicit Process(const std::string& directory)
      : store(io, directory, [this](const Notice& notice) { notices += notice.text + "\n"; }),
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

void write_file(const std::string& path, const std::string& text) {
  std::ofstream(path, std::ios::binary) << text;
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
  std::size_t aside = 0;
  for (const auto& entry : std::filesystem::directory_iterator(directory.path()))
    aside += entry.path().string().find("sessions.db.corrupt-") != std::string::npos ? 1 : 0;
  EXPECT_EQ(aside, 1U);
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
