// SPDX-License-Identifier: Apache-2.0
#include "web/server/places.hpp"

#include <algorithm>
#include <utility>

namespace slamgw::web {

std::size_t Places::share_of(const Client& client) const {
  return client.is_loopback ? max_ - max_ / 4 : std::max<std::size_t>(2, max_ / 4);
}

Places::Room Places::room_for(const Client& client) const {
  const auto own = std::count_if(connections_.begin(), connections_.end(), [&](const auto& entry) {
    return entry.second.client.name == client.name;
  });
  if (static_cast<std::size_t>(own) >= share_of(client)) return Room::share_is_taken;
  return connections_.size() < max_ ? Room::free : Room::all_are_taken;
}

HeldPlace Places::take(const Client& client) {
  const std::uint64_t number = ++last_;
  connections_[number].client = client;
  return {new std::uint64_t(number), [this](const std::uint64_t* place) {
            connections_.erase(*place);
            delete place;
          }};
}

void Places::set_waiting(const HeldPlace& place, std::function<void()> on_replaced) {
  const auto found = connections_.find(*place);
  if (found == connections_.end()) return;  // the connection has lost its place already
  found->second.waits_since = ++last_;
  found->second.on_replaced = std::move(on_replaced);
}

bool Places::make_room_for(const Client& client) {
  const Room room = room_for(client);
  if (room == Room::free) return true;
  auto oldest = connections_.end();
  for (auto each = connections_.begin(); each != connections_.end(); ++each) {
    const Connection& connection = each->second;
    if (!connection.on_replaced) continue;
    if (room == Room::share_is_taken && connection.client.name != client.name) continue;
    if (oldest == connections_.end() || connection.waits_since < oldest->second.waits_since)
      oldest = each;
  }
  if (oldest == connections_.end()) return false;
  const auto on_replaced = std::move(oldest->second.on_replaced);
  connections_.erase(oldest);
  on_replaced();
  return true;
}

}  // namespace slamgw::web
