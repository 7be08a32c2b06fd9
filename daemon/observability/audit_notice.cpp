// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/audit_notice.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <boost/algorithm/string/split.hpp>
#include <fstream>
#include <nlohmann/json.hpp>
#include <vector>

#include "daemon/core/parse_number.hpp"
#include "daemon/core/result.hpp"
#include "daemon/core/topic_scheme.hpp"
#include "daemon/core/utf8.hpp"

namespace slamgw {

namespace {

constexpr const char* all_letters = "--all";

/// Returns the choice as the operator types it, with the first of very many ids.
std::string words_of(const DeadLetterChoice& choice) {
  constexpr std::size_t most = 100;
  if (choice.is_all) return all_letters;
  if (!choice.topic.empty()) return "--topic " + choice.topic;
  const std::vector<std::uint64_t>& ids = choice.ids;
  const std::size_t shown = std::min(ids.size(), most);
  const auto end = ids.begin() + static_cast<std::ptrdiff_t>(shown);
  return fmt::format("{}", fmt::join(ids.begin(), end, " ")) +
         (shown == ids.size() ? "" : fmt::format(" and {} more", ids.size() - shown));
}

std::uint64_t count_letters(const std::string& answer) {
  const auto numbers = nlohmann::json::parse(answer);
  return numbers.value("discarded", numbers.value("resent", std::uint64_t{0}));
}

}  // namespace

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
  if (const auto* resend = std::get_if<ResendOrder>(&order))
    return AuditedOrder{"store resend", {}, words_of(resend->choice)};
  if (const auto* discard = std::get_if<DiscardOrder>(&order))
    return AuditedOrder{"store discard", {}, words_of(discard->choice)};
  return std::nullopt;
}

Notice audit_notice(const std::string& who, const AuditedOrder& order, const OrderAnswer& answer) {
  std::string error = answer.error.substr(0, answer.error.find('\n'));
  std::string done = "done";
  if (error.empty() && !order.letters.empty()) {
    const std::uint64_t count = count_letters(answer.json);
    done += fmt::format(" ({} dead letter{})", count, count == 1 ? "" : "s");
    if (count == 0 && order.letters != all_letters) error = "there is no such dead letter";
  }
  const bool is_done = error.empty();
  const std::string object = order.letters.empty() ? order.robot : order.letters;
  Notice notice{Severity::notice,
                fmt::format("{}{}{}: {}; asked by {}", order.what, object.empty() ? "" : " ",
                            object, is_done ? done : "failed: " + error, who),
                is_valid_level(order.robot) ? order.robot : escape_unprintable(order.robot)};
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
