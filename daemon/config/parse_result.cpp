// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/parse_result.hpp"

#include <optional>
#include <utility>

namespace slamgw {

void ParseResult::add(Problems& list, const std::string& key, std::string text) const {
  std::string set = key;
  auto found = places.find(set);
  while (found == places.end() && set.find('.') != set.npos) {
    set.resize(set.rfind('.'));
    found = places.find(set);
  }
  const Place place = found == places.end() ? Place{file} : found->second;
  list.push_back({place.file, place.line, key, std::move(text)});
}

std::vector<NamedFile> named_files(const Config& config) {
  const std::pair<const char*, const std::optional<std::string>&> keys[] = {
      {"broker.credentials_file", config.broker.credentials_file},
      {"broker.tls.ca_file", config.broker.ca_file},
      {"broker.tls.certificate_file", config.broker.certificate_file},
      {"broker.tls.key_file", config.broker.key_file},
      {"mqttsn.dtls.keys_file", config.mqttsn.dtls.keys_file},
      {"web.token_file", config.web.token_file},
      {"web.note_file", config.web.note_file}};
  std::vector<NamedFile> files;
  for (const auto& [key, path] : keys)
    if (path) files.push_back({key, *path});
  return files;
}

}  // namespace slamgw
