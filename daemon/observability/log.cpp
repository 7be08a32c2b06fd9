// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/log.hpp"

#include <fmt/format.h>
#include <spdlog/pattern_formatter.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>
#include <sys/stat.h>

#include <cstdlib>
#include <memory>

#include "daemon/core/utf8.hpp"
#include "daemon/observability/journal_sink.hpp"
#include "daemon/observability/log_fields.hpp"

namespace slamgw {
namespace {

Severity least_severity = Severity::info;
LogContext context;

spdlog::level::level_enum to_spdlog(Severity severity) {
  switch (severity) {
    case Severity::debug: return spdlog::level::debug;
    case Severity::info:
    case Severity::notice: return spdlog::level::info;  // spdlog has no notice; LogContext has
    case Severity::warning: return spdlog::level::warn;
    case Severity::error: return spdlog::level::err;
  }
  return spdlog::level::err;
}

void write_event(Severity severity, std::string_view text, const LogFields& fields) {
  context.severity = severity;
  context.fields = &fields;
  spdlog::log(to_spdlog(severity), "{}", escape_unprintable(text));
  context.fields = nullptr;
}

/// `%*` in the pattern: our own severity word.
class SeverityFlag final : public spdlog::custom_flag_formatter {
 public:
  void format(const spdlog::details::log_msg&, const std::tm&, spdlog::memory_buf_t& out) override {
    fmt::format_to(std::back_inserter(out), "{:<7}", to_string(context.severity));
  }
  std::unique_ptr<custom_flag_formatter> clone() const override {
    return spdlog::details::make_unique<SeverityFlag>();
  }
};

spdlog::sink_ptr make_sink() {
  if (stderr_is_journal()) return std::make_shared<JournalSink>(context);
  auto sink = std::make_shared<spdlog::sinks::stderr_color_sink_st>();
  auto formatter = std::make_unique<spdlog::pattern_formatter>();
  formatter->add_flag<SeverityFlag>('*').set_pattern("%Y-%m-%dT%H:%M:%S.%e%z %^%*%$ %v");
  sink->set_formatter(std::move(formatter));
  return sink;
}

}  // namespace

/// Compares stderr, which may have been redirected, with the device and inode of the journal's
/// stream, which systemd gives in $JOURNAL_STREAM.
bool stderr_is_journal() {
  const char* stream = std::getenv("JOURNAL_STREAM");
  struct stat status {};
  if (!stream || fstat(2, &status) != 0) return false;
  return fmt::format("{}:{}", status.st_dev, status.st_ino) == stream;
}

std::string_view to_string(Severity severity) {
  switch (severity) {
    case Severity::debug: return "debug";
    case Severity::info: return "info";
    case Severity::notice: return "notice";
    case Severity::warning: return "warning";
    case Severity::error: return "error";
  }
  return "error";
}

void configure_log(Severity level) {
  least_severity = level;
  static const bool is_installed = [] {
    auto logger = std::make_shared<spdlog::logger>("slam-gatewayd", make_sink());
    logger->set_level(spdlog::level::trace);  // is_logged() decides
    logger->flush_on(spdlog::level::trace);
    spdlog::set_default_logger(logger);
    return true;
  }();
  static_cast<void>(is_installed);
}

bool is_logged(Severity severity) { return severity >= least_severity; }

void log_event(Severity severity, std::string_view text, const LogFields& fields) {
  if (is_logged(severity)) write_event(severity, text, fields);
}

void flush_log() { spdlog::default_logger_raw()->flush(); }

LogRetry::LogRetry(boost::asio::io_context& io) : timer_(io) {
  context.when_kept = [this] { timer_.after(interval, flush_log); };
}

LogRetry::~LogRetry() { context.when_kept = nullptr; }

void log_notice(const Notice& notice) {
  const bool is_order = notice.audit && is_operator(notice.audit->who);
  if (is_order || is_logged(notice.severity))
    write_event(notice.severity, notice.text, notice_fields(notice));
}

}  // namespace slamgw
