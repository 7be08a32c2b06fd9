// SPDX-License-Identifier: Apache-2.0
// A JSON syntax error in an operator's words.
#pragma once

#include <string>
#include <string_view>

namespace slamgw {

/// `message` is nlohmann-json's. What it echoes of the file is left out: it may be a secret.
std::string syntax_words(std::string_view message);

}  // namespace slamgw
