// SPDX-License-Identifier: Apache-2.0
// The gateway on this host, for slam-gatewayctl: its files, its service, other programs to run, and
// archives for the operator.
#pragma once

#include <csignal>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "daemon/config/io/load.hpp"

namespace slamgw::ctl {

inline constexpr const char* service_unit = "slam-gateway.service";

/// The places of the gateway's files on this host, by its configuration.
class Installation {
 public:
  /// Reads the configuration, which may have problems.
  explicit Installation(std::string configuration);

  const std::string& configuration() const { return configuration_; }
  const ParseResult& parsed() const { return parsed_; }
  std::filesystem::path etc() const { return std::filesystem::path(configuration_).parent_path(); }
  std::filesystem::path state() const;
  std::filesystem::path site() const { return site_directory(configuration_); }
  /// Returns whether the packaged service reads this configuration.
  bool is_service() const { return configuration_ == service_configuration; }

  /// Returns whether a backup holds the file: everything in `state()`, the configuration with its
  /// credentials, the files that it names, and everything in the service's /etc/slam-gateway.
  bool owns(const std::filesystem::path& file) const { return is_state(file) || is_settings(file); }
  bool is_state(const std::filesystem::path& file) const;
  /// Returns whether the file has robots' keys, which only the service's user may read.
  bool is_key_file(const std::filesystem::path& file) const;
  /// Returns the regular files of this host for which owns() is true.
  std::vector<std::filesystem::path> files() const;

 private:
  bool is_settings(const std::filesystem::path& file) const;

  std::string configuration_;
  ParseResult parsed_;
  std::vector<std::filesystem::path> named_;  ///< files that the configuration names
};

/// Stops the service for the lifetime of this object, and starts it again if it ran. Ignores the
/// signals of Ctrl-C, kill(1) and a closed terminal until then, also in programs that it runs. Does
/// nothing for a configuration that is not the service's.
class ServicePause {
 public:
  explicit ServicePause(const Installation& installation);
  ~ServicePause();
  ServicePause(const ServicePause&) = delete;
  ServicePause& operator=(const ServicePause&) = delete;

 private:
  bool was_running_ = false;
  /// The handlers to restore; `SIG_ERR`: none.
  std::map<int, void (*)(int)> former_{
      {SIGINT, SIG_ERR}, {SIGTERM, SIG_ERR}, {SIGHUP, SIG_ERR}, {SIGPIPE, SIG_ERR}};
};

struct ProgramResult {
  int status = 0;      ///< exit status; 127 when it could not be started; 128 + n for signal n
  std::string output;  ///< standard output and standard error: 4 MiB, then "(cut)"
};

/// Runs tar, systemctl, journalctl ... and waits. `words[0]` is looked up in PATH. No shell;
/// standard input is empty; messages are in English.
ProgramResult run_program(const std::vector<std::string>& words);
/// As run_program(), but returns the output, and throws Failure with it unless the status is 0.
std::string run_or_fail(const std::vector<std::string>& words);

/// A temporary directory that only this user can read. The destructor removes it.
class WorkDirectory {
 public:
  WorkDirectory();
  ~WorkDirectory();
  WorkDirectory(const WorkDirectory&) = delete;
  WorkDirectory& operator=(const WorkDirectory&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

/// Keeps other slam-gatewayctl programs from changing the directory's files until the destructor.
class DirectoryLock {
 public:
  /// Waits up to 10 s for the lock. Throws Failure without it, or without a right to the directory.
  explicit DirectoryLock(const std::filesystem::path& directory);
  ~DirectoryLock();
  DirectoryLock(const DirectoryLock&) = delete;
  DirectoryLock& operator=(const DirectoryLock&) = delete;

 private:
  int file_;
};

/// Adds `who` to `bans`, or removes it with all equal entries, in `gateway.d/bans.json`. Removes
/// that file when it is empty and overrules no other. Returns the result in words. Reads the
/// present bans again, under a lock. Throws Failure when the configuration has a problem, `who` to
/// remove is not banned, the file can't be written, or another file overrules it.
std::string change_bans(const Installation& installation, const std::string& who, bool is_banned);

/// A file with mode 0600 that gets its name only when it is complete, and may then replace another.
class NewFile {
 public:
  /// Throws Failure when the file can't be made.
  explicit NewFile(std::string file);
  /// Removes the file if it was not finished.
  ~NewFile();
  NewFile(const NewFile&) = delete;
  NewFile& operator=(const NewFile&) = delete;

  /// The path to write to until finish().
  const std::string& path() const { return unfinished_; }
  int descriptor() const { return made_; }
  void write(std::string_view text);
  /// Gives the file to the user who typed sudo, if any: else that user could neither copy nor send
  /// it.
  void give_to_caller();
  /// Gives the complete file its name, for good. Throws Failure when that is not possible.
  void finish();

 private:
  [[noreturn]] void fail(int error) const;

  std::string file_;
  std::string unfinished_;
  int made_ = -1;
};

}  // namespace slamgw::ctl
