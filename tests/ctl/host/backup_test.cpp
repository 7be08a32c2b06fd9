// SPDX-License-Identifier: Apache-2.0
// A backup restores everything; a foreign archive writes nothing.
#include "ctl/host/archives.hpp"

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>

#include "ctl/connection.hpp"
#include "tests/storage/faulty_disk.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::ctl {
namespace {

namespace fs = std::filesystem;

/// A program that precedes the host's program in PATH.
class FakeProgram {
 public:
  FakeProgram(const fs::path& directory, const char* name, const std::string& script)
      : path_(std::getenv("PATH")) {
    fs::create_directories(directory);
    std::ofstream(directory / name) << "#!/bin/sh\n" << script << '\n';
    fs::permissions(directory / name, fs::perms::owner_all);
    setenv("PATH", (directory.string() + ":" + path_).c_str(), 1);
  }
  ~FakeProgram() { setenv("PATH", path_.c_str(), 1); }
  FakeProgram(const FakeProgram&) = delete;
  FakeProgram& operator=(const FakeProgram&) = delete;

 private:
  const std::string path_;
};

class Backup : public testing::Test {
 protected:
  Backup() {
    fs::create_directories(root() / "etc/gateway.d");
    fs::create_directories(root() / "state/messages");
    write("etc/gateway.json",
          R"({"store": {"directory": ")" + (root() / "state").string() + "\"}}");
    write("etc/gateway.d/site.json", R"({"broker": {"credentials_file": "credentials.json"}})");
    write("etc/credentials.json", R"({"username": "u", "password": "hush"})");
    fs::permissions(root() / "etc/credentials.json",
                    fs::perms::owner_read | fs::perms::owner_write);
    write("state/mesh.json", "the mesh's keys");
    write("state/messages/1.log", "messages");
  }

  fs::path root() const { return directory_.path(); }
  std::string archive() const { return root() / "backup.tar.gz"; }
  Installation installation() const { return Installation(root() / "etc/gateway.json"); }
  /// Makes a `systemctl` that shows `state` as the service's ActiveState. It writes the other verbs
  /// to the file `calls`.
  FakeProgram fake_systemctl(const std::string& state) const {
    return {root() / "bin", "systemctl",
            "case $1 in show) echo " + state + " ;; *) echo \"$1\" >> " +
                (root() / "calls").string() + " ;; esac"};
  }
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
    return status.st_mode & 07777U;
  }
  static bool yes(const std::string&) { return true; }
  std::string restored() const { return restore(installation(), archive(), yes); }
  /// Adds a file to a valid backup, as `tar` would.
  void add_to_archive(const fs::path& file) const {
    run_or_fail({"gunzip", archive()});
    run_or_fail({"tar", "-rf", root() / "backup.tar", "-C", root() / "evil", file.string()});
    run_or_fail({"gzip", root() / "backup.tar"});
  }
  /// Changes a member of the manifest in a valid backup.
  void rewrite_manifest(const std::string& key, const std::string& value) {
    run_or_fail({"gunzip", archive()});
    const std::string tar = root() / "backup.tar";
    const char* const name = "slam-gateway-backup.json";
    auto manifest = nlohmann::json::parse(run_or_fail({"tar", "-xOf", tar, name}));
    manifest[key] = value;
    write(name, manifest.dump());
    run_or_fail({"tar", "--delete", "-f", tar, name});
    run_or_fail({"tar", "-rf", tar, "-C", root(), name});
    run_or_fail({"gzip", tar});
  }
  std::string refusal() const {
    try {
      restored();
      return "";
    } catch (const Failure& failure) {
      return failure.what();
    }
  }

  test::TempDir directory_;
};

TEST_F(Backup, RestoresAllFilesAndModes) {
  const std::string output = backup(installation(), archive());
  EXPECT_NE(output.find("slam-gatewayctl restore --config " +
                        (root() / "etc/gateway.json").string() + " " + archive() + "\n"),
            output.npos)
      << output;
  EXPECT_EQ(output.find("ran during the copy"), output.npos);
  EXPECT_EQ(mode("backup.tar.gz"), 0600U);
  fs::remove_all(root() / "state");
  fs::remove_all(root() / "etc/gateway.d");
  fs::remove(root() / "etc/credentials.json");
  struct stat before {};
  struct stat after {};
  stat("/", &before);
  const auto mode_before = fs::status(root()).permissions();
  const std::string back = restored();
  EXPECT_EQ(back.find("is called"), back.npos) << "on a host of the same name";
  stat("/", &after);
  EXPECT_EQ(after.st_mode, before.st_mode) << "the directories above keep their modes";
  EXPECT_EQ(fs::status(root()).permissions(), mode_before);
  EXPECT_EQ(read("state/mesh.json"), "the mesh's keys");
  EXPECT_EQ(read("state/messages/1.log"), "messages");
  EXPECT_NE(read("etc/credentials.json").find("hush"), std::string::npos);
  EXPECT_EQ(mode("etc/credentials.json"), 0600U);
  EXPECT_EQ(mode("state"), 0700U);
  EXPECT_EQ(installation().state(), root() / "state");
}

