// SPDX-License-Identifier: Apache-2.0
// spdlog sink that writes structured entries to the systemd journal. spdlog has no fields of its
// own: they come beside the message, through a context that log_event fills.
#pragma once

#include <spdlog/details/null_mutex.h>
#include <spdlog/sinks/base_sink.h>

#include "daemon/operations/log.hpp"

namespace slamgw {

/// What spdlog cannot carry about the message being written.
struct LogContext {
  Severity severity = Severity::info;
  const LogFields* fields = nullptr;
};

class JournalSink final : public spdlog::sinks::base_sink<spdlog::details::null_mutex> {
 public:
  explicit JournalSink(const LogContext& context) : context_(context) {}

 private:
  void sink_it_(const spdlog::details::log_msg& message) override;
  void flush_() override {}

  const LogContext& context_;
};

}  // namespace slamgw
