// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/credentials.hpp"

#include <fmt/format.h>

#include "daemon/config/located_json.hpp"

namespace slamgw {
namespace {

constexpr unsigned others = 0007;
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
      add(document.root.line, "syntax", "is not a group");
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
      return add(member.line, member.key, "unknown key");
    (is_username ? has_username_ : has_password_) = true;
    const auto* text = member.value.get_ptr<const std::string*>();
    if (text == nullptr || (is_username && text->empty()))
      return add(member.line, member.key,
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

}  // namespace

void read_credentials(const Located& located, BrokerSettings& broker,
                      const Surroundings& surroundings, const Files& files) {
  const bool is_named = broker.credentials_file.has_value();
  if (!is_named && surroundings.credentials_directory.empty()) return;
  const std::string path =
      is_named ? *broker.credentials_file : surroundings.credentials_directory + "/broker";
  const auto file = files.read(path);
  if (!file) {
    if (!is_named && file.error().is_missing) return;  // the unit may load it or not
    return located.problem("broker.credentials_file",
                           fmt::format("{} cannot be read: {}; a readable file with {} is needed",
                                       path, file.error().text, shape));
  }
  if (is_named && (file->mode & others) != 0)  // systemd guards its own copies by their directory
    return located.problem(
        "broker.credentials_file",
        fmt::format("{} can be read or changed by others (mode {:04o}); type: chmod o= {}", path,
                    file->mode, path));
  broker.credentials = CredentialsReader(path, located.context.problems).read(file->text);
}

}  // namespace slamgw
