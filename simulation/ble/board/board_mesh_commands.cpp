// SPDX-License-Identifier: Apache-2.0
// The board's commands, second half: addresses, Packet Send, State Clear.
#include <algorithm>

#include "simulation/ble/board/board.hpp"

namespace slamgw::sim::ble {
namespace {

constexpr std::uint16_t virtual_addresses = 8;
constexpr std::size_t max_tokens = 64;  // the transport's queue; beyond it Packet Send is rejected
constexpr std::uint8_t max_ttl = 127;
constexpr std::chrono::milliseconds segment_time{10};
constexpr std::uint32_t sequence_block = 8192;

// Packet Send's parameters
constexpr std::size_t appkey_at = 0;
constexpr std::size_t source_at = 2;
constexpr std::size_t destination_at = 4;
constexpr std::size_t ttl_at = 6;
constexpr std::size_t force_segmented_at = 7;
constexpr std::size_t transmic_at = 8;
constexpr std::size_t data_at = 10;

enum class AddressType : std::uint8_t { invalid = 0, unicast = 1, virtual_label = 2, group = 3 };

Bytes u16(std::uint16_t value) {
  Bytes out;
  put_u16_le(out, value);
  return out;
}

}  // namespace

Reply Board::local_unicast_set(ByteView params, TimePoint) {
  const std::uint32_t start = get_u16_le(params, 0);
  const std::uint32_t count = get_u16_le(params, 2);
  if (start == 0 || count == 0 || start + count - 1 > 0x7fff) {
    return {Status::invalid_parameter, {}};
  }
  if (flash_.local_count != 0) return {Status::rejected, {}};  // only State Clear undoes it
  flash_.local_start = static_cast<Address>(start);
  flash_.local_count = static_cast<std::uint16_t>(count);
  return {};
}

Reply Board::local_unicast_get(ByteView, TimePoint) {
  Bytes data = u16(flash_.local_start);
  put_u16_le(data, flash_.local_count);
  return {Status::success, data};
}

Reply Board::subscription_add(ByteView params, TimePoint) {
  const Address address = get_u16_le(params, 0);
  if (!is_group(address)) return {Status::invalid_parameter, {}};
  const Added added = flash_.addresses.add_subscription(address);
  return {added.status, u16(added.handle)};
}

Reply Board::subscription_remove(ByteView params, TimePoint) {
  const Handle handle = get_u16_le(params, 0);
  return {flash_.addresses.remove_subscription(handle), u16(handle)};
}

Reply Board::publication_add(ByteView params, TimePoint) {
  const Address address = get_u16_le(params, 0);
  if (!is_group(address) && !is_unicast(address)) return {Status::invalid_parameter, {}};
  const Added added = flash_.addresses.add_publication(address);
  return {added.status, u16(added.handle)};
}

Reply Board::publication_remove(ByteView params, TimePoint) {
  const Handle handle = get_u16_le(params, 0);
  return {flash_.addresses.remove_publication(handle), u16(handle)};
}

Reply Board::address_get(ByteView params, TimePoint) {
  const Handle handle = get_u16_le(params, 0);
  const AddressTable::Slot* slot = flash_.addresses.find(handle);
  if (slot == nullptr) return {Status::rejected, {}};
  const AddressType type = is_unicast(slot->address) ? AddressType::unicast : AddressType::group;
  Bytes data = u16(handle);
  put_u8(data, static_cast<std::uint8_t>(type));
  put_u8(data, slot->subscriptions > 0 ? 1 : 0);
  put_u16_le(data, slot->address);
  return {Status::success, data};
}

Reply Board::address_get_all(ByteView, TimePoint) {
  Bytes data;
  for (const Handle handle : flash_.addresses.handles()) put_u16_le(data, handle);
  return {Status::success, data};
}

Reply Board::nonvirtual_count_max(ByteView, TimePoint) {
  return {Status::success, u16(AddressTable::max_capacity)};
}

Reply Board::virtual_count_max(ByteView, TimePoint) {
  return {Status::success, u16(virtual_addresses)};
}

Status Board::check_packet_send(ByteView params) const {
  const Address source = get_u16_le(params, source_at);
  if (flash_.addresses.find(get_u16_le(params, destination_at)) == nullptr) return Status::rejected;
  if (source < flash_.local_start || source >= flash_.local_start + flash_.local_count) {
    return Status::invalid_data;
  }
  if (params[ttl_at] > max_ttl || params[transmic_at] > 1) return Status::invalid_parameter;
  if (params.size() == data_at) return Status::invalid_length;
  return is_enabled_ ? Status::success : Status::invalid_state;
}

std::optional<Encryption> Board::encryption_of(Handle handle) const {
  const KeyTable::Slot* slot = flash_.appkeys.find(handle);
  const bool is_device_key = slot == nullptr;
  if (is_device_key) slot = flash_.devkeys.find(handle);
  if (slot == nullptr) return std::nullopt;
  return Encryption{flash_.subnets.find(slot->subnet)->key, slot->key, is_device_key};
}

Reply Board::packet_send(ByteView params, TimePoint now) {
  const std::uint32_t token = ++last_token_;  // refused messages use one up, too
  const Status status = check_packet_send(params);
  if (status != Status::success) return {status, {}};
  const std::optional<Encryption> encryption = encryption_of(get_u16_le(params, appkey_at));
  if (!encryption) return {Status::rejected, {}};

  const ByteView data = params.subspan(data_at);
  const Address destination = flash_.addresses.find(get_u16_le(params, destination_at))->address;
  const bool is_segmented = segment_count(data.size()) > 1 || params[force_segmented_at] != 0;
  const bool is_busy =
      is_segmented && std::any_of(sessions_.begin(), sessions_.end(), [&](const Session& session) {
        return session.destination == destination;  // Mesh Profile 3.6.4.1
      });
  if (is_busy) return {Status::invalid_state, {}};
  if (is_segmented && sessions_.size() >= segmented_sessions) return {Status::rejected, {}};
  if (tokens_.size() >= max_tokens) return {Status::rejected, {}};

  std::optional<std::uint64_t> transfer;
  if (is_segmented) {
    transfer = ++last_transfer_;
    sessions_.push_back({*transfer, token, destination});
  } else {
    tokens_[token] = now + segment_time;
  }
  const std::uint32_t sequence =
      take_sequence(sequence_numbers(destination, data.size(), is_segmented));
  to_air_.push_back({{get_u16_le(params, source_at), destination, params[ttl_at],
                      Bytes(data.begin(), data.end()), sequence, encryption},
                     transfer});
  Bytes reply;
  put_u32_le(reply, token);
  return {Status::success, reply};
}

/// The firmware reserves them in blocks and continues with the next block after a reset.
std::uint32_t Board::take_sequence(std::uint32_t count) {
  const std::uint32_t first = next_sequence_;
  next_sequence_ += count;
  while (flash_.reserved_sequence < next_sequence_) flash_.reserved_sequence += sequence_block;
  return first;
}

/// In 3.1.0 the sequence number begins anew, too: nodes that have heard higher ones from this
/// address discard the board's messages until it has passed them.
Reply Board::state_clear(ByteView, TimePoint) {
  flash_ = BoardFlash();
  next_sequence_ = 0;
  return {};
}

}  // namespace slamgw::sim::ble
