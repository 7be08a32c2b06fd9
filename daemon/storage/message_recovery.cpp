// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/message_recovery.hpp"

#include <sqlite3.h>

#include <algorithm>
#include <limits>
#include <set>
#include <tuple>
#include <utility>

namespace slamgw {
namespace {

/// One transaction of what is saved.
constexpr std::size_t batch_bytes = 1u << 20;
constexpr std::int64_t max_count = std::numeric_limits<std::int64_t>::max();

// Shapes of records (shape_of).
constexpr std::string_view message_shape = "0tbiiiiii";
constexpr std::string_view message_shape_of_version_2 = "0tbiiiii";
constexpr std::string_view message_shape_of_version_1 = "0tbiii";
constexpr std::string_view dead_letter_shape = "0tbiiiiitiiii";
constexpr std::string_view contents_shape = "0iiiiiiii";

std::size_t missing(std::int64_t expected, std::size_t found) {
  return static_cast<std::size_t>(
      std::max<std::int64_t>(0, expected - static_cast<std::int64_t>(found)));
}

MessageRow message_row(const TableRecord& record) {
  const auto& v = record.values;
  MessageRow row{record.row,  as_text(v[1].bytes), v[2].bytes,
                 v[3].number, v[4].number,         v[5].number};
  if (v.size() > 7) {
    row.mesh = v[6].number;
    row.received_at = v[7].number;
  }
  return row;
}

DeadLetterRow dead_letter_row(const TableRecord& record) {
  const auto& v = record.values;
  return {message_row(record), as_text(v[8].bytes), v[9].number, v[10].number, v[11].number};
}

}  // namespace

MessageRecovery::MessageRecovery(const std::string& path, const std::optional<StoreContents>& tally)
    : pages_(path, store_page_bytes), contents_(tally) {
  for_each_record(pages_, [this](std::uint32_t version, std::uint32_t cell,
                                 const TableRecord& record) { on_record(version, cell, record); });
  choose();
}

void MessageRecovery::on_record(std::uint32_t version, std::uint32_t cell,
                                const TableRecord& record) {
  take_contents(record);
  const auto row = row_in(record);
  if (!row) return;
  const bool is_current = pages_.versions()[version].is_current;
  found_.push_back({row->table, record.row, row->is_good, is_current, version, cell});
}

/// Rows of older formats have no checksum: they are taken as good.
std::optional<MessageRecovery::Row> MessageRecovery::row_in(const TableRecord& record) {
  const std::string shape = shape_of(record);
  if (shape == message_shape) {
    const MessageRow row = message_row(record);
    return Row{Table::messages, {row}, record.values[8].number == checksum(row)};
  }
  if (shape == dead_letter_shape) {
    const DeadLetterRow row = dead_letter_row(record);
    return Row{Table::dead_letters, row, record.values[12].number == checksum(row)};
  }
  if (shape == message_shape_of_version_2 || shape == message_shape_of_version_1) {
    return Row{Table::messages, {message_row(record)}, true};
  }
  return std::nullopt;
}

void MessageRecovery::take_contents(const TableRecord& record) {
  if (shape_of(record) != contents_shape) return;
  const auto& v = record.values;
  const StoreContents contents{v[1].number, v[2].number, v[3].number, v[4].number,
                               v[5].number, v[6].number, v[7].number};
  if (v[8].number != checksum(contents)) return;
  commits_in_file_ = std::max(commits_in_file_, contents.commits);
  if (!contents_ || contents.commits > contents_->commits) contents_ = contents;
}

/// Keeps the best version of each row: good before damaged, then current before old. Drops rows
/// that were delivered or became dead letters.
void MessageRecovery::choose() {
  const auto rank = [](const Found& found) {
    return std::tuple(found.table, found.row, !found.is_good, !found.is_current, found.version);
  };
  const auto is_same_row = [](const Found& a, const Found& b) {
    return a.table == b.table && a.row == b.row;
  };
  std::sort(found_.begin(), found_.end(),
            [&](const Found& a, const Found& b) { return rank(a) < rank(b); });
  found_.erase(std::unique(found_.begin(), found_.end(), is_same_row), found_.end());
  drop_outdated(Table::messages, contents_ ? contents_->messages : max_count);
  drop_outdated(Table::dead_letters, contents_ ? contents_->dead_letters : max_count);
  std::set<std::int64_t> dead_letters;
  for (const Found& found : found_) {
    if (found.table == Table::dead_letters && found.is_good) dead_letters.insert(found.row);
  }
  const std::int64_t first_row = contents_ ? contents_->first_row : 0;
  std::erase_if(found_, [&](const Found& found) {
    return found.table == Table::messages && found.is_good &&
           (found.row < first_row || dead_letters.contains(found.row));
  });
}

/// Older versions of pages are of use only while something is missing: they also hold rows that
/// were delivered since, which would come again.
void MessageRecovery::drop_outdated(Table table, std::int64_t expected) {
  const auto current = std::count_if(found_.begin(), found_.end(), [&](const Found& found) {
    return found.table == table && found.is_current;
  });
  if (current < expected) return;
  std::erase_if(found_,
                [&](const Found& found) { return found.table == table && !found.is_current; });
}

std::size_t MessageRecovery::count(Table table, bool is_good) const {
  return static_cast<std::size_t>(std::count_if(
      found_.begin(), found_.end(),
      [&](const Found& found) { return found.table == table && found.is_good == is_good; }));
}

MessageRecovery::Result MessageRecovery::result() const {
  Result result;
  result.messages = count(Table::messages, true);
  result.dead_letters = count(Table::dead_letters, true);
  const std::size_t damaged_messages = count(Table::messages, false);
  const std::size_t damaged_dead_letters = count(Table::dead_letters, false);
  result.damaged = damaged_messages + damaged_dead_letters;
  if (!contents_) return result;
  result.lost_messages = lost_messages(result.messages + damaged_messages);
  result.lost_dead_letters =
      missing(contents_->dead_letters, result.dead_letters + damaged_dead_letters);
  return result;
}

/// A lost message has a number between the first and the last that nothing that was found has.
MessageRecovery::Lost MessageRecovery::lost_messages(std::size_t found) const {
  const std::size_t at_least = missing(contents_->messages, found);
  const bool lacks_newest = pages_.is_log_damaged() || commits_in_file_ < contents_->commits;
  if (!lacks_newest) return {at_least, at_least};
  std::set<std::int64_t> numbers;
  for (const Found& one : found_) {
    if (one.row >= contents_->first_row && one.row <= contents_->last_row) numbers.insert(one.row);
  }
  const std::int64_t span = contents_->last_row - contents_->first_row + 1;
  const auto stored = static_cast<std::size_t>(std::max<std::int64_t>(0, contents_->messages));
  return {at_least, std::max(at_least, std::min(stored, missing(span, numbers.size())))};
}

void MessageRecovery::save_to(const std::string& path, std::uint64_t max_bytes) {
  MessageFile file(path, max_bytes, nullptr);
  StoreContents former = contents_.value_or(StoreContents{});
  for (const Found& found : found_) {
    if (found.is_good) former.last_row = std::max(former.last_row, found.row);
  }
  file.continue_from(former);
  std::vector<SavedRow> batch;
  std::size_t bytes = 0;
  for (const Found& found : found_) {
    batch.push_back(read_again(found));
    bytes += batch.back().octets.size();
    if (bytes < batch_bytes) continue;
    file.restore(std::exchange(batch, {}));
    bytes = 0;
  }
  file.restore(batch);
  file.move_log_into_file();
}

SavedRow MessageRecovery::read_again(const Found& found) {
  Bytes page;
  SavedRow saved;
  pages_.read(pages_.versions()[found.version], page);
  const auto record = read_record(pages_, page, found.cell, saved.octets);
  const auto row = record ? row_in(*record) : std::nullopt;
  if (!row || row->table != found.table || row->is_good != found.is_good) {
    throw SqliteError(SQLITE_IOERR, "the disk does not read the same twice");
  }
  saved.row = row->values;
  saved.is_dead_letter = row->table == Table::dead_letters || !row->is_good;
  if (!row->is_good) saved.row.reason = damaged_on_disk;
  return saved;
}

}  // namespace slamgw
