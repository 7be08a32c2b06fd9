// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/message_log.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <nlohmann/json.hpp>
#include <utility>

namespace slamgw {
namespace {

using nlohmann::json;
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

OrderAnswer in_json(const json& document) {
  return {document.dump(-1, ' ', false, json::error_handler_t::replace), {}};
}

json to_json(std::uint64_t id, const MessageRecord& record, bool with_payload) {
  const BrokerMessage& message = record.message;
  const DeadLetterFacts& facts = *record.dead;
  json out{{"id", id},
           {"topic", message.topic},
           {"bytes", message.payload.size()},
           {"qos", static_cast<int>(message.qos)},
           {"retain", message.retain},
           {"reason", facts.reason},
           {"code", facts.code},
           {"tries", facts.tries},
           {"stored_at", to_iso8601_ms(record.stored_at)},
           {"set_aside_at", to_iso8601_ms(facts.set_aside_at)},
           {"mesh", nullptr},
           {"received_at", nullptr}};
  if (message.provenance) {
    out["mesh"] = to_string(message.provenance->mesh);
    out["received_at"] = to_iso8601_ms(message.provenance->received_at);
  }
  if (with_payload) out["payload_hex"] = to_hex(message.payload);
  return out;
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

MessageLog::MessageLog(const StoreSettings& settings, bool skips_unreadable,
                       std::function<void(StoreEvent)> post)
    : settings_(settings),
      post_(std::move(post)),
      log_(settings.directory + "/messages", part_of(settings.max_bytes)),
      lost_(log_.open(skips_unreadable)) {
  read_all(skips_unreadable);
  if (log_.is_read_only()) opened_.why_read_only = LogError(settings.directory, EROFS).what();
}

void MessageLog::report_opened() {
  if (lost_.strays > 0)
    notify(Severity::warning,
           fmt::format("{} files in {} belong to another store, or are copies: they are left "
                       "alone, and their messages are not delivered",
                       lost_.strays, settings_.directory));
  if (lost_.lost_at_most > 0) {
    const std::string range =
        lost_.lost_at_least == lost_.lost_at_most
            ? fmt::format("{}", lost_.lost_at_least)
            : fmt::format("{} to {}", lost_.lost_at_least, lost_.lost_at_most);
    post_(MessagesLost{lost_.lost_at_most, fmt::format("the store is damaged ({}): {} messages are "
                                                       "lost",
                                                       lost_.where, range)});
  }
  post_(std::move(opened_));
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
  if (record && !record->dead) record->dead.emplace().reason = "the disk failed to read it";
  return record;
}

/// Returns what is known of a message that the disk fails to read: its topic and size.
MessageRecord MessageLog::unreadable(const NewDeadLetter& letter, const LogError& error) {
  notify(Severity::error, fmt::format("a message on {} that the broker refused cannot be read: "
                                      "{}; it is a dead letter now",
                                      letter.topic, error.what()));
  const std::uint64_t rest = stored_cost(letter.topic.size(), 0);
  return {.message = {letter.topic, Bytes(letter.bytes - std::min(letter.bytes, rest))},
          .dead = DeadLetterFacts{{}, letter.code, letter.tries, {}}};
}

/// Returns null for a damaged letter. Of a letter that the disk cannot read, only topic and size
/// are known: an operator may discard it.
json MessageLog::show_letter(std::uint64_t id, const Letter& letter, bool with_payload) const {
  try {
    const auto record = find_letter(id);
    return record ? to_json(id, *record, with_payload) : json();
  } catch (const LogError& error) {
    MessageRecord record;
    record.message.topic = letter.topic->first;
    record.dead = DeadLetterFacts{.reason = error.what()};
    json out = to_json(id, record, false);
    out["bytes"] = letter.bytes - stored_cost(letter.topic->first.size(), 0);
    for (const char* key : {"stored_at", "set_aside_at", "qos", "retain", "code", "tries"})
      out[key] = nullptr;
    return out;
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
  FormerLetter former{id, letter.topic->first, letter.bytes, stop_retrying(letter, id)};
  if (--letter.topic->second.count == 0) topics_.erase(letter.topic);
  return former;
}

/// Returns true when the letter was retried until now.
bool MessageLog::stop_retrying(const Letter& letter, std::uint64_t id) {
  auto& retried = letter.topic->second.retried;
  return retried.erase({false, id}) + retried.erase({true, id}) > 0;
}

void MessageLog::serve(const WriteToStore& write) {
  restore_files();
  const WallTime now = wall_now();
  std::map<std::uint64_t, MessageRecord> letters;
  std::map<std::uint64_t, MessageRecord> left;
  std::map<std::uint64_t, const BrokerMessage*> kept;
  std::vector<std::uint64_t> gone = write.forget;
  std::size_t damaged = 0;
  for (const StoredMessage& stored : write.keep) kept[stored.row] = &stored.message;
  for (const NewDeadLetter& letter : write.dead_letters) {
    try {
      const auto fresh = kept.extract(letter.row);
      auto record = fresh ? MessageRecord{now, *fresh.mapped()} : find(letter.row);
      if (record) {
        record->dead = {now, letter.code, letter.tries, letter.reason};
        letters[letter.row] = std::move(*record);
      } else if (log_.has(letter.row)) {
        gone.push_back(letter.row);
        ++damaged;
      }
    } catch (const LogError& error) {
      left[letter.row] = unreadable(letter, error);  // its record stays
    }
  }
  for (const auto& [row, message] : kept) put(row, {now, *message});
  for (const auto& [row, record] : letters) put(row, record);
  for (const std::uint64_t row : gone) log_.erase(row);
  log_.commit(true);
  letters.merge(left);
  for (const auto& [row, record] : letters) add_letter(row, record);
  post_(StoreWritten{});
  report_damaged(damaged);
  if (!write.dead_letters.empty()) post_(DeadLettersChanged{dead_letters()});
}

void MessageLog::serve(const LoadFromStore& request, bool skips_unreadable) {
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
  const std::size_t damaged = loaded.damaged.size();
  post_(std::move(loaded));
  report_damaged(damaged);
}

void MessageLog::serve(const RetryDeadLetters& retry, Duration patience) {
  try {
    while (true) {
      const auto ids = retried(retry.topic, retry.max_letters + max_unreadable);
      std::span<const std::uint64_t> left(ids);
      if (revive(left, retry.max_letters, retry.topic, patience) > 0) break;
      if (!ids.empty()) continue;
      post_(DeadLettersRevived{{}, retry.topic});
      break;
    }
  } catch (const LogError& error) {
    post_(DeadLettersRevived{{}, retry.topic, error.what()});
  }
  if (const std::string why = std::exchange(why_given_up_, {}); !why.empty())
    notify(Severity::error,
           fmt::format("dead letters on {} wait for an operator: {}", retry.topic, why));
}

OrderAnswer MessageLog::answer(const ListDeadLetters& order) const {
  json page = json::array();
  std::uint64_t bytes = 0;
  for (auto at = letters_.upper_bound(order.after); at != letters_.end(); ++at) {
    const auto& [id, letter] = *at;
    if (page.size() >= page_letters || bytes >= page_bytes) break;
    if (!order.topic.empty() && letter.topic->first != order.topic) continue;
    json shown = show_letter(id, letter, order.with_payloads);
    if (shown.is_null()) continue;
    bytes += letter.bytes;
    page.push_back(std::move(shown));
  }
  const bool is_more = !page.empty();
  return in_json({{"count", letters_.size()},
                  {"bytes", letter_bytes_},
                  {"letters", std::move(page)},
                  {"more", is_more}});
}

OrderAnswer MessageLog::answer(const DiscardOrder& order) {
  restore_files();
  const auto chosen = ids(order.choice);
  for (const std::uint64_t id : chosen) log_.erase(id);
  log_.commit(true);
  std::vector<FormerLetter> discarded;
  for (const std::uint64_t id : chosen) discarded.push_back(drop_letter(id));
  post_(DeadLettersChanged{dead_letters(), std::move(discarded)});
  return in_json({{"discarded", chosen.size()}});
}

OrderAnswer MessageLog::answer(const ResendOrder& order) {
  const auto chosen = ids(order.choice);
  std::span<const std::uint64_t> left(chosen);
  std::size_t resent = 0;
  try {
    while (!left.empty()) resent += revive(left, revived_at_once, {}, Duration::max());
  } catch (const LogError&) {
    // The disk fails: the other dead letters stay.
  }
  return in_json({{"resent", resent}, {"left", ids(order.choice).size()}});
}

/// Returns the ids of the chosen dead letters that exist, in rising order.
std::vector<std::uint64_t> MessageLog::ids(const DeadLetterChoice& choice) const {
  const std::set<std::uint64_t> named(choice.ids.begin(), choice.ids.end());
  std::vector<std::uint64_t> ids;
  for (const auto& [id, letter] : letters_)
    if (choice.is_all || named.contains(id) || letter.topic->first == choice.topic)
      ids.push_back(id);
  return ids;
}

/// Returns the ids of the dead letters that RetryDeadLetters means.
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

/// Turns dead letters into messages again, in their rows: the first ones, at most `most`. Returns
/// how many, and removes the ids from `ids` that it has tried. `topic`: of RetryDeadLetters.
/// Letters that the disk cannot read stay; after `patience` they are no longer among retried().
/// Throws LogError if it can read none.
std::size_t MessageLog::revive(std::span<const std::uint64_t>& ids, std::size_t most,
                               const std::string& topic, Duration patience) {
  restore_files();
  std::map<std::uint64_t, MessageRecord> intact;
  std::vector<std::uint64_t> read;
  std::optional<LogError> unreadable;
  std::size_t tried = 0;
  for (const std::uint64_t id : ids) {
    if (intact.size() == most || tried - read.size() == most_unreadable) break;
    ++tried;
    try {
      if (auto record = find_letter(id))
        intact[id] = {record->stored_at, std::move(record->message)};
      read.push_back(id);
    } catch (const LogError& error) {
      unreadable = error;
      Letter& letter = letters_.at(id);
      const TimePoint now = std::chrono::steady_clock::now();
      if (!letter.unreadable_since) letter.unreadable_since = now;
      if (now - *letter.unreadable_since >= patience && stop_retrying(letter, id))
        why_given_up_ = error.what();
    }
  }
  if (read.empty() && unreadable) throw *unreadable;
  for (const std::uint64_t id : read) {
    const auto found = intact.find(id);
    found == intact.end() ? log_.erase(id) : put(id, found->second);
  }
  log_.commit(true);
  ids = ids.subspan(tried);
  DeadLettersRevived revived{{}, topic};
  std::vector<FormerLetter> damaged;
  for (const std::uint64_t id : read)
    (intact.contains(id) ? revived.messages : damaged).push_back(drop_letter(id));
  report_damaged(damaged.size());
  if (!intact.empty()) post_(std::move(revived));
  post_(DeadLettersChanged{dead_letters(), std::move(damaged)});
  return intact.size();
}

void MessageLog::report_damaged(std::size_t messages) {
  if (messages == 0) return;
  post_(
      MessagesLost{messages, fmt::format("the store is damaged ({}/messages): {} messages are lost",
                                         settings_.directory, messages)});
}

/// Throws LogError.
void MessageLog::restore_files() {
  const auto written = log_.put_back_in_place();
  if (written.empty()) return;
  notify(Severity::error,
         fmt::format("{} was moved, removed or replaced while in use; its contents are restored "
                     "(a replaced file is now {}.replaced)",
                     fmt::join(written, ", "), written.back()));
}

void MessageLog::repair() {
  const auto attempt = [](const auto& step) {
    try {
      step();
    } catch (const LogError&) {
      // The next request fails with the same error.
    }
  };
  attempt([this] { restore_files(); });
  // A new process would find erased messages again.
  attempt([this] {
    if (log_.owes_erasures()) log_.commit(true);
  });
}

}  // namespace slamgw
