// SPDX-License-Identifier: Apache-2.0
// The broker's user name and password: from the file that `broker.credentials_file` names, else
// from the systemd credential `broker`. Neither ever shows in a problem.
#pragma once

#include "daemon/config/checks.hpp"
#include "daemon/config/files.hpp"
#include "daemon/config/parse.hpp"

namespace slamgw {

/// How others can read or change this secret, and the remedy; empty when they cannot. `forbidden`:
/// bits of the mode, which `remedy` takes away.
std::string fault_of_secret(const std::string& path, const FileText& file,
                            unsigned forbidden = 0007, const char* remedy = "type: sudo chmod o=");
/// Sets `result.config.broker.credentials`. What the service will read and this process must not
/// use (`credential_source` without a credentials directory) is only checked.
void read_credentials(const Located& located, ParseResult& result, const Surroundings& surroundings,
                      const Files& files);

}  // namespace slamgw
