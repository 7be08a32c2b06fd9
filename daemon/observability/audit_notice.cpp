// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/audit_notice.hpp"

#include <fmt/format.h>

#include <boost/algorithm/string/split.hpp>
#include <fstream>
#include <vector>

#include "daemon/core/parse_number.hpp"
#include "daemon/core/result.hpp"

namespace slamgw {

std::optional<AuditedOrder> audited(const BleOrder& order) {
  using Audited = std::optional<AuditedOrder>;
  const auto simple = [](const char* what) { return Audited({what, {}}); };
  return std::visit(
      overloaded{
          [](const ScanOrder&) { return Audited(); },
          [](const JoinEventsOrder&) { return Audited(); },
          [](const NodesOrder&) { return Audited(); },
          [](const PingOrder&) { return Audited(); },
          [](const NodeConfigOrder& known) {
            return known.is_change() ? Audited({"ble config", known.robot}) : Audited();
          },
          [](const ProvisionOrder& known) {
            return Audited({"ble provision", known.robot});
          },
          [](const PermitJoinOrder& known) {
            return Audited({"ble permit-join " + known.time_words(), known.robot});
          },
          [](const RemoveOrder& known) {
            return Audited({known.is_forced ? "ble remove --force" : "ble remove", known.robot});
          },
          [&](const ImportOrder&) { return simple("ble import"); },
          [&](const ExportOrder&) { return simple("ble export"); },
          [&](const ResetBoardOrder&) { return simple("ble reset-board"); },
          [&](const MeasureHearingOrder& known) {
            return known.is_question ? Audited() : simple("ble topology --measure");
          },
          [](const RefreshKeysOrder& known) {
            if (known.is_question) return Audited();
            const bool leaves_any = known.leaves_silent || !known.left_behind.empty();
            return Audited({leaves_any ? "ble refresh-keys --leave-behind" : "ble refresh-keys",
                            fmt::format("{}", fmt::join(known.left_behind, ", "))});
          },
      },
      order);
}

std::optional<AuditedOrder> audited(const StoreOrder& order) {
  if (std::holds_alternative<ResendOrder>(order)) return AuditedOrder{"store resend", {}};
  if (std::holds_alternative<DiscardOrder>(order)) return AuditedOrder{"store discard", {}};
  return std::nullopt;
}

Notice audit_notice(const std::string& who, const AuditedOrder& order, const std::string& error) {
  const bool is_done = error.empty();
  Notice notice{Severity::notice,
                fmt::format("{}{}{}: {}{}; asked by {}", order.what, order.robot.empty() ? "" : " ",
                            order.robot,
                            is_done ? "done" : "failed: ", error.substr(0, error.find('\n')), who),
                order.robot};
  notice.audit = AuditFacts{who, order.what, is_done ? "done" : "failed"};
  return notice;
}

std::string user_words(uid_t uid, const char* users_file) {
  std::ifstream users(users_file);
  for (std::string line; std::getline(users, line);) {
    std::vector<std::string> fields;  // passwd(5): name, password, uid ...
    boost::algorithm::split(fields, line, [](char c) { return c == ':'; });
    if (fields.size() > 2 && parse_number<uid_t>(fields[2]) == uid)
      return fmt::format("uid {} ({})", uid, fields[0]);
  }
  return fmt::format("uid {}", uid);
}

}  // namespace slamgw
