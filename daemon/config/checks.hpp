// SPDX-License-Identifier: Apache-2.0
// Checks relations between keys that are valid one by one, and the files that keys name.
// Called by the parser after all keys are read.
#pragma once

#include "daemon/config/files.hpp"
#include "daemon/config/parse_result.hpp"

namespace slamgw {

void check_relations(ParseResult& result);

/// Warns of valid settings that may not do what the operator expects.
void warn_of_relations(ParseResult& result);

/// Checks the files of `broker.tls.*`: at the start, not only when the first connection fails.
void check_tls_files(ParseResult& result, const Files& files);

}  // namespace slamgw
