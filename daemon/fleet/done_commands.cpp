// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/done_commands.hpp"

#include <algorithm>
#include <utility>

namespace slamgw::fleet {

void DoneCommands::add(Entry entry, TimePoint now) {
  while (!entries_.empty() &&
         (now - entries_.front().came > kept_for || entries_.size() >= max_entries)) {
    entries_.pop_front();
  }
  entries_.push_back(std::move(entry));
}

const DoneCommands::Entry* DoneCommands::find(std::uint64_t key, TimePoint came) const {
  const auto found = std::ranges::find_if(entries_, [&](const Entry& each) {
    return each.command.key == key && each.came - came < heard_apart &&
           came - each.came < heard_apart;
  });
  return found == entries_.end() ? nullptr : &*found;
}

std::vector<DoneCommand> DoneCommands::of(const std::string& robot, TimePoint now) const {
  std::vector<DoneCommand> done;
  for (auto each = entries_.rbegin(); each != entries_.rend(); ++each) {
    if (each->robot != robot || now - each->came > kept_for) continue;
    if (done.size() == max_done_commands) break;
    done.push_back(each->command);
    done.back().age_ms = to_age_ms(now - each->came);
  }
  return done;
}

}  // namespace slamgw::fleet
