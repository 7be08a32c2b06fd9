// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/claim_table.hpp"

#include "daemon/fleet/hash.hpp"

namespace slamgw::fleet {

const ClaimTable::Row* ClaimTable::find(const std::string& robot) const {
  const auto row = rows_.find(robot);
  return row == rows_.end() ? nullptr : &row->second;
}

void ClaimTable::count(const std::string& robot, const Claim& claim, bool is_added) {
  const auto entry = digests_.try_emplace({claim.gateway, claim.life}).first;
  entry->second.hash ^= fnv1a(std::to_string(claim.epoch), fnv1a(robot + '\n'));
  is_added ? ++entry->second.count : --entry->second.count;
  if (entry->second.count == 0) digests_.erase(entry);
}

bool ClaimTable::set(const std::string& robot, const Claim& claim, WallTime now) {
  const auto row = rows_.find(robot);
  if (row != rows_.end()) {
    count(robot, row->second.claim, false);
    row->second = {claim, now};
  } else {
    if (rows_.size() >= max_rows) return false;
    rows_.emplace(robot, Row{claim, now});
  }
  count(robot, claim, true);
  return true;
}

void ClaimTable::erase(const std::string& robot) {
  const auto row = rows_.find(robot);
  if (row == rows_.end()) return;
  count(robot, row->second.claim, false);
  rows_.erase(row);
}

void ClaimTable::erase_life(const std::string& gateway, Life life) {
  if (!digests_.contains({gateway, life})) return;
  std::erase_if(rows_, [&](const auto& row) {
    return row.second.claim.gateway == gateway && row.second.claim.life == life;
  });
  digests_.erase({gateway, life});
}

ClaimTable::Digest ClaimTable::digest_of(const std::string& gateway, Life life) const {
  const auto entry = digests_.find({gateway, life});
  return entry == digests_.end() ? Digest{} : entry->second;
}

}  // namespace slamgw::fleet
