// SPDX-License-Identifier: Apache-2.0
// Deadlines of many owners, ordered, so that neither a tick nor a message visits all clients. An
// owner has at most one entry and keeps its time (`armed`), so nothing stale stays behind.
#pragma once

#include <optional>
#include <set>
#include <utility>

#include "daemon/core/time.hpp"

namespace slamgw::mqttsn {

template <class Key>
class TimerQueue {
 public:
  /// Fires at `at` or before: an entry that is already earlier stays, its owner checks again then.
  void arm_by(std::optional<TimePoint>& armed, const Key& key, TimePoint at) {
    if (armed && *armed <= at) return;
    disarm(armed, key);
    entries_.emplace(at, key);
    armed = at;
  }

  void disarm(std::optional<TimePoint>& armed, const Key& key) {
    if (armed) entries_.erase({*armed, key});
    armed.reset();
  }

  std::optional<TimePoint> earliest() const {
    if (entries_.empty()) return std::nullopt;
    return entries_.begin()->first;
  }

  /// The first key that is due, taken out; its owner resets `armed`.
  std::optional<Key> pop_due(TimePoint now) {
    if (entries_.empty() || entries_.begin()->first > now) return std::nullopt;
    Key key = entries_.begin()->second;
    entries_.erase(entries_.begin());
    return key;
  }

 private:
  std::set<std::pair<TimePoint, Key>> entries_;
};

}  // namespace slamgw::mqttsn
