// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/credentials.hpp"

#include <fmt/format.h>

#include "daemon/config/located_json.hpp"

namespace slamgw {
namespace {

constexpr std::string_view shape = R"({"username": "...", "password": "..."})";

class CredentialsReader {
 public:
  CredentialsReader(std::string file, Problems& problems)
      : file_(std::move(file)), problems_(problems) {}

  std::optional<Credentials> read(const std::string& text) {
    LocatedJson document = read_located_json(text, file_);
    for (Problem& problem : document.problems) problems_.push_back(std::move(problem));
    if (!document.is_complete) return std::nullopt;
    if (!document.root.value.is_object()) {
      add(document.root.place.line, "syntax", "is not a group");
      return std::nullopt;
    }
    Credentials credentials;
    for (const JsonNode& member : document.root.children) take(member, credentials);
    if (!has_username_) add(1, "username", "is missing");
    if (!has_password_) add(1, "password", "is missing");
    return credentials;
  }

 private:
  void take(const JsonNode& member, Credentials& out) {
    const bool is_username = member.key == "username";
    if (!is_username && member.key != "password")
      return add(member.place.line, member.key, "unknown key");
    (is_username ? has_username_ : has_password_) = true;
    const auto* text = member.value.get_ptr<const std::string*>();
    if (text == nullptr || (is_username && text->empty()))
      return add(member.place.line, member.key,
                 is_username ? "is not a text of at least one character"
                             : "is not a text (not shown: it is secret)");
    (is_username ? out.username : out.password) = *text;
  }

  void add(int line, std::string key, std::string_view wrong) {
    problems_.push_back(
        {file_, line, std::move(key), fmt::format("{}; allowed: {}", wrong, shape)});
  }

  std::string file_;
  Problems& problems_;
  bool has_username_ = false;
  bool has_password_ = false;
};

constexpr std::string_view key_of_file = "broker.credentials_file";

/// At the key, if the configuration sets it; else at the file itself.
void report(const Located& located, const std::string& path, const std::string& wrong) {
  if (located.is_set(std::string(key_of_file)))
    located.problem(std::string(key_of_file), path + " " + wrong);
  else
    located.context.problems.push_back({path, 1, "file", wrong});
}

bool is_guarded(const Located& located, const std::string& path, const FileText& file) {
  const std::string fault = fault_of_secret(path, file);
  if (!fault.empty()) report(located, path, fault);
  return fault.empty();
}

void cannot_be_read(const Located& located, const std::string& path, const FileError& error) {
  report(located, path,
         fmt::format("cannot be read: {}; a readable file with {} is needed", error.text, shape));
}

std::optional<Credentials> read_file(const Located& located, const std::string& path,
                                     const Files& files) {
  const auto file = files.read(path);
  if (!file) {
    cannot_be_read(located, path, file.error());
    return std::nullopt;
  }
  if (!is_guarded(located, path, *file)) return std::nullopt;
  return CredentialsReader(path, located.context.problems).read(file->text);
}

/// systemd's copy, which its directory guards; problems name the file that it was copied from. The
/// service's user may read that file only where it is not root's alone.
std::optional<Credentials> read_credential(const Located& located, const Surroundings& surroundings,
                                           const Files& files) {
  const std::string copy = surroundings.credentials_directory + "/broker";
  const std::string& source = surroundings.credential_source;
  const auto file = files.read(copy);
  if (!file) {  // the unit may load it or not
    if (!file.error().is_missing) cannot_be_read(located, copy, file.error());
    return std::nullopt;
  }
  if (const auto original = source.empty() ? FileError{} : files.read(source);
      original && !is_guarded(located, source, *original))
    return std::nullopt;
  return CredentialsReader(source.empty() ? copy : source, located.context.problems)
      .read(file->text);
}

/// What the service will read, checked by another user.
void check_source(const Located& located, ParseResult& result, const std::string& path,
                  const Files& files) {
  const auto file = files.read(path);
  if (!file && file.error().is_denied) {
    result.warnings.push_back({path, 1, std::string(key_of_file),
                               "is not checked: only root may read it; type: sudo slam-gatewayd "
                               "--check-config"});
  } else {
    read_file(located, path, files);
  }
}

}  // namespace

std::string fault_of_secret(const std::string& path, const FileText& file, unsigned forbidden,
                            const char* remedy) {
  if ((file.mode & forbidden) != 0)
    return fmt::format("can be read or changed by others (mode {:04o}); {} {}", file.mode, remedy,
                       path);
  if (file.strange_owner.empty()) return {};
  return fmt::format("belongs to {}, who can read and change it; type: sudo chown root {}",
                     file.strange_owner, path);
}

void read_credentials(const Located& located, ParseResult& result, const Surroundings& surroundings,
                      const Files& files) {
  const std::optional<std::string>& named = result.config.broker.credentials_file;
  if (named) {
    result.config.broker.credentials = read_file(located, *named, files);
  } else if (!surroundings.credentials_directory.empty()) {
    result.config.broker.credentials = read_credential(located, surroundings, files);
  } else if (!surroundings.credential_source.empty()) {
    check_source(located, result, surroundings.credential_source, files);
  }
}

}  // namespace slamgw
