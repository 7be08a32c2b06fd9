// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/tls_files.hpp"

#include <fmt/format.h>

namespace slamgw {
namespace {

enum class Kind : std::uint8_t { certificate, key };

/// The PEM text when the file is good; nothing when it is not set or a problem was reported.
std::optional<std::string> checked(const Located& located, const Files& files,
                                   const std::string& key, const std::optional<std::string>& path,
                                   Kind kind) {
  if (!path) return std::nullopt;
  const auto file = files.read(*path);
  if (!file) {
    located.problem(key, fmt::format("{} cannot be read: {}; a readable PEM file is needed", *path,
                                     file.error().text));
    return std::nullopt;
  }
  const std::string fault =
      kind == Kind::certificate ? files.certificate_fault(file->text) : files.key_fault(file->text);
  if (fault.empty()) return file->text;
  located.problem(key, fmt::format("{} {}; a {} as PEM is needed", *path, fault,
                                   kind == Kind::certificate ? "certificate"
                                                             : "private key without pass phrase"));
  return std::nullopt;
}

}  // namespace

void check_tls_files(const Located& located, const Files& files) {
  const BrokerSettings& broker = located.config.broker;
  checked(located, files, "broker.tls.ca_file", broker.ca_file, Kind::certificate);
  const auto certificate = checked(located, files, "broker.tls.certificate_file",
                                   broker.certificate_file, Kind::certificate);
  const auto key = checked(located, files, "broker.tls.key_file", broker.key_file, Kind::key);
  if (certificate && key && !files.key_matches(*certificate, *key))
    located.problem("broker.tls.key_file",
                    "does not belong to certificate_file; its own private key is needed");
}

}  // namespace slamgw
