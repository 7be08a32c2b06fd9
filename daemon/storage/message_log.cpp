// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/message_log.hpp"

#include <algorithm>
#include <chrono>
#include <set>
#include <utility>

namespace slamgw {
namespace {

using std::chrono::milliseconds;

constexpr std::size_t message_header_bytes = 36;
constexpr std::size_t letter_header_bytes = 18;
constexpr std::uint64_t smallest_segment = 64u << 10;

std::uint32_t part_of(std::uint64_t max_bytes, std::uint64_t segments, std::uint64_t largest) {
  return static_cast<std::uint32_t>(std::clamp(max_bytes / segments, smallest_segment, largest));
}

std::int64_t wall_ms() {
  return std::chrono::duration_cast<milliseconds>(
             std::chrono::system_clock::now().time_since_epoch())
      .count();
}

WallTime wall_time(std::int64_t ms) { return WallTime{milliseconds{ms}}; }

/// Since `stored_at`; a clock that was set back makes nothing younger than now.
Duration age_of(std::int64_t stored_at, std::int64_t now) {
  return milliseconds{std::clamp<std::int64_t>(now - stored_at, 0, now)};
}

std::uint64_t cost_of_record(std::size_t bytes) {
  return stored_cost(0, bytes - std::min(bytes, message_header_bytes));
}

std::optional<ListedDeadLetter> decode_letter(ByteView octets) {
  ByteReader in(octets);
  ListedDeadLetter listed;
  listed.set_aside_at = wall_time(static_cast<std::int64_t>(in.read_u64_le()));
  listed.code = static_cast<int>(in.read_u32_le());
  listed.tries = in.read_u32_le();
  listed.reason = as_text(in.read(in.read_u16_le()));
  auto message = decode_message(in.read_rest());
  if (!in.ok() || !message) return std::nullopt;
  listed.letter = {message->row, std::move(message->message)};
  listed.stored_at = wall_time(message->stored_at);
  return listed;
}

std::optional<std::uint64_t> letter_id(ByteView octets) {
  const auto listed = decode_letter(octets);
  return listed ? std::optional(listed->letter.id) : std::nullopt;
}

}  // namespace

Bytes encode_message(const MessageRecord& record) {
  const BrokerMessage& message = record.message;
  ByteWriter out;
  out.write_u64_le(record.row);
  out.write_u64_le(static_cast<std::uint64_t>(record.stored_at));
  out.write_u64_le(record.dead_letter);
  const auto received = message.provenance ? message.provenance->received_at : WallTime{};
  out.write_u64_le(static_cast<std::uint64_t>(
      std::chrono::duration_cast<milliseconds>(received.time_since_epoch()).count()));
  const std::size_t mesh = message.provenance ? 1 + index_of(message.provenance->mesh) : 0;
  out.write_u8(static_cast<std::uint8_t>(mesh));
  out.write_u8(static_cast<std::uint8_t>(static_cast<unsigned>(message.qos) << 1U |
                                         (message.retain ? 1U : 0U)));
  out.write_u16_le(static_cast<std::uint16_t>(message.topic.size()));
  out.write(message.topic).write(message.payload);
  return out.take();
}

std::optional<MessageRecord> decode_message(ByteView octets) {
  ByteReader in(octets);
  MessageRecord record;
  record.row = in.read_u64_le();
  record.stored_at = static_cast<std::int64_t>(in.read_u64_le());
  record.dead_letter = in.read_u64_le();
  const auto received_at = static_cast<std::int64_t>(in.read_u64_le());
  const std::size_t mesh = in.read_u8();
  const unsigned flags = in.read_u8();
  BrokerMessage& message = record.message;
  message.topic = as_text(in.read(in.read_u16_le()));
  const ByteView payload = in.read_rest();
  if (!in.ok() || record.row == 0) return std::nullopt;
  message.payload.assign(payload.begin(), payload.end());
  message.qos = flags >> 1U == 2 ? Qos::exactly_once : Qos::at_least_once;
  message.retain = (flags & 1U) != 0;
  if (mesh > 0 && mesh <= all_meshes.size())
    message.provenance = Provenance{all_meshes[mesh - 1], wall_time(received_at)};
  return record;
}

MessageLog::MessageLog(const std::string& directory, std::uint64_t max_bytes, bool skips_unreadable)
    : messages_(directory + "/messages", part_of(max_bytes, 64, 4u << 20)),
      letters_(directory + "/dead-letters", part_of(max_bytes, 256, 1u << 20), letter_id) {
  replay_letters(skips_unreadable);
  replay(skips_unreadable);
}

void MessageLog::replay_letters(bool skips_unreadable) {
  lost_dead_letters_ = letters_.replay(skips_unreadable);
  for (const auto& [id, place] : letters_.places()) {
    if (const auto record = letters_.read(id)) add_letter(*record);
    last_row_ = std::max(last_row_, id);
  }
}

void MessageLog::replay(bool skips_unreadable) {
  const std::int64_t now = wall_ms();
  std::vector<Kept> kept;
  std::vector<RecordLog::Place> outdated;
  std::uint64_t oldest = UINT64_MAX;
  lost_messages_ = messages_.replay(skips_unreadable, [&](const RecordLog::Found& found) {
    const auto record = decode_message(found.record);
    if (record) last_row_ = std::max(last_row_, record->row);
    if (found.is_erased) return;
    // A process that was killed may have set it aside and not yet erased it here.
    if (!record || letters_here_.contains(record->row)) return outdated.push_back(found.place);
    if (record->dead_letter != 0) {
      letters_.erase(record->dead_letter);
      drop_letter(record->dead_letter);
    }
    const std::uint64_t cost = cost_of_record(found.record.size());
    opened_.bytes += cost;
    opened_.topics.add(record->message.topic);
    opened_.shares.add(record->message.topic, cost);
    if (record->row < oldest) opened_.oldest_age = age_of(record->stored_at, now);
    oldest = std::min(oldest, record->row);
    kept.push_back({record->row, found.place, found.record.size()});
  });
  messages_.erase(outdated, false);
  letters_.commit(false);
  forget_copies(kept);
  for (const Kept& one : kept) add_row(one);
  opened_.count = kept.size();
  last_row_ = std::max(last_row_, lost_messages_.mark);
  opened_.last_row = last_row_;
  opened_.dead_letters = dead_letters();
  for (const auto& [topic, ids] : retried_) {
    if (opened_.dead_topics.size() == StoreOpened::max_dead_topics) break;
    for (const ListedDeadLetter& first : retried(topic, 1))
      opened_.dead_topics.push_back({topic, {first.code, first.reason}, ids.size()});
  }
}

/// Sorts them. A process that was killed while it moved rows leaves some of them twice.
void MessageLog::forget_copies(std::vector<Kept>& found) {
  std::ranges::stable_sort(found, {}, &Kept::row);
  const auto copies = std::unique(found.begin(), found.end(),
                                  [](const Kept& a, const Kept& b) { return a.row == b.row; });
  std::vector<RecordLog::Place> places;
  for (auto copy = copies; copy != found.end(); ++copy) {
    const auto octets = messages_.read(copy->place);
    const auto record = octets ? decode_message(*octets) : std::nullopt;
    const std::uint64_t cost = cost_of_record(copy->bytes);
    opened_.bytes -= cost;
    if (record) opened_.topics.remove(record->message.topic);
    if (record) opened_.shares.remove(record->message.topic, cost);
    places.push_back(copy->place);
  }
  found.erase(copies, found.end());
  messages_.erase(places, false);
}

/// `kept.row` is the highest so far.
void MessageLog::add_row(const Kept& kept) {
  const bool is_new = rows_.empty() || rows_.rbegin()->second.segment != kept.place.segment ||
                      kept.row - rows_.rbegin()->first > UINT32_MAX;
  if (is_new) rows_[kept.row].segment = kept.place.segment;
  auto& [first, last] = *rows_.rbegin();
  last.rows.push_back({static_cast<std::uint32_t>(kept.row - first), kept.place.offset,
                       static_cast<std::uint32_t>(kept.bytes)});
  ++last.live;
}

/// Messages that wait for long do not keep the segments of those around them.
void MessageLog::move_rows_of(std::uint32_t segment) {
  std::vector<std::pair<Row*, RecordLog::Place>> moved;
  std::vector<RecordLog::Place> former;
  try {
    for (auto& [first, of_segment] : rows_) {
      if (of_segment.segment != segment) continue;
      for (Row& row : of_segment.rows) {
        if (row.offset == 0) continue;
        const auto octets = messages_.read({segment, row.offset});
        former.push_back({segment, row.offset});
        // One that is damaged is found to be so where it goes as well: it begins with a zero.
        moved.emplace_back(&row, messages_.append(octets.value_or(Bytes(1))));
      }
    }
    messages_.commit(true);
  } catch (const LogError&) {
    return messages_.drop_pending();  // the disk fails: they stay where they are
  }
  if (moved.empty()) return;
  for (const auto& [row, place] : moved) row->offset = place.offset;
  for (auto& [first, of_segment] : rows_)
    if (of_segment.segment == segment) of_segment.segment = moved.front().second.segment;
  messages_.erase(former, true);
}

MessageLog::Row* MessageLog::find_row(std::uint64_t row, std::uint32_t& segment) {
  auto after = rows_.upper_bound(row);
  if (after == rows_.begin()) return nullptr;
  auto& [first, of_segment] = *--after;
  const auto found = std::ranges::lower_bound(of_segment.rows, row - first, {}, &Row::distance);
  const bool is_there = found != of_segment.rows.end() && found->distance == row - first;
  segment = of_segment.segment;
  return is_there && found->offset != 0 ? &*found : nullptr;
}

void MessageLog::erase_rows(const std::vector<std::uint64_t>& rows) {
  std::vector<RecordLog::Place> places;
  for (const std::uint64_t row : rows) {
    std::uint32_t segment = 0;
    Row* const found = find_row(row, segment);
    if (!found) continue;
    places.push_back({segment, std::exchange(found->offset, 0)});
    const auto of_segment = std::prev(rows_.upper_bound(row));
    if (--of_segment->second.live == 0) rows_.erase(of_segment);
  }
  messages_.erase(places, true);
}

Bytes MessageLog::put_letter(std::uint64_t id, ByteView message, const NewDeadLetter& letter,
                             std::int64_t now) {
  const std::string_view reason = std::string_view(letter.reason).substr(0, max_reason_bytes);
  ByteWriter out;
  out.write_u64_le(static_cast<std::uint64_t>(now));
  out.write_u32_le(static_cast<std::uint32_t>(letter.code)).write_u32_le(letter.tries);
  out.write_u16_le(static_cast<std::uint16_t>(reason.size())).write(reason).write(message);
  letters_.put(id, out.bytes());
  return out.take();
}

/// `record` is in letters_.
void MessageLog::add_letter(ByteView record) {
  const auto listed = decode_letter(record);
  if (!listed) return;
  Letter letter{cost_of_record(record.size()), retried_.end(),
                listed->code == 0 && listed->tries > 0};
  if (is_retried(listed->code, listed->tries)) {
    letter.retried = retried_.try_emplace(listed->letter.message.topic).first;
    letter.retried->second.emplace(!letter.has_lost_connection, listed->letter.id);
  }
  drop_letter(listed->letter.id);
  letter_bytes_ += letter.bytes;
  letters_here_.emplace(listed->letter.id, letter);
}

/// It is no longer in letters_.
void MessageLog::drop_letter(std::uint64_t id) {
  const auto known = letters_here_.find(id);
  if (known == letters_here_.end()) return;
  const Letter& letter = known->second;
  letter_bytes_ -= letter.bytes;
  if (letter.retried != retried_.end()) {
    letter.retried->second.erase({!letter.has_lost_connection, id});
    if (letter.retried->second.empty()) retried_.erase(letter.retried);
  }
  letters_here_.erase(known);
}

std::size_t MessageLog::write(const WriteToStore& write) {
  const std::int64_t now = wall_ms();
  std::map<std::uint64_t, const NewDeadLetter*> new_letters;
  for (const NewDeadLetter& letter : write.dead_letters) new_letters[letter.row] = &letter;
  std::vector<Kept> kept;
  std::vector<Bytes> letters;
  std::vector<std::uint64_t> resent;
  std::size_t damaged = 0;
  bool is_committed = false;
  try {
    for (const StoredMessage& stored : write.keep) {
      MessageRecord record{stored.row, now, stored.dead_letter, stored.message};
      // A dead letter that is sent again keeps the time when it was stored first.
      if (const auto was = stored.dead_letter == 0 ? std::nullopt : find(stored.dead_letter))
        record.stored_at =
            std::chrono::duration_cast<milliseconds>(was->stored_at.time_since_epoch()).count();
      if (stored.dead_letter != 0) {
        letters_.erase(stored.dead_letter);
        resent.push_back(stored.dead_letter);
      }
      last_row_ = std::max(last_row_, stored.row);
      const Bytes octets = encode_message(record);
      if (const auto letter = new_letters.extract(stored.row)) {
        letters.push_back(put_letter(stored.row, octets, *letter.mapped(), now));
      } else {
        kept.push_back({stored.row, messages_.append(octets), octets.size()});
      }
    }
    for (const auto& [row, letter] : new_letters) {
      std::uint32_t segment = 0;
      const Row* const found = find_row(row, segment);
      if (!found) continue;
      const auto octets = messages_.read({segment, found->offset});
      if (octets) letters.push_back(put_letter(row, *octets, *letter, now));
      damaged += octets ? 0 : 1;
    }
    messages_.set_mark(last_row_);
    messages_.commit(true);
    is_committed = true;
    if (!letters.empty() || !resent.empty()) letters_.commit(true);
  } catch (const LogError&) {
    messages_.drop_pending();
    letters_.drop_pending();
    std::vector<RecordLog::Place> places;
    for (const Kept& one : kept) places.push_back(one.place);
    if (is_committed) messages_.erase(places, true);
    throw;
  }
  for (const Kept& one : kept) add_row(one);
  for (const Bytes& letter : letters) add_letter(letter);
  for (const std::uint64_t id : resent) drop_letter(id);
  std::vector<std::uint64_t> gone = write.forget;
  for (const NewDeadLetter& letter : write.dead_letters) gone.push_back(letter.row);
  erase_rows(gone);
  if (const auto segment = messages_.sparse_segment()) move_rows_of(*segment);
  return damaged;
}

StoreLoaded MessageLog::load(const LoadFromStore& request, bool skips_unreadable) {
  const std::int64_t now = wall_ms();
  StoreLoaded loaded;
  std::size_t bytes = 0;
  const auto is_full = [&] {
    return loaded.messages.size() >= request.max_messages || bytes >= request.max_bytes;
  };
  const auto take = [&](std::uint64_t row, std::uint32_t segment, const Row& of_row) {
    std::optional<Bytes> octets;
    try {
      octets = messages_.read({segment, of_row.offset});
    } catch (const LogError&) {
      if (!skips_unreadable) throw;
    }
    bytes += of_row.bytes;
    auto record = octets ? decode_message(*octets) : std::nullopt;
    if (record) {
      loaded.messages.push_back({row, std::move(record->message), age_of(record->stored_at, now)});
    } else {
      loaded.damaged.push_back(row);
      loaded.damaged_bytes += cost_of_record(of_row.bytes);
    }
  };
  auto from = rows_.upper_bound(request.after);
  if (from != rows_.begin()) --from;
  for (; from != rows_.end() && !is_full(); ++from)
    for (const Row& row : from->second.rows) {
      const std::uint64_t number = from->first + row.distance;
      if (number <= request.after || row.offset == 0) continue;
      if (is_full()) break;
      take(number, from->second.segment, row);
    }
  erase_rows(loaded.damaged);
  return loaded;
}

DeadLetterCounts MessageLog::dead_letters() const { return {letters_here_.size(), letter_bytes_}; }

std::optional<ListedDeadLetter> MessageLog::find(std::uint64_t id) const {
  const auto octets = letters_.read(id);
  return octets ? decode_letter(*octets) : std::nullopt;
}

std::vector<ListedDeadLetter> MessageLog::list(const std::string& topic, std::uint64_t after,
                                               std::size_t max_count, std::size_t max_bytes) const {
  std::vector<ListedDeadLetter> page;
  std::size_t bytes = 0;
  for (auto at = letters_.places().upper_bound(after); at != letters_.places().end(); ++at) {
    if (page.size() >= max_count || bytes >= max_bytes) break;
    auto listed = find(at->first);
    if (!listed || (!topic.empty() && listed->letter.message.topic != topic)) continue;
    bytes += listed->letter.message.topic.size() + listed->letter.message.payload.size();
    page.push_back(std::move(*listed));
  }
  return page;
}

std::vector<std::uint64_t> MessageLog::ids(const DeadLetterChoice& choice) const {
  std::vector<std::pair<WallTime, std::uint64_t>> chosen;
  const std::set<std::uint64_t> named(choice.ids.begin(), choice.ids.end());
  for (const auto& [id, place] : letters_.places()) {
    if (!choice.is_all && choice.topic.empty() && !named.contains(id)) continue;
    const auto listed = find(id);
    const bool is_chosen = choice.is_all || named.contains(id) ||
                           (listed && listed->letter.message.topic == choice.topic);
    if (is_chosen) chosen.emplace_back(listed ? listed->stored_at : WallTime{}, id);
  }
  std::ranges::sort(chosen);
  std::vector<std::uint64_t> ids;
  for (const auto& [stored_at, id] : chosen) ids.push_back(id);
  return ids;
}

std::vector<ListedDeadLetter> MessageLog::retried(const std::string& topic,
                                                  std::size_t most) const {
  std::vector<ListedDeadLetter> page;
  const auto ids = retried_.find(topic);
  if (ids == retried_.end()) return page;
  for (const auto& [is_later, id] : ids->second) {
    if (page.size() == most) break;
    if (auto listed = find(id)) page.push_back(std::move(*listed));
  }
  return page;
}

std::size_t MessageLog::discard(const DeadLetterChoice& choice) {
  const std::vector<std::uint64_t> chosen = ids(choice);
  for (const std::uint64_t id : chosen) letters_.erase(id);
  letters_.commit(true);
  for (const std::uint64_t id : chosen) drop_letter(id);
  return chosen.size();
}

std::vector<std::string> MessageLog::put_back_in_place() {
  std::vector<std::string> written = messages_.put_back_in_place();
  const auto letters = letters_.log().put_back_in_place();
  written.insert(written.end(), letters.begin(), letters.end());
  return written;
}

}  // namespace slamgw
