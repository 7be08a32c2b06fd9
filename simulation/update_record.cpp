// SPDX-License-Identifier: Apache-2.0
#include "simulation/update_record.hpp"

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <cerrno>
#include <chrono>
#include <ctime>
#include <stdexcept>
#include <system_error>

namespace slamgw::sim {
namespace {

constexpr std::int64_t us_per_s = 1000000;

/// Call with errno 0 before the operation that may fail.
void check(const std::ofstream& file, const std::string& path) {
  if (file) return;
  throw std::runtime_error(
      fmt::format("{} cannot be written: {}", path, std::generic_category().message(errno)));
}

void open(std::ofstream& file, const std::string& path) {
  if (path.empty()) return;
  errno = 0;
  file.open(path);
  check(file, path);
}

std::string_view name_of(UpdateEvent::Kind kind) {
  switch (kind) {
    case UpdateEvent::Kind::sent: return "sent";
    case UpdateEvent::Kind::acknowledged: return "acknowledged";
    case UpdateEvent::Kind::repeated: return "repeat";
    case UpdateEvent::Kind::refused: return "refused";
    case UpdateEvent::Kind::cancelled: return "cancelled";
    case UpdateEvent::Kind::given_up: return "given_up";
    case UpdateEvent::Kind::link_repeated: return "link_repeat";
    case UpdateEvent::Kind::command: return "received";
    case UpdateEvent::Kind::heard: return "heard";
  }
  return "";
}

/// ISO 8601 with microseconds, UTC.
std::string iso_8601(std::int64_t since_1970_us) {
  return fmt::format("{:%FT%T}.{:06}Z",
                     fmt::gmtime(static_cast<std::time_t>(since_1970_us / us_per_s)),
                     since_1970_us % us_per_s);
}

}  // namespace

UpdateRecord::UpdateRecord(const std::string& record, const std::string& trace,
                           std::string_view mesh)
    : record_path_(record), trace_path_(trace), mesh_(mesh) {
  open(record_, record);
  open(trace_, trace);
}

void UpdateRecord::write(const std::string& id, const UpdateEvent& event) {
  const auto since_1970_us = std::chrono::duration_cast<std::chrono::microseconds>(
                                 std::chrono::system_clock::now().time_since_epoch())
                                 .count();
  errno = 0;
  if (record_.is_open()) write_record(id, event, since_1970_us);
  const bool is_of_update =
      event.kind != UpdateEvent::Kind::command && event.kind != UpdateEvent::Kind::heard;
  if (trace_.is_open() && is_of_update) write_trace(id, event, since_1970_us);
}

void UpdateRecord::write_record(const std::string& id, const UpdateEvent& event,
                                std::int64_t since_1970_us) {
  const double seconds = static_cast<double>(since_1970_us) / us_per_s;
  if (event.is_acknowledged()) {
    record_ << fmt::format("acknowledged {} {} {:.6f}\n", id, event.number, seconds);
  } else if (event.kind == UpdateEvent::Kind::sent) {
    record_ << fmt::format("sent {} {} {:02x} {:.6f}\n", id, event.number,
                           fmt::join(event.payload, ""), seconds);
  } else if (event.kind == UpdateEvent::Kind::command) {
    const std::string payload = fmt::format("{:02x}", fmt::join(event.payload, ""));
    record_ << fmt::format("received {} {} {} {} {:.6f}\n", id, event.number, event.type,
                           payload.empty() ? "-" : payload, seconds);
  }
  if (event.kind == UpdateEvent::Kind::heard)
    record_ << fmt::format("heard {} {} {:02x} {:.6f}\n", id, event.sender,
                           fmt::join(event.payload, ""), seconds);
  record_.flush();
  check(record_, record_path_);
}

/// Writes an event as JSON. Ids come from a checked --id-prefix, so only quotes and backslashes
/// need escapes.
void UpdateRecord::write_trace(const std::string& id, const UpdateEvent& event,
                               std::int64_t since_1970_us) {
  std::string robot;
  for (const char c : id) {
    if (c == '"' || c == '\\') robot += '\\';
    robot += c;
  }
  trace_ << fmt::format(
      R"({{"at":"{}","event":"{}","robot":"{}","mesh":"{}","direction":"up","number":{})",
      iso_8601(since_1970_us), name_of(event.kind), robot, mesh_, event.number);
  if (!event.payload.empty()) {
    trace_ << fmt::format(R"(,"bytes":{},"payload":"{:02x}")", event.payload.size(),
                          fmt::join(event.payload, ""));
  }
  trace_ << "}\n" << std::flush;
  check(trace_, trace_path_);
}

}  // namespace slamgw::sim
