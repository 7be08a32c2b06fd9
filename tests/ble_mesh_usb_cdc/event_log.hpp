// SPDX-License-Identifier: Apache-2.0
// The events that a machine or an adapter has reported, and queries over them. Part of every rig.
#pragma once

#include <algorithm>
#include <string_view>
#include <variant>
#include <vector>

#include "daemon/core/messages.hpp"

namespace slamgw::ble {

struct EventLog {
  template <class T>
  std::vector<T> all() const {
    std::vector<T> found;
    for (const MeshEvent& event : events)
      if (const T* typed = std::get_if<T>(&event)) found.push_back(*typed);
    return found;
  }
  bool is_up() const {
    const auto changes = all<LinkChange>();
    return !changes.empty() && changes.back().is_up;
  }
  bool has_notice(std::string_view text) const { return count_notices(text) > 0; }
  std::ptrdiff_t count_notices(std::string_view text) const {
    return std::ranges::count_if(all<Notice>(), [&](const Notice& notice) {
      return notice.text.find(text) != std::string::npos;
    });
  }

  std::vector<MeshEvent> events;
};

}  // namespace slamgw::ble
