// SPDX-License-Identifier: Apache-2.0
// Finds what a gateway does not claim any more: robots that its table leaves out. A large table
// comes in many messages; all rows are looked at once for all of them. Pure; part of RobotClaims.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "daemon/fleet/claim_table.hpp"
#include "daemon/fleet/fleet_message.hpp"

namespace slamgw::fleet {

class TableSweep {
 public:
  /// Of the names that are kept between messages, all senders together. Beyond it they are
  /// forgotten, and all rows are looked at once more.
  static constexpr std::size_t max_names = ClaimTable::max_rows;

  /// Robots of this life of the sender, as far as `known` tells, that are in the range of the
  /// message and not among its rows. One that the sender claims while its messages come may be
  /// missing here; the next table has it.
  std::vector<std::string> unlisted(const ClaimTable& known, const std::string& sender, Life life,
                                    const Table& message);
  void on_last_message(const std::string& sender) { forget(sender); }
  void clear();
  /// How often all rows were looked at.
  std::uint64_t walks() const { return walks_; }

 private:
  struct Sender {
    Life life = 0;
    std::vector<std::string> robots;  ///< sorted, as they were when the table began
  };

  const Sender& sender_of(const ClaimTable& known, const std::string& sender, Life life,
                          bool is_first);
  void forget(const std::string& sender);

  std::map<std::string, Sender> senders_;
  std::size_t names_ = 0;
  std::uint64_t walks_ = 0;
};

}  // namespace slamgw::fleet
