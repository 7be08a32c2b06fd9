// SPDX-License-Identifier: Apache-2.0
// This host as slam-gatewayctl uses it: what the gateway keeps here, its service, other programs,
// and the archives that are left for the operator.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "daemon/config/parse.hpp"

namespace slamgw::ctl {

inline constexpr const char* service_unit = "slam-gateway.service";
inline constexpr const char* service_configuration = "/etc/slam-gateway/gateway.json";

/// Where this host keeps what the gateway needs, by its configuration.
class Installation {
 public:
  /// Reads the configuration; it need not be without problems.
  explicit Installation(std::string configuration);

  const std::string& configuration() const { return configuration_; }
  const ParseResult& parsed() const { return parsed_; }
  std::filesystem::path etc() const { return std::filesystem::path(configuration_).parent_path(); }
  std::filesystem::path state() const;
  /// `gateway.d` beside `gateway.json`.
  std::filesystem::path site() const {
    return std::filesystem::path(configuration_).replace_extension(".d");
  }
  /// The configuration is the one that the packaged service reads.
  bool is_service() const { return configuration_ == service_configuration; }

  /// A backup holds the file: the state is everything in `state()`, the configuration with its
  /// credentials, the files that it names, and everything in the service's /etc/slam-gateway.
  bool owns(const std::filesystem::path& file) const { return is_state(file) || is_settings(file); }
  bool is_state(const std::filesystem::path& file) const;
  /// Robots' keys: the service's user alone reads them.
  bool is_key_file(const std::filesystem::path& file) const;
  /// The regular files of this host that `owns()` is true of.
  std::vector<std::filesystem::path> files() const;

 private:
  bool is_settings(const std::filesystem::path& file) const;

  std::string configuration_;
  ParseResult parsed_;
  std::vector<std::filesystem::path> named_;  ///< by the configuration: credentials, keys ...
};

/// Stops the service while it lives, and starts it again if it ran. Does nothing for a
/// configuration that is not the service's.
class ServicePause {
 public:
  explicit ServicePause(const Installation& installation);
  ~ServicePause();
  ServicePause(const ServicePause&) = delete;
  ServicePause& operator=(const ServicePause&) = delete;

 private:
  bool was_active_ = false;
};

struct ProgramResult {
  int status = 0;      ///< exit status; 127 when it could not be started; 128 + n for signal n
  std::string output;  ///< standard output and standard error, at most 4 MiB
};

/// Runs tar, systemctl, journalctl ... and waits. `words[0]` is looked up in PATH. No shell;
/// standard input is empty; messages are in English.
ProgramResult run_program(const std::vector<std::string>& words);
/// Its output. A Failure with it when the program does not end with status 0.
std::string run_or_fail(const std::vector<std::string>& words);

/// A directory that only this user can read, gone with this object.
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

/// Adds `who` to `bans`, or takes it out of them, in `gateway.d/bans.json`. Returns what was done,
/// for people. Throws Failure when `who` is not banned, or the file can't be written.
std::string change_bans(const Installation& installation, const std::string& who, bool is_banned);

/// A file with mode 0600 that gets its name only when it is whole. Made by root through sudo, it
/// belongs to the user who typed sudo: otherwise that user could neither copy nor send it.
class ArchiveFile {
 public:
  /// Throws Failure when it can't be made.
  explicit ArchiveFile(std::string file);
  /// Removes what was not finished.
  ~ArchiveFile();
  ArchiveFile(const ArchiveFile&) = delete;
  ArchiveFile& operator=(const ArchiveFile&) = delete;

  /// Where to write until finish().
  const std::string& path() const { return unfinished_; }
  void finish();

 private:
  std::string file_;
  std::string unfinished_;
  int made_ = -1;  ///< the unfinished file
};

}  // namespace slamgw::ctl
