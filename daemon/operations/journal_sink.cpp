// SPDX-License-Identifier: Apache-2.0
#include "daemon/operations/journal_sink.hpp"

#include <fmt/format.h>
#include <sys/uio.h>
#include <syslog.h>

#define SD_JOURNAL_SUPPRESS_LOCATION
#include <systemd/sd-journal.h>

#include <string>
#include <vector>

namespace slamgw {
namespace {

int priority_of(Severity severity) {
  switch (severity) {
    case Severity::debug: return LOG_DEBUG;
    case Severity::info: return LOG_INFO;
    case Severity::notice: return LOG_NOTICE;
    case Severity::warning: return LOG_WARNING;
    case Severity::error: return LOG_ERR;
  }
  return LOG_ERR;
}

}  // namespace

void JournalSink::sink_it_(const spdlog::details::log_msg& message) {
  const std::string_view text(message.payload.data(), message.payload.size());
  std::vector<std::string> entries{
      fmt::format("MESSAGE={}", text),
      fmt::format("PRIORITY={}", priority_of(context_.severity)),
      "SYSLOG_IDENTIFIER=slam-gatewayd",
  };
  if (context_.fields) {
    for (const LogField& field : *context_.fields) {
      entries.push_back(fmt::format("{}={}", field.name, field.value));
    }
  }
  std::vector<iovec> vectors;
  for (std::string& entry : entries) vectors.push_back({entry.data(), entry.size()});
  sd_journal_sendv(vectors.data(), static_cast<int>(vectors.size()));
}

}  // namespace slamgw
