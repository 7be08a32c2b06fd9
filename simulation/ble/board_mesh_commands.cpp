// SPDX-License-Identifier: Apache-2.0
// The board's commands, second half: addresses, Packet Send, State Clear.
#include <algorithm>

#include "simulation/ble/board.hpp"

namespace slamgw::sim::ble {
namespace {

constexpr std::uint16_t virtual_addresses = 8;
constexpr std::size_t max_tokens = 64;  // the transport's queue; beyond it Packet Send is rejected
constexpr std::uint8_t max_ttl = 127;
constexpr std::chrono::milliseconds segment_time{10};

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

Board::Reply Board::local_unicast_set(ByteView params, TimePoint) {
  const std::uint32_t start = get_u16_le(params, 0);
  const std::uint32_t count = get_u16_le(params, 2);
  if (start == 0 || count == 0 || start + count - 1 > 0x7fff) {
    return {Status::invalid_parameter, {}};
  }
  if (local_count_ != 0) return {Status::rejected, {}};  // only State Clear undoes it
  local_start_ = static_cast<Address>(start);
  local_count_ = static_cast<std::uint16_t>(count);
  return {};
}

Board::Reply Board::local_unicast_get(ByteView, TimePoint) {
  Bytes data = u16(local_start_);
  put_u16_le(data, local_count_);
  return {Status::success, data};
}

Board::Reply Board::subscription_add(ByteView params, TimePoint) {
  const Address address = get_u16_le(params, 0);
  if (!is_group(address)) return {Status::invalid_parameter, {}};
  const Added added = addresses_.add_subscription(address);
  return {added.status, u16(added.handle)};
}

Board::Reply Board::subscription_remove(ByteView params, TimePoint) {
  const Handle handle = get_u16_le(params, 0);
  return {addresses_.remove_subscription(handle), u16(handle)};
}

Board::Reply Board::publication_add(ByteView params, TimePoint) {
  const Address address = get_u16_le(params, 0);
  if (!is_group(address) && !is_unicast(address)) return {Status::invalid_parameter, {}};
  const Added added = addresses_.add_publication(address);
  return {added.status, u16(added.handle)};
}

Board::Reply Board::publication_remove(ByteView params, TimePoint) {
  const Handle handle = get_u16_le(params, 0);
  return {addresses_.remove_publication(handle), u16(handle)};
}

Board::Reply Board::address_get(ByteView params, TimePoint) {
  const Handle handle = get_u16_le(params, 0);
  const AddressTable::Slot* slot = addresses_.find(handle);
  if (slot == nullptr) return {Status::rejected, {}};
  const AddressType type = is_unicast(slot->address) ? AddressType::unicast : AddressType::group;
  Bytes data = u16(handle);
  put_u8(data, static_cast<std::uint8_t>(type));
  put_u8(data, slot->subscriptions > 0 ? 1 : 0);
  put_u16_le(data, slot->address);
  return {Status::success, data};
}

Board::Reply Board::address_get_all(ByteView, TimePoint) {
  Bytes data;
  for (const Handle handle : addresses_.handles()) put_u16_le(data, handle);
  return {Status::success, data};
}

Board::Reply Board::nonvirtual_count_max(ByteView, TimePoint) {
  return {Status::success, u16(AddressTable::max_capacity)};
}

Board::Reply Board::virtual_count_max(ByteView, TimePoint) {
  return {Status::success, u16(virtual_addresses)};
}

bool Board::can_reach(Address destination) const {
  return is_group(destination) ||
         (destination >= first_robot && destination < first_robot + settings_.robots);
}

Status Board::check_packet_send(ByteView params) const {
  const Address source = get_u16_le(params, source_at);
  if (source < local_start_ || source >= local_start_ + local_count_) return Status::invalid_data;
  if (addresses_.find(get_u16_le(params, destination_at)) == nullptr) return Status::rejected;
  if (params[ttl_at] > max_ttl || params[transmic_at] > 1) return Status::invalid_parameter;
  if (params.size() == data_at) return Status::invalid_length;
  return is_enabled_ ? Status::success : Status::invalid_state;
}

Board::Reply Board::packet_send(ByteView params, TimePoint now) {
  const Handle key = get_u16_le(params, appkey_at);
  const Status status = check_packet_send(params);
  if (status != Status::success) return {status, {}};
  if (appkeys_.find(key) == nullptr && devkeys_.find(key) == nullptr) return {Status::rejected, {}};

  const ByteView data = params.subspan(data_at);
  const Address destination = addresses_.find(get_u16_le(params, destination_at))->address;
  const std::uint8_t ttl = params[ttl_at];
  const bool is_segmented = segment_count(data.size()) > 1 || params[force_segmented_at] != 0;
  std::erase_if(sessions_, [&](const Session& session) { return session.until <= now; });
  const bool is_busy =
      is_segmented && std::any_of(sessions_.begin(), sessions_.end(), [&](const Session& session) {
        return session.destination == destination;  // Mesh Profile 3.6.4.1
      });
  if (is_busy) return {Status::invalid_state, {}};
  if (is_segmented && sessions_.size() >= segmented_sessions) return {Status::rejected, {}};
  if (tokens_.size() >= max_tokens) return {Status::rejected, {}};

  Duration duration = segment_time * static_cast<int>(segment_count(data.size()));
  if (is_segmented && settings_.has_segment_timing) duration = segmented_session(destination, ttl);
  const bool fails = is_segmented && !can_reach(destination);
  if (fails) duration = failed_session(ttl);
  if (is_segmented) sessions_.push_back({destination, now + duration});
  const std::uint32_t token = ++last_token_;
  if (!fails) tokens_[token] = now + duration;  // a failed transfer shows by its absence only
  // Device keys protect configuration messages, which these robots do not take.
  if (appkeys_.find(key) != nullptr) {
    to_air_.push_back(
        {get_u16_le(params, source_at), destination, ttl, Bytes(data.begin(), data.end())});
  }
  Bytes reply;
  put_u32_le(reply, token);
  return {Status::success, reply};
}

Board::Reply Board::state_clear(ByteView, TimePoint) {
  subnets_ = KeyTable(8, 0);
  appkeys_ = KeyTable(8, 0);
  devkeys_ = KeyTable(10, 8);
  addresses_ = AddressTable();
  local_start_ = 0;
  local_count_ = 0;
  return {};
}

}  // namespace slamgw::sim::ble
