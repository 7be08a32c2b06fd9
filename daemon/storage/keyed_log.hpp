// SPDX-License-Identifier: Apache-2.0
// A RecordLog whose records have keys: the last record of a key counts. Blocks; used on the disk's
// thread.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "daemon/storage/record_log.hpp"

namespace slamgw {

template <class Key>
class KeyedLog {
 public:
  /// The key in a record of ours; nothing when it is none of ours.
  using KeyOf = std::optional<Key> (*)(ByteView record);

  KeyedLog(std::string directory, std::uint32_t segment_bytes, KeyOf key_of)
      : log_(std::move(directory), segment_bytes), key_of_(key_of) {}

  /// As RecordLog::replay().
  RecordLog::Summary replay(bool skips_unreadable) {
    std::vector<RecordLog::Place> outdated;
    const auto summary = log_.replay(skips_unreadable, [&](const RecordLog::Found& found) {
      if (found.is_erased) return;
      const std::optional<Key> key = key_of_(found.record);
      if (!key) return outdated.push_back(found.place);
      const auto [entry, is_new] = places_.try_emplace(*key, found.place);
      if (!is_new) outdated.push_back(std::exchange(entry->second, found.place));
    });
    log_.erase(outdated, false);
    return summary;
  }

  /// For the next commit.
  void put(Key key, ByteView record) { puts_.emplace_back(std::move(key), log_.append(record)); }
  void erase(const Key& key) { erased_.push_back(key); }
  /// All of it, or nothing, when it throws LogError.
  void commit(bool is_durable) {
    log_.commit(is_durable);
    const auto puts = std::exchange(puts_, {});
    const auto erased = std::exchange(erased_, {});
    std::vector<RecordLog::Place> outdated;
    for (const auto& [key, place] : puts) {
      const auto [entry, is_new] = places_.try_emplace(key, place);
      if (!is_new) outdated.push_back(std::exchange(entry->second, place));
    }
    for (const Key& key : erased)
      if (const auto entry = places_.extract(key)) outdated.push_back(entry.mapped());
    log_.erase(outdated, is_durable);
    if (const auto segment = log_.sparse_segment()) move_records_of(*segment, is_durable);
  }

  /// Takes back what was put and erased since the last commit.
  void drop_pending() {
    puts_.clear();
    erased_.clear();
    log_.drop_pending();
  }

  /// Nothing when there is none, or it is damaged. Throws LogError.
  std::optional<Bytes> read(const Key& key) const {
    const auto entry = places_.find(key);
    return entry == places_.end() ? std::nullopt : log_.read(entry->second);
  }
  const std::map<Key, RecordLog::Place>& places() const { return places_; }
  RecordLog& log() { return log_; }
  const RecordLog& log() const { return log_; }

 private:
  void move_records_of(std::uint32_t segment, bool is_durable) {
    std::vector<std::pair<Key, RecordLog::Place>> moved;
    std::vector<RecordLog::Place> outdated;
    try {
      for (const auto& [key, place] : places_) {
        if (place.segment != segment) continue;
        const auto record = log_.read(place);
        if (!record) continue;
        moved.emplace_back(key, log_.append(*record));
        outdated.push_back(place);
      }
      log_.commit(is_durable);
    } catch (const LogError&) {
      return log_.drop_pending();  // the disk fails: they stay where they are
    }
    for (const auto& [key, place] : moved) places_[key] = place;
    log_.erase(outdated, is_durable);
  }

  RecordLog log_;
  KeyOf key_of_;
  std::map<Key, RecordLog::Place> places_;
  std::vector<std::pair<Key, RecordLog::Place>> puts_;
  std::vector<Key> erased_;
};

}  // namespace slamgw
