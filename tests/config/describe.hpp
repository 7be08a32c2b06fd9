// SPDX-License-Identifier: Apache-2.0
// A Config as text, to compare two of them. Structured bindings name every member, so that a new
// setting does not compile until it is here.
#pragma once

#include <string>

#include "daemon/config/config.hpp"

namespace slamgw::test {

std::string describe(const Config& config);

}  // namespace slamgw::test
