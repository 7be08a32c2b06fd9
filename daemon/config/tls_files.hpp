// SPDX-License-Identifier: Apache-2.0
// Whether the files that `broker.tls.*` names are what they should be, found at start rather than
// at the first connection.
#pragma once

#include "daemon/config/checks.hpp"
#include "daemon/config/files.hpp"

namespace slamgw {

void check_tls_files(const Located& located, const Files& files);

}  // namespace slamgw
