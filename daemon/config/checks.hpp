// SPDX-License-Identifier: Apache-2.0
// Checks relations between keys that are valid one by one, and the files that keys name.
// Called by the parser after all keys are read.
#pragma once

#include <map>
#include <string>

#include "daemon/config/config.hpp"
#include "daemon/config/files.hpp"
#include "daemon/config/value.hpp"

namespace slamgw {

/// The configuration as read so far, and the places of its keys.
struct Located {
  const Config& config;
  const std::map<std::string, Place>& places;
  ConfigContext& context;

  bool is_set(const std::string& key) const {
    const auto found = places.find(key);
    return found != places.end() && !found->second.is_null;
  }
  /// Returns the place of a key, or else of the nearest group above it that some file sets.
  Place place_of(std::string key) const;
  void problem(const std::string& key, std::string text) const;
};

void check_relations(const Located& located);

/// Warns of valid settings that may not do what the operator expects.
void warn_of_relations(const Located& located, Problems& warnings);

/// Checks the files of `broker.tls.*`: at the start, not only when the first connection fails.
void check_tls_files(const Located& located, const Files& files);

}  // namespace slamgw
