// SPDX-License-Identifier: Apache-2.0
#include "ctl/host/installation.hpp"

#include <nlohmann/json.hpp>

#include <fcntl.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spawn.h>
#include <sys/file.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <string_view>
#include <thread>
#include <utility>

#include "ctl/connection.hpp"
#include "daemon/core/bans.hpp"
#include "daemon/core/parse_number.hpp"

extern char** environ;

namespace slamgw::ctl {

namespace fs = std::filesystem;

namespace {

constexpr std::size_t max_output_bytes = std::size_t{4} << 20;
constexpr std::chrono::seconds lock_patience{10};
constexpr std::chrono::milliseconds lock_retry{20};
constexpr int exit_not_started = 127;  // as a shell reports it
constexpr int exit_signal = 128;

/// Also reads output that does not fit, and drops it: else the program would wait for ever.
std::string read_all(int pipe) {
  std::string output;
  bool is_cut = false;
  std::array<char, 4096> chunk{};
  while (true) {
    const ssize_t count = read(pipe, chunk.data(), chunk.size());
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) return is_cut ? output + "\n(cut)\n" : output;
    const std::size_t room = max_output_bytes - output.size();
    is_cut = is_cut || static_cast<std::size_t>(count) > room;
    output.append(chunk.data(), std::min(room, static_cast<std::size_t>(count)));
  }
}

int wait_for(pid_t child) {
  int status = 0;
  while (waitpid(child, &status, 0) < 0)
    if (errno != EINTR) return exit_not_started;
  return WIFEXITED(status) ? WEXITSTATUS(status) : exit_signal + WTERMSIG(status);
}

/// Returns the path of `file` in `directory`; empty when the file lies elsewhere, is hidden, or
/// lies in a hidden directory.
fs::path place_in(const fs::path& directory, const fs::path& file) {
  const fs::path place = file.lexically_relative(directory);
  const auto is_hidden = [](const fs::path& part) { return part.string().starts_with('.'); };
  return std::ranges::any_of(place, is_hidden) ? fs::path() : place;
}

void add_files(std::vector<fs::path>& files, const fs::path& directory) {
  std::error_code error;
  for (const auto& entry : fs::recursive_directory_iterator(directory, error))
    files.push_back(entry.path());
}

}  // namespace

Installation::Installation(std::string configuration)
    : configuration_(fs::absolute(std::move(configuration)).lexically_normal().string()),
      parsed_(load_config(configuration_)) {
  for (const char* const name : {"credentials.json", "web-credentials.json"})
    named_.push_back(etc() / name);
  for (const NamedFile& file : named_files(parsed_.config))
    named_.push_back(fs::absolute(file.path).lexically_normal());
}

fs::path Installation::state() const {
  return fs::absolute(parsed_.config.store.directory).lexically_normal();
}

bool Installation::is_state(const fs::path& file) const { return !place_in(state(), file).empty(); }

bool Installation::is_settings(const fs::path& file) const {
  return file == configuration_ || (file.parent_path() == site() && file.extension() == ".json") ||
         std::ranges::find(named_, file) != named_.end() ||
         (is_service() && !place_in(etc(), file).empty());
}

bool Installation::is_key_file(const fs::path& file) const {
  const auto& keys = parsed_.config.mqttsn.dtls.keys_file;
  return keys && fs::absolute(*keys).lexically_normal() == file;
}

std::vector<fs::path> Installation::files() const {
  std::vector<fs::path> files = named_;
  files.emplace_back(configuration_);
  add_files(files, site());
  if (is_service()) add_files(files, etc());
  add_files(files, state());
  std::ranges::sort(files);
  files.erase(std::unique(files.begin(), files.end()), files.end());
  std::erase_if(files, [this](const fs::path& file) {
    std::error_code error;  // the service can make links in its state; these must not name files
    const auto status = is_state(file) ? fs::symlink_status(file, error) : fs::status(file, error);
    return !fs::is_regular_file(status) || !owns(file);
  });
  return files;
}

