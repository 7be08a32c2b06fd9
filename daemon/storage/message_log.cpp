// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/message_log.hpp"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <utility>

namespace slamgw {
namespace {

using std::chrono::milliseconds;

constexpr unsigned retain_flag = 1;
constexpr unsigned dead_letter_flag = 8;
constexpr std::uint64_t smallest_segment = 64u << 10;
constexpr std::uint64_t largest_segment = 4u << 20;
constexpr std::uint64_t segments = 64;

std::uint32_t part_of(std::uint64_t max_bytes) {
  return static_cast<std::uint32_t>(
      std::clamp(max_bytes / segments, smallest_segment, largest_segment));
}

WallTime wall_now() { return std::chrono::floor<milliseconds>(std::chrono::system_clock::now()); }

/// Returns at least zero, also after the clock was set back.
Duration age_of(const MessageRecord& record, WallTime now) {
  return std::clamp<Duration>(now - record.stored_at, Duration::zero(), now.time_since_epoch());
}

void write_time(ByteWriter& out, WallTime time) {
  out.write_u64_le(static_cast<std::uint64_t>(
      std::chrono::duration_cast<milliseconds>(time.time_since_epoch()).count()));
}

WallTime read_time(ByteReader& in) {
  return WallTime{milliseconds{static_cast<std::int64_t>(in.read_u64_le())}};
}

}  // namespace

Bytes encode_message(const MessageRecord& record) {
  const BrokerMessage& message = record.message;
  ByteWriter out;
  write_time(out, record.stored_at);
  write_time(out, message.provenance ? message.provenance->received_at : WallTime{});
  const std::size_t mesh = message.provenance ? 1 + index_of(message.provenance->mesh) : 0;
  out.write_u8(static_cast<std::uint8_t>(mesh));
  out.write_u8(static_cast<std::uint8_t>(static_cast<unsigned>(message.qos) << 1U |
                                         (message.retain ? retain_flag : 0U) |
                                         (record.dead ? dead_letter_flag : 0U)));
  out.write_u16_le(static_cast<std::uint16_t>(message.topic.size())).write(message.topic);
  if (record.dead) {
    const std::string_view reason =
        std::string_view(record.dead->reason).substr(0, MessageLog::max_reason_bytes);
    write_time(out, record.dead->set_aside_at);
    out.write_u32_le(static_cast<std::uint32_t>(record.dead->code))
        .write_u32_le(record.dead->tries);
    out.write_u16_le(static_cast<std::uint16_t>(reason.size())).write(reason);
  }
  out.write(message.payload);
  return out.take();
}

std::optional<MessageRecord> decode_message(ByteView octets) {
  ByteReader in(octets);
  MessageRecord record;
  BrokerMessage& message = record.message;
  record.stored_at = read_time(in);
  const WallTime received_at = read_time(in);
  const std::size_t mesh = in.read_u8();
  const unsigned flags = in.read_u8();
  message.topic = as_text(in.read(in.read_u16_le()));
  if ((flags & dead_letter_flag) != 0) {
    DeadLetterFacts& dead = record.dead.emplace();
    dead.set_aside_at = read_time(in);
    dead.code = static_cast<int>(in.read_u32_le());
    dead.tries = in.read_u32_le();
    dead.reason = as_text(in.read(in.read_u16_le()));
  }
  const ByteView payload = in.read_rest();
  if (!in.ok()) return std::nullopt;
  message.payload.assign(payload.begin(), payload.end());
  message.qos = (flags >> 1U & 3U) == 2 ? Qos::exactly_once : Qos::at_least_once;
  message.retain = (flags & retain_flag) != 0;
  if (mesh > 0 && mesh <= all_meshes.size())
    message.provenance = Provenance{all_meshes[mesh - 1], received_at};
  return record;
}

MessageLog::MessageLog(const std::string& directory, std::uint64_t max_bytes, bool skips_unreadable)
    : log_(directory + "/messages", part_of(max_bytes)), lost_(log_.open(skips_unreadable)) {
  read_all(skips_unreadable);
  if (log_.is_read_only()) opened_.why_read_only = LogError(directory, EROFS).what();
}

void MessageLog::read_all(bool skips_unreadable) {
  const WallTime now = wall_now();
  bool is_first = true;
  for (auto row = log_.next(0); row; row = log_.next(*row)) {
    const auto record = find(*row, skips_unreadable);
    if (record)
      opened_.shares.add_named(flow_of(record->message.topic), stored_cost(record->message));
    if (record && record->dead) {
      add_letter(*row, *record);
      continue;
    }
    ++opened_.count;
    if (!record) continue;  // load() finds and reports the damage
    opened_.bytes += stored_cost(record->message);
    opened_.topics.add(record->message.topic, 1);
    if (std::exchange(is_first, false)) opened_.oldest_age = age_of(*record, now);
  }
  opened_.last_row = log_.last_key();
  opened_.dead_letters = dead_letters();
  for (const auto& [topic, letters] : topics_) {
    if (opened_.dead_topics.size() == StoreOpened::max_dead_topics) break;
    if (letters.retried.empty()) continue;
    const auto first = find(letters.retried.begin()->second, skips_unreadable);
    if (first && first->dead)
      opened_.dead_topics.push_back(
          {topic, {first->dead->code, first->dead->reason}, letters.retried.size()});
  }
}

std::optional<MessageRecord> MessageLog::find(std::uint64_t row, bool skips_unreadable) const {
  const auto octets = log_.read(row, skips_unreadable);
  return octets ? decode_message(*octets) : std::nullopt;
}

std::optional<MessageRecord> MessageLog::find_letter(std::uint64_t id) const {
  auto record = find(id);
  if (record && !record->dead) record.reset();
  return record;
}

/// Returns a dead letter that the disk cannot read with its topic, and zeros as its payload: an
/// operator may discard it.
std::optional<ListedDeadLetter> MessageLog::show_letter(std::uint64_t id) const {
  try {
    auto record = find_letter(id);
    if (!record) return std::nullopt;
    return ListedDeadLetter{id, std::move(*record)};
  } catch (const LogError& error) {
    const Letter& letter = letters_.at(id);
    MessageRecord record;
    record.message.topic = letter.topic->first;
    record.message.payload.resize(letter.bytes - stored_cost(record.message));
    record.dead = DeadLetterFacts{.reason = error.what()};
    return ListedDeadLetter{id, std::move(record), true};
  }
}

/// Counts a dead letter; `record` is already in the log.
void MessageLog::add_letter(std::uint64_t id, const MessageRecord& record) {
  const DeadLetterFacts& facts = *record.dead;
  const auto topic = topics_.try_emplace(record.message.topic).first;
  const Letter& letter = letters_[id] = {stored_cost(record.message), facts.reason.size(), topic};
  letter_bytes_ += letter.bytes + letter.reason_bytes;
  ++topic->second.count;
  if (is_retried(facts.code, facts.tries))
    topic->second.retried.emplace(facts.code != 0 || facts.tries == 0, id);
}

/// Stops counting a dead letter, which is no longer in the log as one.
FormerLetter MessageLog::drop_letter(std::uint64_t id) {
  const Letter letter = letters_.extract(id).mapped();
  letter_bytes_ -= letter.bytes + letter.reason_bytes;
  LettersOfTopic& of_topic = letter.topic->second;
  const bool was_retried =
      of_topic.retried.erase({false, id}) + of_topic.retried.erase({true, id}) > 0;
  FormerLetter former{id, letter.topic->first, letter.bytes, was_retried};
  if (--of_topic.count == 0) topics_.erase(letter.topic);
  return former;
}

std::size_t MessageLog::write(const WriteToStore& write) {
  const WallTime now = wall_now();
  std::map<std::uint64_t, MessageRecord> letters;
  std::map<std::uint64_t, const BrokerMessage*> kept;
  std::vector<std::uint64_t> gone = write.forget;
  std::size_t damaged = 0;
  for (const StoredMessage& stored : write.keep) kept[stored.row] = &stored.message;
  for (const NewDeadLetter& letter : write.dead_letters) {
    const auto fresh = kept.extract(letter.row);
    auto record = fresh ? MessageRecord{now, *fresh.mapped()} : find(letter.row);
    if (record) {
      record->dead = {now, letter.code, letter.tries, letter.reason};
      letters[letter.row] = std::move(*record);
    } else if (log_.has(letter.row)) {
      gone.push_back(letter.row);
      ++damaged;
    }
  }
  for (const auto& [row, message] : kept) put(row, {now, *message});
  for (const auto& [row, record] : letters) put(row, record);
  for (const std::uint64_t row : gone) log_.erase(row);
  log_.commit(true);
  for (const auto& [row, record] : letters) add_letter(row, record);
  return damaged;
}

StoreLoaded MessageLog::load(const LoadFromStore& request, bool skips_unreadable) {
  const WallTime now = wall_now();
  StoreLoaded loaded;
  std::size_t bytes = 0;
  for (auto row = log_.next(request.after); row; row = log_.next(*row)) {
    if (letters_.contains(*row)) continue;
    if (loaded.messages.size() >= request.max_messages || bytes >= request.max_bytes) break;
    const std::uint32_t size = log_.bytes_of(*row);
    bytes += size;
    if (auto record = find(*row, skips_unreadable)) {
      loaded.messages.push_back({*row, std::move(record->message), age_of(*record, now)});
    } else {
      loaded.damaged.push_back(*row);
      loaded.damaged_bytes += stored_cost(0, size);
    }
  }
  for (const std::uint64_t row : loaded.damaged) log_.erase(row);
  log_.commit(true);
  return loaded;
}

std::vector<ListedDeadLetter> MessageLog::list(const std::string& topic, std::uint64_t after,
                                               std::size_t max_count, std::size_t max_bytes) const {
  std::vector<ListedDeadLetter> page;
  std::size_t bytes = 0;
  for (auto at = letters_.upper_bound(after); at != letters_.end(); ++at) {
    if (page.size() >= max_count || bytes >= max_bytes) break;
    if (!topic.empty() && at->second.topic->first != topic) continue;
    auto listed = show_letter(at->first);
    if (!listed) continue;
    const BrokerMessage& message = listed->record.message;
    bytes += message.topic.size() + message.payload.size();
    page.push_back(std::move(*listed));
  }
  return page;
}

std::vector<std::uint64_t> MessageLog::ids(const DeadLetterChoice& choice) const {
  const std::set<std::uint64_t> named(choice.ids.begin(), choice.ids.end());
  std::vector<std::uint64_t> ids;
  for (const auto& [id, letter] : letters_)
    if (choice.is_all || named.contains(id) || letter.topic->first == choice.topic)
      ids.push_back(id);
  return ids;
}

std::vector<std::uint64_t> MessageLog::retried(const std::string& topic, std::size_t most) const {
  std::vector<std::uint64_t> page;
  const auto letters = topics_.find(topic);
  if (letters == topics_.end()) return page;
  for (const auto& [is_later, id] : letters->second.retried) {
    if (page.size() == most) break;
    page.push_back(id);
  }
  return page;
}

MessageLog::Revival MessageLog::revive(std::span<const std::uint64_t> ids, std::size_t most,
                                       Duration patience) {
  Revival revival;
  std::map<std::uint64_t, MessageRecord> intact;
  std::vector<std::uint64_t> read;
  std::optional<LogError> unreadable;
  for (const std::uint64_t id : ids) {
    if (intact.size() == most || revival.tried - read.size() == most_unreadable) break;
    ++revival.tried;
    try {
      if (auto record = find_letter(id))
        intact[id] = {record->stored_at, std::move(record->message)};
      read.push_back(id);
    } catch (const LogError& error) {
      unreadable = error;
      Letter& letter = letters_.at(id);
      const TimePoint now = std::chrono::steady_clock::now();
      if (!letter.unreadable_since) letter.unreadable_since = now;
      if (now - *letter.unreadable_since < patience) continue;
      auto& retried = letter.topic->second.retried;
      if (retried.erase({false, id}) + retried.erase({true, id}) > 0) why_given_up_ = error.what();
    }
  }
  if (read.empty() && unreadable) throw *unreadable;
  for (const std::uint64_t id : read) {
    const auto found = intact.find(id);
    found == intact.end() ? log_.erase(id) : put(id, found->second);
  }
  log_.commit(true);
  for (const std::uint64_t id : read) {
    auto& list = intact.contains(id) ? revival.messages : revival.damaged;
    list.push_back(drop_letter(id));
  }
  return revival;
}

std::vector<FormerLetter> MessageLog::discard(const std::vector<std::uint64_t>& ids) {
  for (const std::uint64_t id : ids) log_.erase(id);
  log_.commit(true);
  std::vector<FormerLetter> discarded;
  for (const std::uint64_t id : ids) discarded.push_back(drop_letter(id));
  return discarded;
}

}  // namespace slamgw
