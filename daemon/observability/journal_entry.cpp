// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/journal_entry.hpp"

#include <syslog.h>

namespace slamgw {
namespace {

/// A value with a line end comes after its length, 64 bits, little-endian.
void append(std::string& entry, std::string_view name, std::string_view value) {
  entry += name;
  if (value.find('\n') == value.npos) {
    entry += '=';
  } else {
    entry += '\n';
    for (int shift = 0; shift < 64; shift += 8)
      entry += static_cast<char>(static_cast<std::uint64_t>(value.size()) >> shift & 0xff);
  }
  entry += value;
  entry += '\n';
}

}  // namespace

int journal_priority(Severity severity) {
  switch (severity) {
    case Severity::debug: return LOG_DEBUG;
    case Severity::info: return LOG_INFO;
    case Severity::notice: return LOG_NOTICE;
    case Severity::warning: return LOG_WARNING;
    case Severity::error: return LOG_ERR;
  }
  return LOG_ERR;
}

std::string journal_entry(std::string_view program, Severity severity, std::string_view text,
                          const LogFields& fields) {
  std::string entry;
  append(entry, "MESSAGE", text);
  append(entry, "PRIORITY", std::to_string(journal_priority(severity)));
  append(entry, "SYSLOG_IDENTIFIER", program);
  for (const LogField& field : fields) append(entry, field.name, field.value);
  return entry;
}

}  // namespace slamgw
