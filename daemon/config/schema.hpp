// SPDX-License-Identifier: Apache-2.0
// Every key of the configuration in one table: its path and how its value gets into Config. The
// parser walks it, suggestions and the test of config/gateway.json's completeness read it. A new
// key is a new row here, a setting in its module and a line in config/gateway.json.
#pragma once

#include <span>
#include <string>
#include <string_view>

#include "daemon/config/config.hpp"
#include "daemon/config/value.hpp"

namespace slamgw {

/// `robots[]` stands for the list `robots`, which its row clears, and for each element, which its
/// row appends.
struct SchemaKey {
  std::string_view path;
  void (*read)(Value value, Config& config);
};

std::span<const SchemaKey> schema();
const SchemaKey* find_key(std::string_view path);
/// Returns whether keys exist below `path`, a group (`broker.tls`) or a list of them (`robots[]`).
bool is_group(std::string_view path);
/// The hint for an unknown key: the most similar known key (a misspelt neighbour, or the same name
/// in another group). When that is not close, the hint also lists all keys of its group.
std::string suggestion(std::string_view unknown_path);

}  // namespace slamgw
