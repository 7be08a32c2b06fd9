// SPDX-License-Identifier: Apache-2.0
// Which address handles the board has given out. Handles are indexes into a table of 32 in the
// board's flash, shared by subscriptions and publications; publications that were not used for
// longest make room. Called by StartUp and BoardTraffic.
#pragma once

#include <algorithm>
#include <cstdint>
#include <list>
#include <optional>
#include <set>

namespace slamgw::ble {

class AddressBook {
 public:
  /// The stock firmware's table of group and unicast addresses.
  static constexpr std::size_t max_addresses = 32;

  struct Publication {
    std::uint16_t address = 0;
    std::uint16_t handle = 0;
  };

  void add_subscription(std::uint16_t address) { subscriptions_.insert(address); }
  bool is_subscribed(std::uint16_t address) const { return subscriptions_.contains(address); }

  void add_publication(Publication publication) {
    forget_publication(publication.address);
    publications_.push_front(publication);
  }
  /// The handle to send to `address` with; marks it as just used.
  std::optional<std::uint16_t> publication_handle(std::uint16_t address) {
    const auto found = std::ranges::find(publications_, address, &Publication::address);
    if (found == publications_.end()) return std::nullopt;
    publications_.splice(publications_.begin(), publications_, found);
    return found->handle;
  }
  /// The board no longer knows this handle.
  void forget_publication(std::uint16_t address) {
    publications_.remove_if([&](const Publication& p) { return p.address == address; });
  }
  bool is_full() const { return subscriptions_.size() + publications_.size() >= max_addresses; }
  /// Takes out the publication that was not used for longest.
  std::optional<Publication> take_least_recent() {
    if (publications_.empty()) return std::nullopt;
    const Publication last = publications_.back();
    publications_.pop_back();
    return last;
  }

 private:
  std::set<std::uint16_t> subscriptions_;
  std::list<Publication> publications_;  ///< most recently used first
};

}  // namespace slamgw::ble
