// SPDX-License-Identifier: Apache-2.0
// The greatest claim that this gateway has seen for each robot, and for each gateway a digest of
// its claims, so that two gateways see that they differ without telling each other everything.
// Pure; part of Ownership.
#pragma once

#include <map>
#include <string>
#include <utility>

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

  const Row* find(const std::string& robot) const;
  /// False when there is no room for another robot.
  bool set(const std::string& robot, const Claim& claim, WallTime now);
  void erase(const std::string& robot);
  /// Forgets what this life of the gateway has claimed.
  void erase_life(const std::string& gateway, Life life);
  /// Of all claims of this life.
  Digest digest_of(const std::string& gateway, Life life) const;
  std::size_t size() const { return rows_.size(); }
  /// In the order of ids.
  const std::map<std::string, Row>& rows() const { return rows_; }

 private:
  void count(const std::string& robot, const Claim& claim, bool is_added);

  std::map<std::string, Row> rows_;
  std::map<std::pair<std::string, Life>, Digest> digests_;
};

}  // namespace slamgw::fleet
