// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/journal_sink.hpp"

#include <errno.h>
#include <fmt/format.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <syslog.h>
#include <unistd.h>

#include <cerrno>
#include <utility>

namespace slamgw {

namespace {

/// A value that holds a line end follows after its length (64 bits, little-endian).
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

namespace {

/// libsystemd asks for the same size; the kernel grants as much as net.core.wmem_max allows.
constexpr int send_buffer_bytes = 8 << 20;

}  // namespace

JournalSocket::JournalSocket(std::string path)
    : path_(std::move(path)),
      socket_(socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0)) {
  if (socket_ >= 0)
    setsockopt(socket_, SOL_SOCKET, SO_SNDBUF, &send_buffer_bytes, sizeof send_buffer_bytes);
}

JournalSocket::~JournalSocket() {
  if (socket_ >= 0) close(socket_);
}

void JournalSocket::send(std::string entry, bool matters) {
  if (flush()) {
    switch (try_send(entry)) {
      case Result::taken: return;
      case Result::never: ++lost_; return;
      case Result::not_now: break;
    }
  }
  if (matters && kept_.size() < max_kept) {
    kept_.push_back(std::move(entry));
  } else {
    ++lost_;
  }
}

bool JournalSocket::flush() {
  while (!kept_.empty()) {
    const Result result = try_send(kept_.front());
    if (result == Result::not_now) return false;
    if (result == Result::never) ++lost_;
    kept_.pop_front();
  }
  return true;
}

std::uint64_t JournalSocket::take_lost() { return std::exchange(lost_, 0); }

/// Sends to the path, without a connection, so that a restarted journal is found.
JournalSocket::Result JournalSocket::try_send(const std::string& entry) const {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  path_.copy(address.sun_path, sizeof address.sun_path - 1);
  const auto* generic = reinterpret_cast<const sockaddr*>(&address);
  ssize_t sent = -1;
  do {
    sent = sendto(socket_, entry.data(), entry.size(), MSG_NOSIGNAL, generic, sizeof address);
  } while (sent < 0 && errno == EINTR);
  if (sent >= 0) return Result::taken;
  return errno == EMSGSIZE ? Result::never : Result::not_now;
}

/// While the journal is stuck, robot traffic may be lost; notices and warnings are kept.
void JournalSink::sink_it_(const spdlog::details::log_msg& message) {
  const std::string_view text(message.payload.data(), message.payload.size());
  static const LogFields none;
  socket_.send(journal_entry(program_invocation_short_name, context_.severity, text,
                             context_.fields ? *context_.fields : none),
               context_.severity >= Severity::notice);
}

void JournalSink::flush_() {
  if (!socket_.flush()) {
    if (context_.when_kept) context_.when_kept();
    return;
  }
  if (lost_ += socket_.take_lost(); lost_ == 0) return;
  const auto now = std::chrono::steady_clock::now();
  if (lost_reported_at_ && now - *lost_reported_at_ < lost_interval) return;
  const std::string text =
      fmt::format("{} log entries are lost: the journal did not take them", lost_);
  socket_.send(journal_entry(program_invocation_short_name, Severity::warning, text, {}), false);
  if (socket_.take_lost() > 0) return;  // still failing
  lost_ = 0;
  lost_reported_at_ = now;
}

}  // namespace slamgw
