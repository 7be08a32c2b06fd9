// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/table_sweep.hpp"

#include <algorithm>
#include <utility>

namespace slamgw::fleet {

std::vector<std::string> TableSweep::unlisted(const ClaimTable& known, const std::string& sender,
                                              Life life, const Table& message) {
  const std::vector<std::string>& robots =
      sender_of(known, sender, life, message.after.empty()).robots;
  std::vector<std::string> found;
  auto robot = std::ranges::upper_bound(robots, message.after);
  for (; robot != robots.end() && (message.upto.empty() || *robot <= message.upto); ++robot) {
    if (std::ranges::binary_search(message.rows, *robot, {}, &Table::Row::robot)) continue;
    const auto row = known.find(*robot);  // others may have claimed it since
    if (row && row->claim.gateway == sender && row->claim.life == life) found.push_back(*robot);
  }
  return found;
}

const TableSweep::Sender& TableSweep::sender_of(const ClaimTable& known, const std::string& sender,
                                                Life life, bool is_first) {
  const auto kept = senders_.find(sender);
  if (kept != senders_.end() && kept->second.life == life && !is_first) return kept->second;
  ++walks_;
  Sender fresh{life, {}};
  for (auto& [robot, epoch] : known.claims_of(sender, life))
    fresh.robots.push_back(std::move(robot));
  forget(sender);
  if (names_ + fresh.robots.size() > max_names) clear();
  names_ += fresh.robots.size();
  return senders_[sender] = std::move(fresh);
}

void TableSweep::forget(const std::string& sender) {
  const auto known = senders_.extract(sender);
  if (!known.empty()) names_ -= known.mapped().robots.size();
}

void TableSweep::clear() {
  senders_.clear();
  names_ = 0;
}

}  // namespace slamgw::fleet
