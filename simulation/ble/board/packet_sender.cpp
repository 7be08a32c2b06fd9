// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/board/packet_sender.hpp"

#include <algorithm>

namespace slamgw::sim::ble {
namespace {

constexpr std::uint8_t tx_complete = 0xd2;
constexpr std::uint8_t max_ttl = 127;
constexpr std::uint8_t default_checksum = 2;  // 0: 32 bits, 1: 64 bits
constexpr std::chrono::milliseconds segment_time{10};
constexpr std::uint8_t iv_entry_set = 0xd9;
constexpr std::uint8_t sequence_entry_set = 0xda;
constexpr std::uint32_t sequence_block = 8192;
constexpr std::size_t fixed_size = 9;  // and the friendship octet

}  // namespace

/// The parameters at the positions of all releases.
struct PacketSender::Request {
  Handle key;
  Address source;
  Handle destination;
  std::uint8_t ttl;
  bool is_forced_into_segments;
  std::uint8_t checksum;
  ByteView data;

  Request(ByteView params, const Firmware& firmware)
      : key(get_u16_le(params, 0)),
        source(get_u16_le(params, 2)),
        destination(get_u16_le(params, 4)),
        ttl(params[6]),
        is_forced_into_segments(params[7] != 0),
        checksum(params[8]),
        data(params.subspan(firmware.has_friendship_octet ? fixed_size + 1 : fixed_size)) {}
};

/// A packet of the right length consumes a token, also when it is refused.
Reply PacketSender::send(ByteView params, bool is_radio_on, TimePoint now) {
  if (params.size() < (firmware_.has_friendship_octet ? fixed_size + 1 : fixed_size)) {
    return {Status::invalid_length};
  }
  const std::uint32_t token = ++last_token_;
  const Request request(params, firmware_);
  if (const Status status = check(request, is_radio_on); status != Status::success) return {status};
  const Address destination = flash_.addresses.find(request.destination)->address;
  const bool is_segmented =
      segment_count(request.data.size()) > 1 || request.is_forced_into_segments;
  if (const Status status = check_queue(destination, is_segmented); status != Status::success) {
    return {status};
  }
  std::optional<std::uint64_t> transfer;
  if (is_segmented) {
    transfer = ++last_transfer_;
    segmented_.push_back({*transfer, token, destination});
  } else {
    unsegmented_[token] = now + segment_time;
  }
  const std::uint32_t sequence =
      take_sequence(sequence_numbers(destination, request.data.size(), is_segmented));
  to_air_.push_back(
      {{request.source, destination, request.ttl, Bytes(request.data.begin(), request.data.end()),
        sequence, encryption_of(request.key)},
       transfer});
  Reply reply;
  if (firmware_.has_tokens) put_u32_le(reply.data, token);
  return reply;
}

Status PacketSender::check(const Request& request, bool is_radio_on) const {
  if (flash_.addresses.find(request.destination) == nullptr) return Status::rejected;
  if (!flash_.is_local(request.source)) return Status::invalid_data;
  if (!encryption_of(request.key)) return Status::rejected;
  if (request.ttl > max_ttl || request.checksum > default_checksum) {
    return Status::invalid_parameter;
  }
  if (request.data.empty()) return Status::internal;
  return is_radio_on ? Status::success : Status::invalid_state;
}

/// Allows one segmented message to a destination at a time (Mesh Profile 3.6.4.1).
Status PacketSender::check_queue(Address destination, bool is_segmented) const {
  if (!is_segmented) {
    return unsegmented_.size() < max_unsegmented ? Status::success : Status::rejected;
  }
  const bool is_busy =
      std::any_of(segmented_.begin(), segmented_.end(),
                  [&](const Segmented& other) { return other.destination == destination; });
  if (is_busy) return Status::invalid_state;
  return segmented_.size() < max_segmented ? Status::success : Status::rejected;
}

/// Returns nothing for a device key whose network was deleted.
std::optional<Encryption> PacketSender::encryption_of(Handle handle) const {
  const KeyTable::Slot* slot = flash_.appkeys.find(handle);
  const bool is_device_key = slot == nullptr;
  if (is_device_key) slot = flash_.devkeys.find(handle);
  const KeyTable::Slot* subnet = slot == nullptr ? nullptr : flash_.subnets.find(slot->subnet);
  if (subnet == nullptr) return std::nullopt;
  return Encryption{subnet->key, slot->key, is_device_key};
}

Reply PacketSender::set_network_state(ByteView params) {
  if (is_state_set_) return {Status::invalid_state};
  is_state_set_ = true;
  Bytes event{iv_entry_set};
  put(event, params.first(5));  // IV index and the phase of its update
  put_u16_le(event, 0);
  events_.push_back(std::move(event));
  const std::uint32_t next = get_u16_le(params, 7) | std::uint32_t{get_u16_le(params, 9)} << 16;
  next_sequence_ = flash_.reserved_sequence = next;
  reserve_sequence();
  return {};
}

void PacketSender::reserve_sequence() {
  flash_.reserved_sequence += sequence_block;
  if (!is_state_set_) return;
  Bytes event{sequence_entry_set};
  put_u32_le(event, flash_.reserved_sequence);
  events_.push_back(std::move(event));
}

/// Reserves sequence numbers in blocks, as the firmware, which continues with the next block after
/// a reset.
std::uint32_t PacketSender::take_sequence(std::uint32_t count) {
  const std::uint32_t first = next_sequence_;
  next_sequence_ += count;
  while (flash_.reserved_sequence < next_sequence_) reserve_sequence();
  return first;
}

void PacketSender::on_transfer_ended(std::uint64_t transfer, bool is_acknowledged) {
  const auto ended = std::find_if(segmented_.begin(), segmented_.end(),
                                  [&](const Segmented& s) { return s.transfer == transfer; });
  if (ended == segmented_.end()) return;  // the board has restarted
  if (is_acknowledged) complete(ended->token);
  segmented_.erase(ended);
}

std::optional<TimePoint> PacketSender::deadline() const {
  std::optional<TimePoint> next;
  for (const auto& [token, due] : unsegmented_) next = first_of(next, due);
  return next;
}

void PacketSender::on_deadline(TimePoint now) {
  for (auto it = unsegmented_.begin(); it != unsegmented_.end();) {
    if (it->second > now) {
      ++it;
      continue;
    }
    complete(it->first);
    it = unsegmented_.erase(it);
  }
}

void PacketSender::complete(std::uint32_t token) {
  if (!firmware_.has_tokens) return;
  Bytes event{tx_complete};
  put_u32_le(event, token);
  events_.push_back(std::move(event));
}

std::optional<PacketSender::Transmission> PacketSender::next_transmission() {
  if (to_air_.empty()) return std::nullopt;
  Transmission first = std::move(to_air_.front());
  to_air_.pop_front();
  return first;
}

std::optional<Bytes> PacketSender::next_event() {
  if (events_.empty()) return std::nullopt;
  Bytes event = std::move(events_.front());
  events_.pop_front();
  return event;
}

void PacketSender::on_state_cleared() {
  next_sequence_ = 0;
  is_state_set_ = false;
}

void PacketSender::reset() {
  unsegmented_.clear();
  segmented_.clear();
  next_sequence_ = flash_.reserved_sequence;
  is_state_set_ = false;
  last_token_ = 0;
  to_air_.clear();
  events_.clear();
}

}  // namespace slamgw::sim::ble