TEST_F(Backup, FilesMayChangeDuringTheCopy) {
  {
    const FakeProgram tar(root() / "bin", "tar", "/bin/tar \"$@\"; exit 1");
    const std::string output = backup(installation(), archive());
    EXPECT_NE(output.find("changed during the copy"), output.npos) << output;
  }
  write("state/mesh.json", "others");
  EXPECT_EQ(refusal(), "");
  EXPECT_EQ(read("state/mesh.json"), "the mesh's keys");
  fs::remove(archive());
  const FakeProgram tar(root() / "bin", "tar", "/bin/tar \"$@\"; exit 2");
  EXPECT_THROW(backup(installation(), archive()), Failure);
  EXPECT_FALSE(fs::exists(archive()));
}

TEST_F(Backup, RestoresEmptyDropInDirectory) {
  fs::remove(root() / "etc/gateway.d/site.json");
  backup(installation(), archive());
  fs::remove(root() / "etc/gateway.d");
  restored();
  EXPECT_EQ(mode("etc/gateway.d"), 0755U);
}

TEST_F(Backup, DoesNotOverwriteExistingFile) {
  backup(installation(), archive());
  const std::string before = test::read_file(archive());
  EXPECT_THROW(backup(installation(), archive()), Failure);
  EXPECT_EQ(test::read_file(archive()), before);
}

TEST_F(Backup, RestoreKeepsReplacedFiles) {
  backup(installation(), archive());
  write("state/messages/1.log", "newer messages");
  write("state/messages/2.log", "newer messages, too");
  const std::string output = restored();
  EXPECT_EQ(read("state/messages/1.log"), "messages");
  EXPECT_FALSE(fs::exists(root() / "state/messages/2.log"));
  const auto at = output.find((root() / "state").string() + ".before-restore-");
  ASSERT_NE(at, output.npos);
  const std::string kept = output.substr(at, output.find(" now", at) - at);
  EXPECT_EQ(test::read_file(kept + "/messages/2.log"), "newer messages, too");
}

TEST_F(Backup, FailedRestoreRollsBack) {
  backup(installation(), archive());
  fs::remove(root() / "state/mesh.json");
  fs::create_directory(root() / "state/mesh.json");  // which no file can replace
  write("state/messages/1.log", "newer messages");
  write("etc/credentials.json", R"({"username": "new", "password": "new"})");
  const std::string output = refusal();
  EXPECT_NE(output.find("nothing was restored; your files are as before"), output.npos) << output;
  EXPECT_EQ(read("state/messages/1.log"), "newer messages");
  EXPECT_EQ(read("etc/credentials.json"), R"({"username": "new", "password": "new"})");
  EXPECT_TRUE(installation().parsed().problems.empty());
  for (const auto& entry : fs::recursive_directory_iterator(root()))
    EXPECT_EQ(entry.path().string().find(".before-restore-"), std::string::npos) << entry.path();
}

TEST_F(Backup, RestoresStateDirectoryOnAnotherFilesystem) {
  std::string other = "/dev/shm/slam-gateway-backup-XXXXXX";
  if (mkdtemp(other.data()) == nullptr) GTEST_SKIP() << "no /dev/shm";
  backup(installation(), archive());
  fs::remove_all(root() / "state");
  fs::create_symlink(other, root() / "state");
  write("state/mesh.json", "newer keys");
  const std::string output = restored();
  EXPECT_EQ(read("state/mesh.json"), "the mesh's keys");
  const auto at = output.find((root() / "state").string() + "/.before-restore-");
  const std::string kept =
      at == output.npos
          ? ""
          : test::read_file(output.substr(at, output.find(" now", at) - at) + "/mesh.json");
  fs::remove_all(other);
  EXPECT_EQ(kept, "newer keys") << output;
}

TEST_F(Backup, RestartsServiceAfterCtrlC) {
  const auto systemctl = fake_systemctl("active");
  {
    const ServicePause pause(Installation{service_configuration});
    for (const int number : {SIGINT, SIGTERM, SIGHUP, SIGPIPE}) raise(number);
    EXPECT_EQ(read("calls"), "stop\n");
  }
  EXPECT_EQ(read("calls"), "stop\nstart\n");
  struct sigaction now {};
  ASSERT_EQ(sigaction(SIGINT, nullptr, &now), 0);
  EXPECT_EQ(now.sa_handler, SIG_DFL);
}

