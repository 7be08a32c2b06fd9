// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/load.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <array>
#include <cstdlib>
#include <map>

#include "daemon/config/credentials.hpp"
#include "daemon/config/system_files.hpp"

namespace slamgw {
namespace {

Surroundings read_surroundings() {
  std::array<char, 256> name{};  // POSIX's longest host name and a NUL
  if (gethostname(name.data(), name.size() - 1) != 0) name[0] = '\0';
  const char* credentials = std::getenv("CREDENTIALS_DIRECTORY");
  return {name.data(), credentials == nullptr ? "" : credentials};
}

/// The one secret that may stand in the configuration itself. Packages ship the file readable by
/// all.
void warn_of_readable_secret(ParseResult& result, const std::string& path, unsigned mode) {
  constexpr unsigned others_may_read = 0004;
  constexpr const char* key = "ble_mesh.provisioning.static_oob";
  if (!result.config.ble_mesh.provisioning.static_oob || (mode & others_may_read) == 0) return;
  const auto line = result.lines.find(key);
  result.warnings.push_back(
      {path, line == result.lines.end() ? 1 : line->second, key,
       fmt::format("is a secret in a file that others can read (mode {:04o}); type: chown "
                   "root:slam-gateway {} && chmod 640 {}",
                   mode, path, path)});
}

}  // namespace

ParseResult load_config(const std::string& path) {
  const SystemFiles files;
  const auto file = files.read(path);
  if (file) {
    ParseResult parsed = parse_config(file->text, path, read_surroundings(), files);
    warn_of_readable_secret(parsed, path, file->mode);
    return parsed;
  }
  std::string text = "cannot be read: " + file.error().text + "; a readable file is needed";
  if (file.error().is_missing) text += ", create it with: slam-gatewayd --print-config > " + path;
  ParseResult result;
  result.problems.push_back({path, 1, "file", std::move(text)});
  return result;
}

std::optional<Credentials> load_credentials(const BrokerSettings& broker) {
  Config config;
  config.broker = broker;
  config.broker.credentials.reset();
  std::map<std::string, int> no_lines;
  FileContext context;
  read_credentials(Located{config, no_lines, context}, config.broker, read_surroundings(),
                   SystemFiles());
  return context.problems.empty() ? config.broker.credentials : broker.credentials;
}

}  // namespace slamgw