/// Locks a file of its own: every user can open, and so lock, the directory.
DirectoryLock::DirectoryLock(const fs::path& directory) {
  const std::string name = directory / ".lock";
  file_ = open(name.c_str(), O_RDWR | O_CREAT | O_NOFOLLOW | O_CLOEXEC, 0600);
  if (file_ < 0)
    throw Failure(fmt::format("{}: {}{}", name, std::strerror(errno),
                              errno == EACCES ? "; type the command with sudo" : ""));
  const auto until = std::chrono::steady_clock::now() + lock_patience;
  while (flock(file_, LOCK_EX | LOCK_NB) != 0) {
    const int error = errno;
    if (error == EWOULDBLOCK && std::chrono::steady_clock::now() < until) {
      std::this_thread::sleep_for(lock_retry);
      continue;
    }
    close(file_);
    throw Failure(fmt::format("{}: {}", name,
                              error == EWOULDBLOCK ? "another slam-gatewayctl changes bans or keys"
                                                   : std::strerror(error)));
  }
}

DirectoryLock::~DirectoryLock() { close(file_); }

/// Returns the bans in force after a reload. Throws Failure when the configuration has a problem:
/// then a reload changes nothing, and the bans may be missing here.
std::vector<std::string> read_bans(const ParseResult& parsed) {
  if (parsed.problems.empty()) return parsed.config.bans;
  throw Failure(to_string(parsed.problems.front()) + "; fix it first, then try again");
}

std::string change_bans(const Installation& installation, const std::string& who, bool is_banned) {
  const DirectoryLock lock(installation.etc());
  std::vector<std::string> bans = read_bans(load_config(installation.configuration()));
  const bool was_banned =
      std::erase_if(bans, [&](const std::string& entry) { return Bans::are_same(entry, who); }) > 0;
  if (!is_banned && !was_banned)
    throw Failure(fmt::format("{} is not banned; banned are: {}", who,
                              bans.empty() ? "none" : fmt::format("{}", fmt::join(bans, ", "))));
  if (is_banned) bans.push_back(who);
  const fs::path file = installation.site() / "bans.json";
  std::error_code error;
  if (fs::create_directory(installation.site(), error))
    fs::permissions(installation.site(), static_cast<fs::perms>(0755), error);  // not root's umask
  NewFile changed(file);
  changed.write(nlohmann::json{{"bans", bans}}.dump(2) + "\n");
  fs::permissions(changed.path(), static_cast<fs::perms>(0644), error);
  changed.finish();
  const ParseResult now = load_config(installation.configuration());
  if (read_bans(now) != bans)
    throw Failure(
        fmt::format("{} sets `bans` too and overrules {}; remove `bans` there, then type: "
                    "sudo slam-gatewayctl reload",
                    now.places.at("bans").file, file.string()));
  // An empty list would overrule bans that another file gets later.
  const bool overrules = std::ranges::count(now.warnings, "bans", &Problem::key) > 0;
  if (bans.empty() && !overrules) fs::remove(file, error);
  return fmt::format("{} is {} ({})\n", who, is_banned ? "banned" : "no longer banned",
                     file.string());
}

namespace {

/// Returns whether systemd runs the service or is about to. `systemctl is-active` says no while the
/// unit waits for its restart after a crash, and while systemd ends it before that.
bool is_service_running() {
  const std::string state =
      run_program({"systemctl", "show", "-P", "ActiveState", service_unit}).output;
  return state == "active\n" || state == "activating\n" || state == "reloading\n" ||
         state == "deactivating\n";
}

}  // namespace

ServicePause::ServicePause(const Installation& installation) {
  if (!installation.is_service()) return;
  for (auto& [number, former] : former_) former = std::signal(number, SIG_IGN);
  was_running_ = is_service_running();
  if (was_running_) run_or_fail({"systemctl", "stop", service_unit});
}

ServicePause::~ServicePause() {
  if (was_running_) run_program({"systemctl", "start", "--no-block", service_unit});
  for (const auto& [number, former] : former_)
    if (former != SIG_ERR) std::signal(number, former);
}

