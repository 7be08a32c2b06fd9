// SPDX-License-Identifier: Apache-2.0
// A backup brings everything back; an archive from elsewhere writes nothing.
#include "ctl/host/backup.hpp"

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <iterator>

#include "ctl/connection.hpp"
#include "ctl/host/program.hpp"
#include "ctl/host/report.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::ctl {
namespace {

namespace fs = std::filesystem;

class Backup : public testing::Test {
 protected:
  Backup() {
    fs::create_directories(root() / "etc/gateway.d");
    fs::create_directories(root() / "state");
    write("etc/gateway.json",
          R"({"store": {"directory": ")" + (root() / "state").string() + "\"}}");
    write("etc/gateway.d/site.json", R"({"broker": {"credentials_file": "credentials.json"}})");
    write("etc/credentials.json", R"({"username": "u", "password": "hush"})");
    fs::permissions(root() / "etc/credentials.json",
                    fs::perms::owner_read | fs::perms::owner_write);
    write("state/mesh.json", "the mesh's keys");
    write("state/messages.db", "messages");
  }

  fs::path root() const { return directory_.path(); }
  std::string archive() const { return root() / "backup.tar.gz"; }
  Installation installation() const { return Installation(root() / "etc/gateway.json"); }
  void write(const std::string& name, const std::string& text) {
    std::ofstream(root() / name) << text;
  }
  std::string read(const std::string& name) const {
    std::ifstream file(root() / name);
    return {std::istreambuf_iterator<char>(file), {}};
  }
  unsigned mode(const std::string& name) const {
    struct stat status {};
    stat((root() / name).c_str(), &status);
    return status.st_mode & 0777U;
  }

  test::TempDir directory_;
};

TEST_F(Backup, BringsEverythingBack) {
  const std::string told = backup(installation(), archive());
  EXPECT_NE(told.find(archive()), told.npos);
  EXPECT_EQ(mode("backup.tar.gz"), 0600U);
  fs::remove_all(root() / "state");
  fs::remove_all(root() / "etc");
  struct stat before {};
  struct stat after {};
  stat("/", &before);
  const auto mode_before = fs::status(root()).permissions();
  const std::string back = restore(installation(), archive());
  EXPECT_EQ(back.find("is called"), back.npos) << "on a host of the same name";
  stat("/", &after);
  EXPECT_EQ(after.st_mode, before.st_mode) << "of the directories above nothing changes";
  EXPECT_EQ(fs::status(root()).permissions(), mode_before);
  EXPECT_EQ(read("state/mesh.json"), "the mesh's keys");
  EXPECT_EQ(read("state/messages.db"), "messages");
  EXPECT_NE(read("etc/credentials.json").find("hush"), std::string::npos);
  EXPECT_EQ(mode("etc/credentials.json"), 0600U);
  EXPECT_EQ(mode("state"), 0700U);
  EXPECT_EQ(installation().state(), root() / "state");
}

TEST_F(Backup, KeepsWhatARestoreReplaces) {
  backup(installation(), archive());
  write("state/messages.db", "newer messages");
  write("state/messages.db-wal", "newer log");
  const std::string told = restore(installation(), archive());
  EXPECT_EQ(read("state/messages.db"), "messages");
  EXPECT_FALSE(fs::exists(root() / "state/messages.db-wal"));
  const auto at = told.find((root() / "state").string() + ".before-restore-");
  ASSERT_NE(at, told.npos);
  const std::string aside = told.substr(at, told.find(" now", at) - at);
  EXPECT_EQ(test::read_file(aside + "/messages.db-wal"), "newer log");
}

TEST_F(Backup, BelongsToWhoTypedSudo) {
  if (geteuid() != 0) GTEST_SKIP() << "only root can give files away";
  constexpr unsigned nobody = 65534;
  setenv("SUDO_UID", "65534", 1);
  setenv("SUDO_GID", "65534", 1);
  backup(installation(), archive());
  report(installation(), root() / "no.sock", root() / "report.tar.gz");
  setenv("SUDO_UID", "x", 1);
  backup(installation(), root() / "roots.tar.gz");
  unsetenv("SUDO_UID");
  unsetenv("SUDO_GID");
  for (const char* const name : {"backup.tar.gz", "report.tar.gz"}) {
    struct stat status {};
    stat((root() / name).c_str(), &status);
    EXPECT_EQ(status.st_uid, nobody) << name;
    EXPECT_EQ(status.st_gid, nobody) << name;
    EXPECT_EQ(mode(name), 0600U) << name;
  }
  struct stat status {};
  stat((root() / "roots.tar.gz").c_str(), &status);
  EXPECT_EQ(status.st_uid, 0U);
}

