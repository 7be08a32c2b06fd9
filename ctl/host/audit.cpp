// SPDX-License-Identifier: Apache-2.0
#include "ctl/host/audit.hpp"

#include <fmt/format.h>
#include <unistd.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cstdlib>
#include <vector>

#include "ctl/connection.hpp"
#include "ctl/host/installation.hpp"
#include "ctl/show.hpp"
#include "daemon/config/rules.hpp"
#include "daemon/core/parse_number.hpp"
#include "daemon/core/utf8.hpp"
#include "daemon/observability/journal_sink.hpp"
#include "daemon/observability/log_fields.hpp"

namespace slamgw::ctl {
namespace {

/// An entry takes some 0.5 KB; run_program() returns at most 4 MiB.
constexpr const char* most_entries = "1000";
constexpr const char* of_service = "_SYSTEMD_UNIT=slam-gateway.service";
constexpr const char* of_root = "_UID=0";
constexpr const char* without_journal =
    "without the journal the audit trail goes to the gateway's standard error, as the lines with "
    "\"asked by\" and those about commands: look where that goes (the terminal, docker logs "
    "CONTAINER)";

/// Selects entries of the service and of root only, because any user can write to the journal.
std::vector<std::string> journal_command(const std::string& robot) {
  std::vector<std::string> words = {
      "journalctl",
      "-q",
      "--no-pager",
      "-n",
      most_entries,
      "-o",
      "json",
      "--output-fields=MESSAGE,ROBOT_ID,SLAM_AUDIT_WHO,SLAM_AUDIT_WHAT,SLAM_AUDIT_OUTCOME"};
  for (const char* writer : {of_service, of_root}) {
    if (writer == of_root) words.emplace_back("+");
    words.insert(words.end(), {"SLAM_AUDIT=1", writer});
    if (!robot.empty()) words.push_back("ROBOT_ID=" + robot);
  }
  return words;
}

std::string ask_journal(const std::vector<std::string>& words) {
  const ProgramResult result = run_program(words);
  if (result.status == 127)
    throw Failure(std::string("this host has no journal (there is no journalctl); ") +
                  without_journal);
  if (result.status != 0)
    throw Failure(
        fmt::format("the journal cannot be read: {}; root and the members of the group "
                    "systemd-journal may read it",
                    result.output.substr(0, result.output.find('\n'))));
  return result.output;
}

void record(const AuditedOrder& order, const std::string& error) {
  std::string who = user_words(getuid());
  const char* const behind_sudo = getuid() == 0 ? std::getenv("SUDO_USER") : nullptr;
  if (behind_sudo) who += std::string(", sudo by ") + behind_sudo;
  const Notice notice = audit_notice(who, order, {{}, error});
  JournalSocket("/run/systemd/journal/socket")
      .send(journal_entry("slam-gatewayctl", notice.severity, escape_unprintable(notice.text),
                          notice_fields(notice)),
            false);
}

/// Returns a field of an entry. journalctl writes a value with control characters as numbers.
std::string field_at(const nlohmann::json& entry, const char* key) {
  const auto found = entry.find(key);
  if (found == entry.end() || !found->is_array()) return string_at(entry, key);
  std::string octets;
  for (const auto& octet : *found)
    if (octet.is_number_unsigned()) octets += static_cast<char>(octet.get<std::uint8_t>());
  return escape_unprintable(octets);
}

}  // namespace

WallTime time_of_entry(const nlohmann::json& entry) {
  const auto since_1970 = parse_number<std::int64_t>(string_at(entry, "__REALTIME_TIMESTAMP"));
  return WallTime(std::chrono::microseconds(since_1970.value_or(0)));
}

nlohmann::json audit_entries(std::string_view journal) {
  auto entries = nlohmann::json::array();
  while (!journal.empty()) {
    const std::string_view line = journal.substr(0, journal.find('\n'));
    journal.remove_prefix(std::min(line.size() + 1, journal.size()));
    const auto found = nlohmann::json::parse(line, nullptr, false);
    if (!found.is_object() || field_at(found, "SLAM_AUDIT_WHO").empty()) continue;
    nlohmann::json entry{{"at", to_iso8601_ms(time_of_entry(found))},
                         {"who", field_at(found, "SLAM_AUDIT_WHO")},
                         {"what", field_at(found, "SLAM_AUDIT_WHAT")},
                         {"outcome", field_at(found, "SLAM_AUDIT_OUTCOME")},
                         {"text", field_at(found, "MESSAGE")}};
    if (const auto robot = field_at(found, "ROBOT_ID"); !robot.empty()) entry["robot"] = robot;
    entries.push_back(std::move(entry));
  }
  return entries;
}

std::string audit_text(const nlohmann::json& entries) {
  std::string text;
  for (const auto& entry : entries) {
    const std::string robot = text_at(entry, "robot");
    text += fmt::format("{}  {}: {}{}{}: {}\n", text_at(entry, "at"), text_at(entry, "who"),
                        text_at(entry, "what"), robot.empty() ? "" : " ", robot,
                        text_at(entry, "outcome"));
  }
  return text.empty() ? "no orders were found\n" : text;
}

nlohmann::json read_audit(const std::string& robot) {
  auto entries = audit_entries(ask_journal(journal_command(robot)));
  const bool is_known =
      !entries.empty() ||
      !ask_journal({"journalctl", "-q", "--no-pager", "-n", "1", "-o", "cat", of_service}).empty();
  if (!is_known)
    throw Failure(std::string("the journal shows nothing of slam-gateway.service: if the service "
                              "runs, type sudo slam-gatewayctl audit; ") +
                  without_journal);
  return entries;
}

std::string recorded(const AuditedOrder& order, const std::function<std::string()>& act) {
  try {
    std::string text = act();
    record(order, {});
    return text;
  } catch (const std::exception& error) {
    record(order, error.what());
    throw;
  }
}

}  // namespace slamgw::ctl