ProgramResult run_program(const std::vector<std::string>& words) {
  std::array<int, 2> pipe{};
  if (pipe2(pipe.data(), O_CLOEXEC) != 0) return {exit_not_started, std::strerror(errno)};
  setenv("LC_ALL", "C.UTF-8", 1);
  std::vector<char*> arguments;
  for (const std::string& word : words) arguments.push_back(const_cast<char*>(word.c_str()));
  arguments.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_adddup2(&actions, pipe[1], STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, pipe[1], STDERR_FILENO);
  pid_t child = 0;
  const int error =
      posix_spawnp(&child, arguments[0], &actions, nullptr, arguments.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  close(pipe[1]);
  ProgramResult result{exit_not_started, std::strerror(error)};
  if (error == 0) {
    result.output = read_all(pipe[0]);
    result.status = wait_for(child);
  }
  close(pipe[0]);
  return result;
}

std::string run_or_fail(const std::vector<std::string>& words) {
  ProgramResult result = run_program(words);
  if (result.status == 0) return std::move(result.output);
  throw Failure(words[0] + " failed (status " + std::to_string(result.status) +
                "): " + result.output);
}

WorkDirectory::WorkDirectory() {
  std::string name = (fs::temp_directory_path() / "slam-gatewayctl-XXXXXX").string();
  if (mkdtemp(name.data()) == nullptr) throw Failure(name + ": " + std::strerror(errno));
  path_ = name;
}

WorkDirectory::~WorkDirectory() {
  std::error_code ignored;
  fs::remove_all(path_, ignored);
}

NewFile::NewFile(std::string file) : file_(std::move(file)), unfinished_(file_ + ".unfinished") {
  std::error_code error;
  if (fs::is_directory(file_, error)) throw Failure(file_ + " is a directory; name a file in it");
  if (fs::exists(file_, error) && !fs::is_regular_file(file_, error))
    throw Failure(file_ + " is not a regular file; name a new one");
  unlink(unfinished_.c_str());
  made_ = open(unfinished_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  if (made_ < 0) fail(errno);
}

NewFile::~NewFile() {
  close(made_);
  unlink(unfinished_.c_str());
}

void NewFile::write(std::string_view text) {
  while (!text.empty()) {
    const ssize_t count = ::write(made_, text.data(), text.size());
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) fail(errno);
    text.remove_prefix(static_cast<std::size_t>(count));
  }
}

/// Call at the end: in /tmp, the kernel does not let root write to another user's file
/// (fs.protected_regular in proc_sys_fs(5)). sudo(8) sets SUDO_UID and SUDO_GID.
void NewFile::give_to_caller() {
  const auto number_in = [](const char* variable) {
    const char* const text = std::getenv(variable);
    return parse_number<unsigned>(text ? text : "").value_or(0);
  };
  const unsigned user = number_in("SUDO_UID");
  if (geteuid() != 0 || user == 0) return;
  if (fchown(made_, user, number_in("SUDO_GID")) != 0) return;  // the file stays root's
}

void NewFile::finish() {
  if (fsync(made_) != 0 || rename(unfinished_.c_str(), file_.c_str()) != 0) fail(errno);
  const fs::path directory = fs::absolute(file_).parent_path();
  const int opened = open(directory.c_str(), O_RDONLY | O_CLOEXEC);
  const int error = opened >= 0 && fsync(opened) == 0 ? 0 : errno;
  if (opened >= 0) close(opened);
  // Its user may be allowed to write to the directory but not to read it, and some network file
  // systems sync no directory. The complete file has its name there, too.
  if (error != 0 && error != EACCES && error != EINVAL) fail(error);
}

void NewFile::fail(int error) const {
  throw Failure(fmt::format("{}: {}{}", file_, std::strerror(error),
                            error == EACCES ? "; type the command with sudo" : ""));
}

}  // namespace slamgw::ctl
