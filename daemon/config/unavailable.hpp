// SPDX-License-Identifier: Apache-2.0
// Keys that ask for what this version cannot do yet: the daemon runs, and says so at start. A row
// goes when its feature comes.
#pragma once

#include "daemon/config/checks.hpp"
#include "daemon/config/problem.hpp"

namespace slamgw {

Problems unavailable_features(const Located& located);

}  // namespace slamgw
