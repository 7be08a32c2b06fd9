// SPDX-License-Identifier: Apache-2.0
#include "web/server/io/startup.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <boost/asio/ip/address.hpp>
#include <cstdlib>
#include <filesystem>
#include <optional>

#include "daemon/config/checks.hpp"
#include "daemon/config/credentials.hpp"
#include "daemon/config/io/load.hpp"
#include "daemon/config/io/service_rights.hpp"
#include "daemon/config/io/system_files.hpp"
#include "daemon/config/rules.hpp"
#include "daemon/core/utf8.hpp"

namespace slamgw::web {
namespace {

constexpr const char* token_key = "web.token_file";
constexpr const char* note_key = "web.note_file";
constexpr const char* own_user = "slam-gateway-web";  // of the packaged service

void read_own_credentials(ParseResult& result, const std::string& config_file) {
  Environment environment;
  const char* directory = std::getenv("CREDENTIALS_DIRECTORY");
  const std::filesystem::path own =
      std::filesystem::path(config_file).replace_filename("web-credentials.json");
  std::optional<std::string>& named = result.config.broker.credentials_file;
  named.reset();
  if (directory != nullptr) {
    environment.credentials_directory = directory;
    environment.credential_source = own.string();
  } else if (std::error_code error; std::filesystem::exists(own, error)) {
    named = own.string();
  }
  read_credentials(result, environment, SystemFiles(own_user));
}

/// Returns the text of a file that others must not read; on a fault, reports a problem and returns
/// nothing.
std::optional<std::string> read_closed(ParseResult& result, const char* key,
                                       const std::string& path, const char* what) {
  const auto refuse = [&](std::string text) {
    result.problem(key, std::move(text));
    return std::nullopt;
  };
  const auto file = SystemFiles(own_user).read(path);
  if (!file) {
    std::string remedy = fmt::format("{} is needed", what);
    if (file.error().is_denied)
      remedy = fmt::format("type: chgrp slam-gateway-web {} && chmod 640 {}", path, path);
    return refuse(fmt::format("{} cannot be read: {}; {}", path, file.error().text, remedy));
  }
  if (const std::string fault = fault_of_secret(path, *file); !fault.empty())
    return refuse(path + " " + fault);
  return file->text;
}

/// Returns the tokens; on a fault in the file, reports a problem and returns none.
Tokens read_tokens(ParseResult& result, const std::string& path) {
  const auto text = read_closed(result, token_key, path, "a file of lines NAME ROLE TOKEN");
  if (!text) return {};
  auto tokens = Tokens::parse(*text);
  if (auto* problem = std::get_if<Tokens::Problem>(&tokens)) {
    result.problem(
        token_key,
        fmt::format("{}:{}: {} (not shown: it is secret); each line is NAME ROLE TOKEN, the "
                    "role viewer or operator, the token 16 to 256 printable characters; or "
                    "the file is one token",
                    path, problem->line, problem->text));
    return {};
  }
  return std::get<Tokens>(std::move(tokens));
}

std::string read_note(ParseResult& result, const std::string& path) {
  constexpr std::size_t longest = 4096;
  const auto text = read_closed(result, note_key, path, "a text");
  if (!text) return {};
  std::string line = *text;
  std::ranges::replace(line, '\n', ' ');
  if (text->size() > longest)
    result.problem(note_key, fmt::format("{} has more than {} octets", path, longest));
  else if (!is_printable(line))
    result.problem(note_key,
                   path + " is not plain text; UTF-8 without control characters is needed");
  return *text;
}

bool is_loopback(const std::string& listen) {
  boost::system::error_code error;
  return boost::asio::ip::make_address(listen_parts(listen).first, error).is_loopback() && !error;
}

/// Uses the gateway's client certificate only if this program may read its key. When root runs the
/// program, warns if the service's user may not.
void drop_unreadable_certificate(ParseResult& result) {
  BrokerSettings& broker = result.config.broker;
  if (!broker.key_file) return;
  const bool is_readable = SystemFiles(own_user).read(*broker.key_file).has_value();
  if (is_readable && may_user_read(own_user, *broker.key_file)) return;
  result.warnings.push_back({*broker.key_file, 1, "broker.tls.key_file",
                             "cannot be read by slam-gateway-web, which connects without a client "
                             "certificate"});
  if (is_readable) return;
  broker.certificate_file.reset();
  broker.key_file.reset();
}

}  // namespace

Startup load_startup(const std::string& config_file) {
  Startup startup{load_shared_config(config_file), {}};
  if (!startup.parsed.problems.empty()) return startup;
  startup.parsed.config.broker.client = MqttClient::mosquitto;  // whatever the gateway uses
  read_own_credentials(startup.parsed, config_file);
  drop_unreadable_certificate(startup.parsed);
  check_tls_files(startup.parsed, SystemFiles(own_user));
  const auto& token_file = startup.parsed.config.web.token_file;
  if (token_file) startup.tokens = read_tokens(startup.parsed, *token_file);
  if (const auto& note_file = startup.parsed.config.web.note_file)
    startup.tokens.set_note(read_note(startup.parsed, *note_file));
  if (const std::string& listen = startup.parsed.config.web.listen;
      !token_file && !is_loopback(listen))
    startup.parsed.problem(
        "web.listen", listen +
                          " can be reached from other hosts, and no token protects the robots; set "
                          "web.token_file, or use 127.0.0.1");
  return startup;
}

}  // namespace slamgw::web
