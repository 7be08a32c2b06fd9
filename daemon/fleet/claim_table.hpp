// SPDX-License-Identifier: Apache-2.0
// The greatest claim that this gateway has seen for each robot, and for each gateway a digest of
// its claims, so that two gateways see that they differ without telling each other everything.
// Pure; part of Ownership.
#pragma once

#include <boost/unordered/unordered_flat_map.hpp>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "daemon/core/time.hpp"
#include "daemon/fleet/claim.hpp"

namespace slamgw::fleet {

class ClaimTable {
 public:
  /// Rows beyond it are not kept: twice the largest fleet that was simulated.
  static constexpr std::size_t max_rows = 200'000;

  /// Number and XOR of the FNV-1a hashes of (robot, epoch).
  struct Digest {
    std::uint64_t count = 0;
    std::uint64_t hash = 0;
    bool operator==(const Digest&) const = default;
  };

  struct Row {
    Claim claim;
    WallTime since{};  ///< when this gateway learned of it
  };

  ClaimTable() = default;
  ClaimTable(const ClaimTable&) = delete;
  ClaimTable& operator=(const ClaimTable&) = delete;

  std::optional<Row> find(const std::string& robot) const;
  /// False when there is no room for another robot.
  bool set(const std::string& robot, const Claim& claim, WallTime now);
  void erase(const std::string& robot);
  void clear();
  /// Forgets what this life of the gateway has claimed.
  void erase_life(const std::string& gateway, Life life);
  /// Of all claims of this life.
  Digest digest_of(const std::string& gateway, Life life) const;
  /// Robots and epochs of this life's claims, in the order of ids. Looks at every row.
  std::vector<std::pair<std::string, std::uint64_t>> claims_of(const std::string& gateway,
                                                               Life life) const;
  using Owner = std::pair<std::string, Life>;
  /// Each life that has claims here.
  std::vector<Owner> owners() const;
  std::size_t size() const { return rows_.size(); }
  bool is_full() const { return rows_.size() >= max_rows; }
  /// A copy in the order of ids, for operators.
  std::map<std::string, Row> rows() const;

 private:
  /// A gateway remembers each robot of its fleet, so a row does not repeat its owner's name.
  using Digests = std::map<Owner, Digest>;
  struct Entry {
    std::uint64_t epoch = 0;
    Digests::value_type* owner = nullptr;
    WallTime since{};
  };

  static Row to_row(const Entry& entry);
  void add(const std::string& robot, Entry& entry, const Claim& claim);
  void remove(const std::string& robot, const Entry& entry);

  boost::unordered_flat_map<std::string, Entry> rows_;
  Digests digests_;  ///< of the lives that have claims
};

}  // namespace slamgw::fleet
