// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/claim_table.hpp"

#include <algorithm>

#include "daemon/fleet/hash.hpp"

namespace slamgw::fleet {
namespace {

std::uint64_t hash_of(const std::string& robot, std::uint64_t epoch) {
  return fnv1a(std::to_string(epoch), fnv1a("\n", fnv1a(robot)));
}

}  // namespace

ClaimTable::Row ClaimTable::to_row(const Entry& entry) {
  const auto& [gateway, life] = entry.owner->first;
  return {{entry.epoch, gateway, life}, entry.since};
}

std::optional<ClaimTable::Row> ClaimTable::find(const std::string& robot) const {
  const auto row = rows_.find(robot);
  return row == rows_.end() ? std::nullopt : std::optional(to_row(row->second));
}

void ClaimTable::add(const std::string& robot, Entry& entry, const Claim& claim) {
  entry.epoch = claim.epoch;
  entry.owner = &*digests_.try_emplace({claim.gateway, claim.life}).first;
  Digest& digest = entry.owner->second;
  digest.hash ^= hash_of(robot, claim.epoch);
  ++digest.count;
}

void ClaimTable::remove(const std::string& robot, const Entry& entry) {
  Digest& digest = entry.owner->second;
  digest.hash ^= hash_of(robot, entry.epoch);
  if (--digest.count == 0) digests_.erase(digests_.find(entry.owner->first));
}

bool ClaimTable::set(const std::string& robot, const Claim& claim, WallTime now) {
  auto row = rows_.find(robot);
  if (row != rows_.end()) {
    remove(robot, row->second);
  } else {
    if (is_full()) return false;
    row = rows_.emplace(robot, Entry{}).first;
  }
  row->second.since = now;
  add(robot, row->second, claim);
  return true;
}

void ClaimTable::erase(const std::string& robot) {
  const auto row = rows_.find(robot);
  if (row == rows_.end()) return;
  remove(robot, row->second);
  rows_.erase(row);
}

void ClaimTable::clear() {
  rows_.clear();
  digests_.clear();
}

void ClaimTable::erase_life(const std::string& gateway, Life life) {
  const auto owner = digests_.find({gateway, life});
  if (owner == digests_.end()) return;
  boost::unordered::erase_if(rows_, [&](const auto& row) { return row.second.owner == &*owner; });
  digests_.erase(owner);
}

ClaimTable::Digest ClaimTable::digest_of(const std::string& gateway, Life life) const {
  const auto entry = digests_.find({gateway, life});
  return entry == digests_.end() ? Digest{} : entry->second;
}

std::vector<std::pair<std::string, std::uint64_t>> ClaimTable::claims_of(const std::string& gateway,
                                                                         Life life) const {
  std::vector<std::pair<std::string, std::uint64_t>> claims;
  const auto owner = digests_.find({gateway, life});
  if (owner == digests_.end()) return claims;
  claims.reserve(owner->second.count);
  for (const auto& [robot, entry] : rows_)
    if (entry.owner == &*owner) claims.emplace_back(robot, entry.epoch);
  std::ranges::sort(claims);
  return claims;
}

std::vector<ClaimTable::Owner> ClaimTable::owners() const {
  std::vector<Owner> owners;
  for (const auto& [owner, digest] : digests_) owners.push_back(owner);
  return owners;
}

std::map<std::string, ClaimTable::Row> ClaimTable::rows() const {
  std::map<std::string, Row> rows;
  for (const auto& [robot, entry] : rows_) rows.emplace(robot, to_row(entry));
  return rows;
}

}  // namespace slamgw::fleet