TEST_F(Backup, StopsServiceInTransition) {
  for (const char* const state : {"activating", "reloading", "deactivating"}) {
    const auto systemctl = fake_systemctl(state);
    { const ServicePause pause(Installation{service_configuration}); }
    EXPECT_EQ(read("calls"), "stop\nstart\n") << state;
    fs::remove(root() / "calls");
  }
}

TEST_F(Backup, DoesNotStartStoppedService) {
  for (const char* const state : {"inactive", "failed"}) {
    const auto systemctl = fake_systemctl(state);
    { const ServicePause pause(Installation{service_configuration}); }
    EXPECT_FALSE(fs::exists(root() / "calls")) << state;
  }
}

TEST_F(Backup, ReportHasNewestPartOfLongJournal) {
  const FakeProgram journalctl(
      root() / "bin", "journalctl",
      "head -c 6000000 /dev/zero | tr '\\0' x; echo; echo the newest line");
  report(installation(), root() / "no.sock", root() / "report.tar.gz");
  run_or_fail({"tar", "-xzf", root() / "report.tar.gz", "-C", root()});
  EXPECT_TRUE(read("slam-gateway-report/journal.txt").ends_with("x\nthe newest line\n"));
}

TEST_F(Backup, BelongsToUserOfSudo) {
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

/// A directory for uploads, for example.
TEST_F(Backup, WritesIntoDirectoryThatItCannotRead) {
  const test::TempDir uploads;
  chmod(uploads.path().c_str(), 0333);
  constexpr uid_t ordinary_user = 65534;
  const bool is_root = geteuid() == 0;
  if (is_root) {  // root reads every directory
    ASSERT_EQ(seteuid(ordinary_user), 0);
  }
  EXPECT_NO_THROW(NewFile(uploads / "file").finish());
  if (is_root) {
    ASSERT_EQ(seteuid(0), 0);
  }
  chmod(uploads.path().c_str(), 0700);
  EXPECT_TRUE(fs::exists(uploads / "file"));
}

TEST_F(Backup, FailsAndRemovesFileWhenDiskFails) {
  const test::FaultyDisk disk;
  test::FaultyDisk::fails_syncs = true;
  EXPECT_THROW(backup(installation(), archive()), Failure);
  EXPECT_FALSE(fs::exists(archive()));
}

TEST_F(Backup, RestoreReportsDifferentGatewayName) {
  backup(installation(), archive());
  rewrite_manifest("gateway", "old-pi");
  const std::string output = restored();
  EXPECT_NE(output.find("in the backup it was 'old-pi'"), output.npos) << output;
  EXPECT_NE(output.find(R"({"gateway": {"id": "old-pi"}})"), output.npos) << output;
}

TEST_F(Backup, RefusesInvalidArchiveAndInvalidPath) {
  write("other", "no archive");
  EXPECT_THROW(restore(installation(), root() / "other", yes), Failure);
  EXPECT_THROW(restore(installation(), root() / "missing", yes), Failure);
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

TEST_F(Backup, FailsWithoutConfigurationFile) {
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

TEST_F(Backup, AsksBeforeReplacingFiles) {
  backup(installation(), archive());
  const auto never = [](const std::string& files) -> bool {
    ADD_FAILURE() << files;
    return false;
  };
  restore(installation(), archive(), never);  // the same files
  write("state/mesh.json", "newer keys");
  write("state/stays", "unrelated");
  std::string asked;
  const auto no = [&](const std::string& files) {
    asked = files;
    return false;
  };
  EXPECT_THROW(restore(installation(), archive(), no), Failure);
  const std::string state = "  " + (root() / "state").string();
  EXPECT_EQ(asked, state + "/mesh.json\n" + state + "/stays\n");
  EXPECT_EQ(read("state/mesh.json"), "newer keys");
}

TEST_F(Backup, RefusesAnArchiveThatWritesElsewhere) {
  fs::create_directories(root() / "evil/tmp");
  write("evil/tmp/slam-gateway-evil", "x");
  backup(installation(), archive());
  add_to_archive("tmp/slam-gateway-evil");
  EXPECT_NE(refusal().find("/tmp/slam-gateway-evil, which is not a file of the gateway here"),
            std::string::npos)
      << refusal();
  EXPECT_FALSE(fs::exists("/tmp/slam-gateway-evil"));
  EXPECT_EQ(read("state/mesh.json"), "the mesh's keys");
}

TEST_F(Backup, RefusesStateDirectoryOfAnotherConfiguration) {
  backup(installation(), archive());
  fs::create_directories(root() / "home/.ssh");
  write("home/.ssh/authorized_keys", "the owner's");
  rewrite_manifest("state", (root() / "home/.ssh").string());
  EXPECT_NE(refusal().find("set store.directory in"), std::string::npos) << refusal();
  EXPECT_EQ(read("home/.ssh/authorized_keys"), "the owner's");
}

TEST_F(Backup, RefusesFileThatOnlyManifestNames) {
  fs::create_directories(root() / "cron.d");
  fs::create_directories(fs::path(root().string() + "/evil" + root().string() + "/cron.d"));
  const std::string cron = root().string().substr(1) + "/cron.d/evil";
  write("evil/" + cron, "* * * * * root id");
  backup(installation(), archive());
  rewrite_manifest("elsewhere", "/" + cron);
  add_to_archive(cron);
  EXPECT_NE(refusal().find("not a file of the gateway here"), std::string::npos) << refusal();
  EXPECT_FALSE(fs::exists(root() / "cron.d/evil"));
}

TEST_F(Backup, RefusesLinksAndHiddenFiles) {
  const std::string state = (root() / "state").string().substr(1);
  fs::create_directories(root() / "evil" / state / ".ssh");
  write("evil/" + state + "/.ssh/authorized_keys", "key");
  fs::create_symlink("/etc", root() / "evil" / state / "link");
  ASSERT_EQ(mkfifo((root() / "evil" / state / "fifo").c_str(), 0600), 0);
  const std::pair<const char*, const char*> attacks[] = {
      {"/.ssh/authorized_keys", "not a file of the gateway here"},
      {"/link", "a link or a device"},
      {"/fifo", "a link or a device"}};
  for (const auto& [file, words] : attacks) {
    fs::remove(archive());
    backup(installation(), archive());
    add_to_archive(state + file);
    EXPECT_NE(refusal().find(words), std::string::npos) << file << ": " << refusal();
  }
}

/// The service owns its state; root restores it.
TEST_F(Backup, FollowsNoLinkInStateDirectory) {
  backup(installation(), archive());
  fs::remove_all(root() / "state/messages");
  fs::create_directory(root() / "elsewhere");
  write("elsewhere/1.log", "of another program");
  fs::create_directory_symlink(root() / "elsewhere", root() / "state/messages");
  const std::string output = refusal();
  EXPECT_NE(output.find("state/messages is a link"), output.npos) << output;
  EXPECT_EQ(read("elsewhere/1.log"), "of another program");
  EXPECT_EQ(read("state/mesh.json"), "the mesh's keys");
}

TEST_F(Backup, ReportReplacesNoDevice) {
  const std::string pipe = root() / "pipe";
  ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  EXPECT_THROW(report(installation(), "", pipe), Failure);
  EXPECT_TRUE(fs::is_fifo(pipe));
}

TEST_F(Backup, RestoresFilesWithSafeModes) {
  backup(installation(), archive());
  fs::create_directories(root() / "evil" / (root() / "state").relative_path());
  const fs::path evil = fs::path((root() / "state").string().substr(1)) / "mesh.json";
  write("evil" / evil, "setuid");
  chmod((root() / "evil" / evil).c_str(), 06777);
  add_to_archive(evil);
  EXPECT_EQ(refusal(), "");
  EXPECT_EQ(read("state/mesh.json"), "setuid");
  EXPECT_EQ(mode("state/mesh.json"), 0600U);
}

TEST_F(Backup, RestoresFilesThatConfigurationNames) {
  fs::create_directories(root() / "keys");
  write("keys/ca.pem", "a certificate");
  write("keys/note.txt", "a note");
  write("etc/gateway.d/tls.json",
        R"({"broker": {"tls": {"ca_file": ")" + (root() / "keys/ca.pem").string() +
            R"("}}, "web": {"note_file": ")" + (root() / "keys/note.txt").string() + "\"}}");
  backup(installation(), archive());
  write("keys/ca.pem", "another one");
  fs::remove(root() / "keys/note.txt");
  EXPECT_EQ(refusal(), "");
  EXPECT_EQ(read("keys/ca.pem"), "a certificate");
  EXPECT_EQ(read("keys/note.txt"), "a note");
  fs::remove(root() / "etc/gateway.d/tls.json");
  EXPECT_NE(refusal().find("name the file in"), std::string::npos) << "a new host";
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

TEST(Program, ReportsStatusAndBoundedOutput) {
  EXPECT_EQ(run_program({"slam-gateway-no-such-program"}).status, 127);
  EXPECT_EQ(run_program({"sh", "-c", "echo out; echo err >&2; exit 3"}).output, "out\nerr\n");
  EXPECT_EQ(run_program({"sh", "-c", "exit 3"}).status, 3);
  EXPECT_THROW(run_or_fail({"false"}), Failure);
  const std::string much = run_program({"head", "-c", "6000000", "/dev/zero"}).output;
  EXPECT_TRUE(much.ends_with("\n(cut)\n"));
}

}  // namespace
}  // namespace slamgw::ctl