TEST_F(Backup, SaysThatTheGatewayGetsAnotherName) {
  backup(installation(), archive());
  run_or_fail({"gunzip", archive()});
  const std::string tar = root() / "backup.tar";
  const std::string manifest = run_or_fail({"tar", "-xOf", tar, "slam-gateway-backup.json"});
  const std::size_t at = manifest.find("\"gateway\": \"") + 12;
  ASSERT_LT(at, manifest.size());
  write("slam-gateway-backup.json",
        manifest.substr(0, at) + "old-pi" + manifest.substr(manifest.find('"', at)));
  run_or_fail({"tar", "--delete", "-f", tar, "slam-gateway-backup.json"});
  run_or_fail({"tar", "-rf", tar, "-C", root(), "slam-gateway-backup.json"});
  run_or_fail({"gzip", tar});
  const std::string told = restore(installation(), archive());
  EXPECT_NE(told.find("in the backup it was 'old-pi'"), told.npos) << told;
  EXPECT_NE(told.find(R"({"gateway": {"id": "old-pi"}})"), told.npos) << told;
}

TEST_F(Backup, RefusesWhatIsNone) {
  write("other", "no archive");
  EXPECT_THROW(restore(installation(), root() / "other"), Failure);
  EXPECT_THROW(restore(installation(), root() / "missing"), Failure);
  EXPECT_THROW(backup(installation(), root() / "no/such/directory"), Failure);
  try {
    report(installation(), "no.sock", "/no/such/report");
    FAIL();
  } catch (const Failure& failure) {
    EXPECT_STREQ(failure.what(), "/no/such/report: No such file or directory");
  }
  try {
    report(installation(), "no.sock", root());
    FAIL();
  } catch (const Failure& failure) {
    EXPECT_EQ(failure.what(), root().string() + " is a directory; name a file in it");
  }
  EXPECT_EQ(read("state/mesh.json"), "the mesh's keys");
}

TEST_F(Backup, NeedsTheConfigurationThatItIsToKeep) {
  const Installation mistyped(root() / "etc/gatway.json");
  try {
    backup(mistyped, archive());
    FAIL();
  } catch (const Failure& failure) {
    EXPECT_EQ(failure.what(), (root() / "etc/gatway.json").string() +
                                  ": No such file or directory; nothing was written");
  }
  EXPECT_FALSE(fs::exists(archive()));
}

TEST_F(Backup, RefusesAnArchiveThatWritesElsewhere) {
  backup(installation(), archive());
  fs::create_directories(root() / "evil/tmp");
  write("evil/tmp/slam-gateway-evil", "x");
  run_or_fail({"gunzip", archive()});
  run_or_fail(
      {"tar", "-rf", root() / "backup.tar", "-C", root() / "evil", "tmp/slam-gateway-evil"});
  run_or_fail({"gzip", root() / "backup.tar"});
  EXPECT_THROW(restore(installation(), archive()), Failure);
  EXPECT_FALSE(fs::exists("/tmp/slam-gateway-evil"));
}

TEST_F(Backup, ReportHasNoSecret) {
  write("etc/gateway.d/oob.json",
        R"({"ble_mesh": {"provisioning": {"static_oob": "00112233445566778899aabbccddeeff"}}})");
  report(installation(), root() / "no.sock", root() / "report.tar.gz");
  EXPECT_EQ(mode("report.tar.gz"), 0600U);
  const std::string text = run_or_fail({"tar", "-xzOf", root() / "report.tar.gz"});
  EXPECT_NE(text.find("slam-gatewayctl"), text.npos);
  EXPECT_NE(text.find("(not shown)"), text.npos);
  EXPECT_EQ(text.find("00112233445566778899aabbccddeeff"), text.npos);
  EXPECT_EQ(text.find("hush"), text.npos);
}

TEST(Program, TellsWhatWentWrong) {
  EXPECT_EQ(run_program({"slam-gateway-no-such-program"}).status, 127);
  EXPECT_EQ(run_program({"sh", "-c", "echo out; echo err >&2; exit 3"}).output, "out\nerr\n");
  EXPECT_EQ(run_program({"sh", "-c", "exit 3"}).status, 3);
  EXPECT_THROW(run_or_fail({"false"}), Failure);
}

}  // namespace
}  // namespace slamgw::ctl
