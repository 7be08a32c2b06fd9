// SPDX-License-Identifier: Apache-2.0
// Chooses the unicast address that the gateway sends from. A stock serial board forgets its
// sequence numbers when it loses power. Robots drop messages with low numbers from an address that
// they have heard before. So each life of such a radio sends from the next address, which is on
// disk first. Part of Provisioner.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "adapters/ble_mesh_usb_cdc/provisioning/provisioner_part.hpp"

namespace slamgw::ble {

class SourceLives : private ProvisionerPart {
 public:
  explicit SourceLives(const ProvisionerPart& shared) : ProvisionerPart(shared) {}

  /// Answers with Radio::use_source, now or in on_stored(). The next life begins if the radio has
  /// no sequence numbers of this mesh. It also begins with another radio, whose numbers robots may
  /// have passed long ago.
  void on_source_wanted(const SourceWanted& wanted, TimePoint now);
  void on_link_up(const LinkIsUp& up);
  /// `problem` is empty if the database is on disk.
  void on_stored(const std::string& problem, TimePoint now);

  RadioKind kind() const;
  /// Returns what the radio remembers and the address that it sends from, for `status`.
  std::string description() const;
  /// Returns true if an earlier life has used the address already: robots may not hear it.
  bool is_reused() const;
  std::uint32_t number() const { return life() ? life()->number : 0; }

 private:
  const RadioLife* life() const {
    return nodes_.database() == nullptr ? nullptr : &nodes_.database()->life;
  }
  void begin_life(RadioLife& life, std::uint32_t end);
  void answer(TimePoint now);

  std::optional<std::uint16_t> unanswered_;  ///< number of addresses of the radio that waits
  std::optional<std::uint32_t> unused_;      ///< the life in which nothing was sent yet
};

}  // namespace slamgw::ble
