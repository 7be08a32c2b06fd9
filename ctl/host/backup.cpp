// SPDX-License-Identifier: Apache-2.0
#include "ctl/host/backup.hpp"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <pwd.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>

#include "ctl/connection.hpp"
#include "ctl/host/archive_file.hpp"
#include "ctl/host/program.hpp"
#include "ctl/host/work_directory.hpp"
#include "daemon/config/io/service_rights.hpp"

namespace slamgw::ctl {
namespace {

namespace fs = std::filesystem;

/// The first member of each archive: what it is, and where its two trees lie.
constexpr const char* manifest_name = "slam-gateway-backup.json";
constexpr int archive_format = 1;

struct Manifest {
  std::string configuration;
  fs::path state;
  std::vector<fs::path> elsewhere;
  std::string gateway;  ///< its id, by default the host's name; empty in older archives
};

std::string without_root(const fs::path& path) { return path.relative_path().string(); }

void write_manifest(const fs::path& directory, const Manifest& manifest) {
  nlohmann::ordered_json json{{"format", archive_format},
                              {"version", SLAMGW_VERSION},
                              {"configuration", manifest.configuration},
                              {"state", manifest.state.string()},
                              {"gateway", manifest.gateway},
                              {"elsewhere", nlohmann::json::array()}};
  for (const fs::path& path : manifest.elsewhere) json["elsewhere"].push_back(path.string());
  std::ofstream(directory / manifest_name) << json.dump(2) << '\n';
}

Manifest read_manifest(const std::string& archive) {
  const ProgramResult read = run_program({"tar", "-xzOf", archive, manifest_name});
  const auto json = nlohmann::json::parse(read.output, nullptr, false);
  if (read.status != 0 || !json.is_object() || !json.contains("format"))
    throw Failure(archive + " is no backup of slam-gateway");
  if (json.value("format", 0) > archive_format)
    throw Failure(fmt::format("{} was written by slam-gateway {}; install that version first",
                              archive, json.value("version", "?")));
  Manifest manifest{
      json.value("configuration", ""), json.value("state", ""), {}, json.value("gateway", "")};
  for (const auto& path : json.value("elsewhere", nlohmann::json::array()))
    manifest.elsewhere.emplace_back(path.get<std::string>());
  return manifest;
}

bool is_below(const fs::path& path, const fs::path& directory) {
  const fs::path relative = path.lexically_normal().lexically_relative(directory);
  return !relative.empty() && *relative.begin() != "..";
}

/// Nothing but what the manifest speaks of: an archive from elsewhere must not write anywhere else.
void check_members(const std::string& archive, const Manifest& manifest) {
  std::istringstream members(run_or_fail({"tar", "-tzf", archive}));
  const fs::path etc = fs::path(manifest.configuration).parent_path();
  for (std::string member; std::getline(members, member);) {
    const fs::path path = fs::path("/" + member).lexically_normal();
    const bool is_named = std::find(manifest.elsewhere.begin(), manifest.elsewhere.end(), path) !=
                          manifest.elsewhere.end();
    if (member == manifest_name || is_named || is_below(path, etc) ||
        is_below(path, manifest.state))
      continue;
    throw Failure(archive + " holds " + member + ", which is no part of a backup");
  }
}

std::string time_suffix() {
  return fmt::format(
      "{:%Y%m%dT%H%M%SZ}",
      fmt::gmtime(std::chrono::system_clock::to_time_t(std::chrono::system_clock::now())));
}

/// Leaves the directory itself: systemd and the package own it.
std::optional<fs::path> move_content_aside(const fs::path& directory, const std::string& suffix) {
  std::error_code error;
  if (!fs::is_directory(directory, error) || fs::is_empty(directory, error)) return std::nullopt;
  const fs::path aside = directory.string() + ".before-restore-" + suffix;
  fs::create_directory(aside);
  fs::permissions(aside, fs::perms::owner_all);
  for (const auto& entry : fs::directory_iterator(directory))
    fs::rename(entry.path(), aside / entry.path().filename());
  return aside;
}

/// Only the tree or file itself: the directories above it keep their owners and modes.
void put_in_place(const fs::path& unpacked, const fs::path& path) {
  const fs::path source = unpacked / path.relative_path();
  if (!fs::exists(source)) return;
  fs::create_directories(path.parent_path());
  run_or_fail({"cp", "-aT", source.string(), path.string()});
}

void give_to_service(const fs::path& state) {
  run_or_fail({"chown", "-R", fmt::format("{}:{}", service_user, service_user), state.string()});
}

/// On a host of another name the gateway would begin anew at the broker, and what is retained under
/// its old name would stay there.
std::string words_on_new_name(const Manifest& manifest) {
  const std::string now = Installation(manifest.configuration).parsed().config.gateway_id;
  if (manifest.gateway.empty() || manifest.gateway == now) return {};
  return fmt::format(
      "This gateway is called '{}' here, after its host; in the backup it was '{}'. To keep that "
      "name, write\n  {{\"gateway\": {{\"id\": \"{}\"}}}}\ninto {} and type: sudo systemctl "
      "restart slam-gateway\n",
      now, manifest.gateway, manifest.gateway,
      (fs::path(manifest.configuration).replace_extension(".d") / "id.json").string());
}

void need_rights(const Installation& installation, const char* verb) {
  if (installation.is_service() && geteuid() != 0)
    throw Failure(
        fmt::format("{} reads and writes what only root may; type: sudo slam-gatewayctl "
                    "{} FILE",
                    verb, verb));
}

}  // namespace

std::string backup(const Installation& installation, const std::string& file) {
  need_rights(installation, "backup");
  // With a mistyped --config the state would be looked for in the default directory.
  if (access(installation.configuration().c_str(), R_OK) != 0)
    throw Failure(fmt::format("{}: {}; nothing was written", installation.configuration(),
                              std::strerror(errno)));
  const Manifest manifest{installation.configuration(), installation.state(),
                          installation.files_elsewhere(), installation.parsed().config.gateway_id};
  const WorkDirectory work;
  write_manifest(work.path(), manifest);
  ArchiveFile archive(file);
  std::vector<std::string> words{"tar",
                                 "-czf",
                                 archive.path(),
                                 "-C",
                                 work.path().string(),
                                 manifest_name,
                                 "-C",
                                 "/",
                                 without_root(installation.etc())};
  std::error_code error;
  if (fs::is_directory(manifest.state, error)) words.push_back(without_root(manifest.state));
  for (const fs::path& path : manifest.elsewhere) words.push_back(without_root(path));
  {
    const ServicePause pause(installation);
    run_or_fail(words);
  }
  archive.finish();
  return fmt::format(
      "{}: configuration, credentials, mesh keys, kept messages and sessions ({} bytes).\n"
      "It holds secrets; only you can read it. Bring it back with: sudo slam-gatewayctl restore "
      "{}\n",
      file, fs::file_size(file), file);
}

std::string restore(const Installation& installation, const std::string& file) {
  need_rights(installation, "restore");
  if (installation.is_service() && getpwnam(service_user) == nullptr)
    throw Failure("there is no user slam-gateway: install the package first, then restore");
  if (access(file.c_str(), R_OK) != 0) throw Failure(file + ": " + std::strerror(errno));
  const Manifest manifest = read_manifest(file);
  if (manifest.configuration != installation.configuration())
    throw Failure(fmt::format("{} is a backup of {}, not of {}; say --config {}", file,
                              manifest.configuration, installation.configuration(),
                              manifest.configuration));
  check_members(file, manifest);
  const WorkDirectory unpacked;  // whole before anything here is touched
  run_or_fail({"tar", "-xzpf", file, "-C", unpacked.path().string(), "--exclude", manifest_name});
  const std::string suffix = time_suffix();
  std::string report;
  {
    const ServicePause pause(installation);
    fs::create_directories(manifest.state);
    for (const fs::path& directory : {installation.etc(), manifest.state})
      if (const auto aside = move_content_aside(directory, suffix))
        report +=
            fmt::format("What was in {} is in {} now.\n", directory.string(), aside->string());
    put_in_place(unpacked.path(), installation.etc());
    put_in_place(unpacked.path(), manifest.state);
    for (const fs::path& path : manifest.elsewhere) put_in_place(unpacked.path(), path);
    fs::permissions(manifest.state, fs::perms::owner_all);
    if (installation.is_service()) give_to_service(manifest.state);
  }
  if (installation.is_service()) run_program({"systemctl", "start", "--no-block", service_unit});
  return report + words_on_new_name(manifest) +
         "Restored; the service starts now. Look at: sudo slam-gatewayctl doctor\n";
}

}  // namespace slamgw::ctl
