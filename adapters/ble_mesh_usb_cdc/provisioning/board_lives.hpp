// SPDX-License-Identifier: Apache-2.0
// Which unicast address the gateway sends from. A stock board forgets its sequence numbers with its
// power, and robots drop what comes again from an address with low ones. So each life of such a
// board sends from the next address, which is on disk first. Part of Provisioner.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "adapters/ble_mesh_usb_cdc/provisioning/node_table.hpp"

namespace slamgw::ble {

class BoardLives {
 public:
  /// All of them outlive it.
  BoardLives(const Settings& settings, NodeTable& nodes, ProvisionerActions& actions)
      : settings_(settings), nodes_(nodes), actions_(actions) {}

  /// Answered by UseSource. The next life begins when the board has no sequence numbers of this
  /// mesh, or is another one, whose numbers robots may have passed long ago.
  void on_source_wanted(const SourceWanted& wanted);
  void on_board_up(const LinkIsUp& up);
  /// The disk has the database, or has not.
  void on_stored(const std::string& problem);

  BoardKind kind() const;
  /// For `status`: what the board remembers, and the address that is sent from.
  std::string description() const;
  /// The address was used in an earlier life already: robots may not hear it.
  bool is_reused() const;
  std::uint32_t number() const { return life() ? life()->number : 0; }
  std::uint16_t source() const { return source_; }

 private:
  const BoardLife* life() const {
    return nodes_.database() == nullptr ? nullptr : &nodes_.database()->life;
  }
  void begin_life(BoardLife& life, std::uint32_t end);
  void answer();

  const Settings& settings_;
  NodeTable& nodes_;
  ProvisionerActions& actions_;
  std::uint16_t source_ = 0;                 ///< of the board that came up last
  std::optional<std::uint16_t> unanswered_;  ///< how many addresses the board has that waits
  std::optional<std::uint32_t> unused_;      ///< the life of which nothing was sent yet
};

}  // namespace slamgw::ble
