// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/io/load.hpp"

#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <filesystem>

#include "daemon/config/credentials.hpp"
#include "daemon/config/io/service_rights.hpp"
#include "daemon/config/io/system_files.hpp"

namespace slamgw {
namespace {

namespace fs = std::filesystem;

/// Recognizes the names of backup and temporary files of editors, dpkg and slam-gatewayctl.
bool is_put_aside(const fs::path& name) {
  return name.string().starts_with('.') || name.string().ends_with('~') ||
         name.extension().string().starts_with(".dpkg-") || name.extension() == ".unfinished";
}

bool is_configuration(const fs::path& path) {
  return path.extension() == ".json" && !is_put_aside(path.filename());
}

/// Returns the paths of what the directory holds, in order of name.
std::vector<fs::path> entries_of(const fs::path& directory, std::error_code& error) {
  std::vector<fs::path> entries;
  for (fs::directory_iterator entry(directory, error); !error && entry != fs::directory_iterator();
       entry.increment(error))
    entries.push_back(entry->path());
  std::ranges::sort(entries);
  return entries;
}

/// The file behind `LoadCredential=broker:slam-gateway.broker`, found as systemd.exec(5) finds it.
std::string credential_source() {
  for (const char* const store : {"/etc/credstore", "/run/credstore", "/usr/lib/credstore"}) {
    std::error_code error;
    const fs::path path = fs::canonical(fs::path(store) / "slam-gateway.broker", error);
    if (!error) return path.string();
  }
  return {};
}

Environment read_environment(const std::string& configuration) {
  std::array<char, 256> name{};  // POSIX's longest host name and a NUL
  if (gethostname(name.data(), name.size() - 1) != 0) name[0] = '\0';
  const char* credentials = std::getenv("CREDENTIALS_DIRECTORY");
  const bool is_services = credentials != nullptr || configuration == service_configuration;
  return {name.data(), credentials == nullptr ? "" : credentials,
          is_services ? credential_source() : ""};
}

/// Warns of JSON files beside gateway.json that neither the gateway nor a key's path uses.
void warn_of_misplaced_files(ParseResult& result) {
  const std::vector<NamedFile> named = named_files(result.config);
  std::error_code error;
  for (const fs::path& path : entries_of(fs::path(service_configuration).parent_path(), error)) {
    const std::string name = path.filename().string();
    const bool is_known = name == "gateway.json" || name.ends_with("credentials.json") ||
                          std::ranges::count(named, path.string(), &NamedFile::path) > 0;
    if (is_configuration(name) && !is_known)
      result.warnings.push_back({path.string(), 1, "file",
                                 "is not read; the site's own keys are read in " +
                                     site_directory(service_configuration).string()});
  }
}

void warn_of_ignored_files(ParseResult& result, const std::string& configuration) {
  std::error_code error;  // the files of a directory that cannot be read are a problem already
  for (const fs::path& path : entries_of(site_directory(configuration), error))
    if (!is_configuration(path) && !is_put_aside(path.filename()))
      result.warnings.push_back(
          {path.string(), 1, "file",
           "is not read because its name does not end in .json; rename or remove it"});
  if (configuration == service_configuration) warn_of_misplaced_files(result);
}

/// Checks the only secret that the configuration itself may hold. Packages ship that file readable
/// by all users.
void warn_of_readable_secret(ParseResult& result, const SystemFiles& files) {
  constexpr unsigned others_may_read = 0004;
  constexpr const char* key = "ble_mesh.provisioning.static_oob";
  const auto place = result.places.find(key);
  if (!result.config.ble_mesh.provisioning.static_oob || place == result.places.end()) return;
  const std::string& path = place->second.file;
  const auto file = files.read(path);
  if (!file || (file->mode & others_may_read) == 0) return;
  result.warning(key, fmt::format("is a secret in a file that others can read (mode {:04o}); type: "
                                  "sudo chown root:slam-gateway {} && sudo chmod 640 {}",
                                  file->mode, path, path));
}

/// Refuses a file or directory that all other users may change: they could choose the broker and so
/// command robots. Warns when it belongs to another user, who may do so too.
void check_rights(ParseResult& result, const std::string& path, unsigned mode,
                  const std::string& strange_owner) {
  constexpr unsigned others_may_write = 0002;
  if ((mode & others_may_write) != 0)
    result.problems.push_back(
        {path, 1, "file",
         fmt::format("can be changed by others (mode {:04o}); type: sudo chmod o-w {}", mode,
                     path)});
  else if (const std::string fault = fault_of_owner(path, strange_owner); !fault.empty())
    result.warnings.push_back({path, 1, "file", fault});
}

/// Refuses a directory whose files this process cannot list (`error`): without them, the gateway
/// would run with the defaults of their keys. For programs beside the daemon, this is a warning.
void refuse_closed_directory(ParseResult& result, const std::string& directory,
                             std::error_code error, bool is_daemon) {
  if (!error || error == std::errc::no_such_file_or_directory) return;
  const bool is_denied = error == std::errc::permission_denied;
  (is_denied && !is_daemon ? result.warnings : result.problems)
      .push_back({directory, 1, "file",
                  fmt::format("cannot be read: {}; {}", error.message(),
                              is_denied ? "type: sudo chmod 755 " + directory
                                        : "a readable directory, or none, is needed")});
}

/// Refuses a directory in which other users could add a file.
void refuse_open_directory(ParseResult& result, const std::string& configuration,
                           const SystemFiles& files) {
  const std::string directory = site_directory(configuration);
  struct stat status {};
  if (stat(directory.c_str(), &status) != 0) return;
  check_rights(result, directory, status.st_mode & 0777, files.strange_owner(status.st_uid));
}

/// Reports files that root may read but the service's user may not.
void check_service_rights(ParseResult& result) {
  constexpr const char* words = "cannot be read by the service's user";
  const std::string site = site_directory(service_configuration);
  std::vector<std::string> files{service_configuration};
  std::error_code error;
  if (may_user_read(service_user, site))
    files = configuration_files(service_configuration, error);
  else
    result.problems.push_back(
        {site, 1, "file",
         fmt::format("{} {}; type: sudo chmod 755 {}", words, service_user, site)});
  for (const std::string& name : files)
    if (!may_user_read(service_user, name))
      result.problems.push_back({name, 1, "file",
                                 fmt::format("{} {}; type: sudo chgrp {} {} && sudo chmod 640 {}",
                                             words, service_user, service_user, name, name)});
  for (const auto& [key, file] : named_files(result.config)) {
    if (key.starts_with("web.") || may_user_read(service_user, file)) continue;
    const std::string remedy =
        key == "mqttsn.dtls.keys_file"
            ? fmt::format("sudo chown {} {}", service_user, file)
            : fmt::format("sudo chgrp {} {} && sudo chmod 640 {}", service_user, file, file);
    result.problem(key, fmt::format("{} {} {}; type: {}", file, words, service_user, remedy));
  }
}

ParseResult load_parts(const std::string& path, const Environment& environment,
                       const SystemFiles& files) {
  std::vector<ConfigFile> parts;
  ParseResult first;  // problems of whole files
  std::error_code error;
  for (const std::string& name : configuration_files(path, error)) {
    const auto file = files.read(name);
    if (file) {
      parts.push_back({name, file->text});
      check_rights(first, name, file->mode, file->strange_owner);
      continue;
    }
    const bool has_gateway = environment.is_daemon || path != service_configuration;
    if (name == path && file.error().is_missing && !has_gateway) {
      parts.push_back({name, "{}"});  // a page may run where no gateway is installed
      continue;
    }
    std::string text = "cannot be read: " + file.error().text + "; a readable file is needed";
    if (name == path && file.error().is_missing)
      text += ", create it with: slam-gatewayd --print-config > " + path;
    const bool may_miss = name != path && file.error().is_denied && !environment.is_daemon;
    (may_miss ? first.warnings : first.problems).push_back({name, 1, "file", std::move(text)});
  }
  refuse_closed_directory(first, site_directory(path), error, environment.is_daemon);
  refuse_open_directory(first, path, files);
  ParseResult result;
  if (!parts.empty()) result = parse_config(parts, environment, files);
  result.problems.insert(result.problems.begin(), first.problems.begin(), first.problems.end());
  result.warnings.insert(result.warnings.begin(), first.warnings.begin(), first.warnings.end());
  return result;
}

/// Returns whether `original` was changed after `copy` was made; false if a time cannot be read.
bool is_newer(const fs::path& original, const fs::path& copy) {
  std::error_code error;
  const auto changed = fs::last_write_time(original, error);
  if (error) return false;
  const auto copied = fs::last_write_time(copy, error);
  return !error && changed > copied;
}

}  // namespace

std::filesystem::path site_directory(const std::string& configuration) {
  return fs::path(configuration).replace_extension(".d");
}

std::vector<std::string> configuration_files(const std::string& path, std::error_code& error) {
  std::vector<std::string> paths{path};
  for (const fs::path& entry : entries_of(site_directory(path), error))
    if (is_configuration(entry)) paths.push_back(entry.string());
  return paths;
}

ParseResult load_config(const std::string& path) {
  const SystemFiles files(service_user);
  ParseResult result = load_parts(path, read_environment(path), files);
  warn_of_readable_secret(result, files);
  warn_of_ignored_files(result, path);
  if (path == service_configuration) check_service_rights(result);
  return result;
}

ParseResult load_shared_config(const std::string& path) {
  Environment environment = read_environment(path);
  environment.is_daemon = false;
  return load_parts(path, environment, SystemFiles(service_user));
}

std::optional<Credentials> load_credentials(const BrokerSettings& broker) {
  ParseResult result;
  result.config.broker = broker;
  result.config.broker.credentials.reset();
  read_credentials(result, read_environment(service_configuration), SystemFiles(service_user));
  return result.problems.empty() ? result.config.broker.credentials : broker.credentials;
}

Result<std::optional<Credentials>, Problem> load_service_credentials() {
  const std::string source = credential_source();
  ParseResult result;
  if (!source.empty()) {
    result.config.broker.credentials_file = source;
    read_credentials(result, {}, SystemFiles(service_user));
  }
  if (!result.problems.empty()) return result.problems.front();
  return result.config.broker.credentials;
}

bool is_credential_outdated() {
  const char* directory = std::getenv("CREDENTIALS_DIRECTORY");
  const std::string source = credential_source();
  return directory != nullptr && !source.empty() &&
         is_newer(source, fs::path(directory) / "broker");
}

}  // namespace slamgw
