// SPDX-License-Identifier: Apache-2.0
// An event as systemd-journald takes it: one datagram of FIELD=value (systemd's "native journal
// protocol"). Pure.
#pragma once

#include <string>
#include <string_view>

#include "daemon/observability/log.hpp"

namespace slamgw {

/// syslog(3)'s, as in `journalctl -p`: 3 error, 4 warning, 5 notice, 6 info, 7 debug.
int journal_priority(Severity severity);

/// Values may hold any octets. `program` is the name that `journalctl` shows in its lines.
std::string journal_entry(std::string_view program, Severity severity, std::string_view text,
                          const LogFields& fields);

}  // namespace slamgw
