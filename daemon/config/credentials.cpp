// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/credentials.hpp"

#include <fmt/format.h>

#include <set>

#include "daemon/config/located_json.hpp"

namespace slamgw {
namespace {

constexpr std::string_view shape = R"({"username": "...", "password": "..."})";
constexpr std::size_t max_octets = 65535;  // MQTT 3.1.1 section 3.1.3

/// Returns true for a text that MQTT and its libraries, which take C strings, can carry.
bool is_carried(const std::string& text) {
  return text.size() <= max_octets && text.find('\0') == text.npos;
}

std::optional<Credentials> parse_credentials(const std::string& text, const std::string& file,
                                             Problems& problems) {
  const auto document = read_group(text, file, shape, problems);
  if (!document) return std::nullopt;
  const auto add = [&](int line, const std::string& key, std::string_view wrong) {
    problems.push_back({file, line, key, fmt::format("{}; allowed: {}", wrong, shape)});
  };
  Credentials credentials;
  std::set<std::string> missing{"username", "password"};
  for (const auto& [key, value] : document->root.items()) {
    const bool is_username = key == "username";
    const auto* word = value.get_ptr<const std::string*>();
    if (!is_username && key != "password")
      add(document->line_of(key), key, "unknown key");
    else if (word == nullptr || !is_carried(*word) || (is_username && word->empty()))
      add(document->line_of(key), key,
          is_username ? "is not a text of 1 to 65535 octets without null characters"
                      : "is not a text of at most 65535 octets without null characters (not shown: "
                        "it is secret)");
    else
      (is_username ? credentials.username : credentials.password) = *word;
    missing.erase(key);
  }
  for (const char* const key : {"username", "password"})
    if (missing.contains(key)) add(1, key, "is missing");
  return credentials;
}

constexpr const char* key_of_file = "broker.credentials_file";

/// Reports at the key if the configuration sets it, else at the file itself.
void report(ParseResult& result, const std::string& path, const std::string& wrong) {
  if (result.is_set(key_of_file))
    result.problem(key_of_file, path + " " + wrong);
  else
    result.problems.push_back({path, 1, "file", wrong});
}

bool is_guarded(ParseResult& result, const std::string& path, const FileText& file) {
  const std::string fault = fault_of_secret(path, file);
  if (!fault.empty()) report(result, path, fault);
  return fault.empty();
}

void cannot_be_read(ParseResult& result, const std::string& path, const FileError& error) {
  report(result, path,
         fmt::format("cannot be read: {}; a readable file with {} is needed", error.text, shape));
}

std::optional<Credentials> read_file(ParseResult& result, const std::string& path,
                                     const Files& files) {
  const auto file = files.read(path);
  if (!file) {
    cannot_be_read(result, path, file.error());
    return std::nullopt;
  }
  if (!is_guarded(result, path, *file)) return std::nullopt;
  return parse_credentials(file->text, path, result.problems);
}

/// Reads systemd's copy, which its directory guards. Problems name the copy's source; where the
/// service's user may read that file, its mode and owner are checked too.
std::optional<Credentials> read_credential(ParseResult& result, const Environment& environment,
                                           const Files& files) {
  const std::string copy = environment.credentials_directory + "/broker";
  const std::string& source = environment.credential_source;
  const auto file = files.read(copy);
  if (!file) {  // the unit may load it or not
    if (!file.error().is_missing) cannot_be_read(result, copy, file.error());
    return std::nullopt;
  }
  if (const auto original = source.empty() ? FileError{} : files.read(source);
      original && !is_guarded(result, source, *original))
    return std::nullopt;
  return parse_credentials(file->text, source.empty() ? copy : source, result.problems);
}

/// Checks the file that the service will read, when another user runs this process.
void check_source(ParseResult& result, const std::string& path, const Files& files) {
  const auto file = files.read(path);
  if (!file && file.error().is_denied) {
    result.warnings.push_back({path, 1, key_of_file,
                               "is not checked: only root may read it; type: sudo slam-gatewayd "
                               "--check-config"});
  } else {
    read_file(result, path, files);
  }
}

}  // namespace

std::string fault_of_owner(const std::string& path, const std::string& strange_owner) {
  if (strange_owner.empty()) return {};
  return fmt::format("belongs to {}, who can read and change it; type: sudo chown root {}",
                     strange_owner, path);
}

std::string fault_of_secret(const std::string& path, const FileText& file, unsigned forbidden,
                            const char* remedy) {
  if ((file.mode & forbidden) != 0)
    return fmt::format("can be read or changed by others (mode {:04o}); {} {}", file.mode, remedy,
                       path);
  return fault_of_owner(path, file.strange_owner);
}

void read_credentials(ParseResult& result, const Environment& environment, const Files& files) {
  const std::optional<std::string>& named = result.config.broker.credentials_file;
  if (named) {
    result.config.broker.credentials = read_file(result, *named, files);
  } else if (!environment.credentials_directory.empty()) {
    result.config.broker.credentials = read_credential(result, environment, files);
  } else if (!environment.credential_source.empty()) {
    check_source(result, environment.credential_source, files);
  }
}

}  // namespace slamgw
