// SPDX-License-Identifier: Apache-2.0
// Which unicast address the gateway sends from. A stock serial board forgets its sequence numbers
// with its power, and robots drop what comes again from an address with low ones. So each life of
// such a radio sends from the next address, which is on disk first. Part of Provisioner.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "adapters/ble_mesh_usb_cdc/provisioning/provisioner_part.hpp"

namespace slamgw::ble {

class SourceLives : private ProvisionerPart {
 public:
  explicit SourceLives(const ProvisionerPart& shared) : ProvisionerPart(shared) {}

  /// Answered by Radio::use_source. The next life begins when the radio has no sequence numbers of
  /// this mesh, or is another one, whose numbers robots may have passed long ago.
  void on_source_wanted(const SourceWanted& wanted, TimePoint now);
  void on_link_up(const LinkIsUp& up);
  /// The disk has the database, or has not.
  void on_stored(const std::string& problem, TimePoint now);

  RadioKind kind() const;
  /// For `status`: what the radio remembers, and the address that is sent from.
  std::string description() const;
  /// The address was used in an earlier life already: robots may not hear it.
  bool is_reused() const;
  std::uint32_t number() const { return life() ? life()->number : 0; }

 private:
  const RadioLife* life() const {
    return nodes_.database() == nullptr ? nullptr : &nodes_.database()->life;
  }
  void begin_life(RadioLife& life, std::uint32_t end);
  void answer(TimePoint now);

  std::optional<std::uint16_t> unanswered_;  ///< how many addresses the radio has that waits
  std::optional<std::uint32_t> unused_;      ///< the life of which nothing was sent yet
};

}  // namespace slamgw::ble
