// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic/address_book.hpp"

#include <algorithm>

namespace slamgw::ble {

void AddressBook::add_publication(Publication publication) {
  forget_publication(publication.address);
  publications_.push_front(publication);
}

std::optional<std::uint16_t> AddressBook::publication_handle(std::uint16_t address) {
  const auto found = std::find_if(publications_.begin(), publications_.end(),
                                  [&](const Publication& p) { return p.address == address; });
  if (found == publications_.end()) return std::nullopt;
  publications_.splice(publications_.begin(), publications_, found);
  return found->handle;
}

void AddressBook::forget_publication(std::uint16_t address) {
  publications_.remove_if([&](const Publication& p) { return p.address == address; });
}

std::optional<AddressBook::Publication> AddressBook::take_least_recent() {
  if (publications_.empty()) return std::nullopt;
  const Publication last = publications_.back();
  publications_.pop_back();
  return last;
}

}  // namespace slamgw::ble
