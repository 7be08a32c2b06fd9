// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/dead_letter_table.hpp"

#include <limits>
#include <set>

namespace slamgw {
namespace {

/// What one takes on disk: its reason and numbers lie in its row.
std::int64_t cost(std::size_t topic_bytes, std::size_t payload_bytes, std::size_t reason_bytes) {
  constexpr std::size_t numbers_bytes = 32;
  return static_cast<std::int64_t>(
      stored_cost(topic_bytes + reason_bytes + numbers_bytes, payload_bytes));
}

WallTime wall_time(std::int64_t ms) { return WallTime{std::chrono::milliseconds{ms}}; }

/// The row that `statement` is at.
ListedDeadLetter listed_at(const SqliteStatement& statement) {
  const DeadLetterRow row{message_row_at(statement), statement.text(8), statement.number(9),
                          statement.number(10), statement.number(11)};
  ListedDeadLetter listed;
  listed.letter = {static_cast<std::uint64_t>(row.message.row), message_of(row.message)};
  listed.reason = row.reason;
  listed.code = static_cast<int>(row.code);
  listed.tries = static_cast<std::uint32_t>(row.tries);
  listed.stored_at = wall_time(row.message.stored_at);
  listed.set_aside_at = wall_time(row.set_aside_at);
  const bool is_whole = statement.number(12) == checksum(row);
  if (!is_whole) listed.reason = damaged_on_disk;
  listed.is_damaged = !is_whole || row.reason == damaged_on_disk;
  return listed;
}

}  // namespace

DeadLetterTable::DeadLetterTable(SqliteDatabase& database)
    : insert_(database.prepare(
          "INSERT INTO dead_letters(id, topic, payload, qos, retain, stored_at, mesh, received_at, "
          "reason, code, tries, set_aside_at, checksum) VALUES(?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, "
          "?)")),
      sizes_(database.prepare("SELECT stored_at, length(CAST(topic AS BLOB)), length(payload), "
                              "length(CAST(reason AS BLOB)) FROM dead_letters WHERE id = ?")),
      erase_(database.prepare("DELETE FROM dead_letters WHERE id = ?")),
      select_(database.prepare(
          "SELECT id, topic, payload, qos, retain, stored_at, mesh, received_at, reason, code, "
          "tries, set_aside_at, checksum FROM dead_letters WHERE id > ? ORDER BY id")),
      ids_(database.prepare("SELECT id, topic FROM dead_letters ORDER BY stored_at, id")) {}

void DeadLetterTable::add(const DeadLetterRow& letter, StoreContents& contents) {
  DeadLetterRow row = letter;
  row.reason = row.reason.substr(0, max_reason_bytes);
  if (row.message.row < 1 || has(row.message.row)) {  // a damaged number
    row.message.row = std::numeric_limits<std::int64_t>::max();
    while (has(row.message.row)) --row.message.row;
  }
  insert_
      .bind(row.message.row, row.message.topic, row.message.payload, row.message.qos,
            row.message.retain, row.message.stored_at, row.message.mesh, row.message.received_at,
            row.reason, row.code, row.tries, row.set_aside_at, std::int64_t{checksum(row)})
      .run();
  ++contents.dead_letters;
  contents.dead_letter_bytes +=
      cost(row.message.topic.size(), row.message.payload.size(), row.reason.size());
}

bool DeadLetterTable::has(std::int64_t id) {
  const SqliteStatementReset reset{sizes_};
  sizes_.reset();
  return sizes_.bind(id).step();
}

std::optional<std::int64_t> DeadLetterTable::erase(std::int64_t id, StoreContents& contents) {
  const SqliteStatementReset reset{sizes_};
  sizes_.reset();
  if (!sizes_.bind(id).step()) return std::nullopt;
  const std::int64_t stored_at = sizes_.number(0);
  const auto size = [this](int column) { return static_cast<std::size_t>(sizes_.number(column)); };
  contents.dead_letter_bytes -= cost(size(1), size(2), size(3));
  --contents.dead_letters;
  erase_.bind(id).run();
  return stored_at;
}

std::vector<ListedDeadLetter> DeadLetterTable::list(const std::string& topic, std::uint64_t after,
                                                    std::size_t max_count, std::size_t max_bytes) {
  const SqliteStatementReset reset{select_};
  select_.reset();
  select_.bind(static_cast<std::int64_t>(after));
  std::vector<ListedDeadLetter> letters;
  std::size_t bytes = 0;
  while (letters.size() < max_count && bytes < max_bytes && select_.step()) {
    if (!topic.empty() && select_.text(1) != topic) continue;
    letters.push_back(listed_at(select_));
    const BrokerMessage& message = letters.back().letter.message;
    bytes += message.topic.size() + message.payload.size();
  }
  return letters;
}

std::optional<ListedDeadLetter> DeadLetterTable::find(std::uint64_t id) {
  auto found = list({}, id - 1, 1, 1);
  if (found.empty() || found.front().letter.id != id) return std::nullopt;
  return std::move(found.front());
}

std::vector<std::uint64_t> DeadLetterTable::ids(const DeadLetterChoice& choice) {
  const SqliteStatementReset reset{ids_};
  ids_.reset();
  const std::set<std::uint64_t> named(choice.ids.begin(), choice.ids.end());
  std::vector<std::uint64_t> chosen;
  while (ids_.step()) {
    const auto id = static_cast<std::uint64_t>(ids_.number(0));
    const bool is_of_topic = !choice.topic.empty() && ids_.text(1) == choice.topic;
    if (choice.is_all || is_of_topic || named.contains(id)) chosen.push_back(id);
  }
  return chosen;
}

}  // namespace slamgw
