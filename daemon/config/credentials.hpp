// SPDX-License-Identifier: Apache-2.0
// The broker's user name and password: from the file that `broker.credentials_file` names, else
// from the systemd credential `broker`. Neither ever shows in a problem.
#pragma once

#include "daemon/config/parse.hpp"

namespace slamgw {

/// Returns a fault when a file or directory belongs to FileText::strange_owner; else nothing.
std::string fault_of_owner(const std::string& path, const std::string& strange_owner);
/// Describes how other users can read or change this secret, and the remedy; empty when they
/// cannot. `forbidden`: the mode bits that `remedy` removes.
std::string fault_of_secret(const std::string& path, const FileText& file,
                            unsigned forbidden = 0007, const char* remedy = "type: sudo chmod o=");
/// Sets `result.config.broker.credentials`. Without a credentials directory, `credential_source`
/// is only checked: the service will read it, and this process must not use it.
void read_credentials(ParseResult& result, const Environment& environment, const Files& files);

}  // namespace slamgw
