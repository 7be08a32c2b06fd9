// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic/board_traffic.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <utility>

namespace slamgw::ble {

void BoardTraffic::on_started(const StartedBoard& board) {
  board_ = board;
  purpose_ = Purpose::none;
  handle_to_check_.reset();
}

void BoardTraffic::on_link_down() {
  urgent_.clear();
  normal_.clear();
  purpose_ = Purpose::none;
}

// --- Sending -------------------------------------------------------------------------------------

bool BoardTraffic::send(Outgoing message) {
  withdraw(message.destination, message.payload);
  std::deque<Outgoing>& queue = message.is_urgent ? urgent_ : normal_;
  if (queue.size() >= max_queued) return false;
  assert(message.payload.size() <= send_limit(board_.version));
  queue.push_back(std::move(message));
  return true;
}

void BoardTraffic::withdraw(std::uint16_t destination, const Bytes& payload) {
  erase_messages([&](const Outgoing& message) {
    return message.destination == destination && message.payload == payload;
  });
}

void BoardTraffic::erase_messages(const auto& is_meant) {
  std::erase_if(urgent_, is_meant);
  std::erase_if(normal_, is_meant);
}

std::optional<Bytes> BoardTraffic::next(bool is_holding) {
  if (handle_to_check_) {
    purpose_ = Purpose::check_handle;
    return encode_command(CommandOpcode::address_get,
                          *std::exchange(handle_to_check_, std::nullopt));
  }
  if (next_queue().empty() || (urgent_.empty() && is_holding)) return std::nullopt;
  return next_message();
}

Bytes BoardTraffic::next_message() {
  std::deque<Outgoing>& queue = next_queue();
  destination_ = queue.front().destination;
  const auto handle = board_.addresses.publication_handle(destination_);
  if (!handle) {
    const auto oldest =
        board_.addresses.is_full() ? board_.addresses.take_least_recent() : std::nullopt;
    if (oldest) {
      purpose_ = Purpose::remove_handle;
      return encode_command(CommandOpcode::publication_remove, oldest->handle);
    }
    purpose_ = Purpose::add_handle;
    return encode_command(CommandOpcode::publication_add, destination_);
  }
  const Outgoing message = std::move(queue.front());
  queue.pop_front();
  purpose_ = Purpose::message;
  return encode_packet_send({.appkey_handle = message.key.value_or(board_.appkey_handle),
                             .source = board_.source,
                             .destination_handle = *handle,
                             .ttl = ttl_,
                             .payload = message.payload},
                            board_.version);
}

// --- Answers of the board ------------------------------------------------------------------------

void BoardTraffic::on_response(const CommandResponse& response) {
  switch (std::exchange(purpose_, Purpose::none)) {
    case Purpose::none:
    case Purpose::remove_handle: break;
    case Purpose::message: on_sent(response); break;
    case Purpose::add_handle: on_handle_added(response); break;
    case Purpose::check_handle: on_handle_checked(response); break;
  }
}

void BoardTraffic::on_handle_added(const CommandResponse& response) {
  ByteReader data(response.data);
  const std::uint16_t handle = data.read_u16_le();
  if (response.status == Status::success && data.ok())
    return board_.addresses.add_publication({destination_, handle});
  if (response.status == Status::rejected && board_.addresses.on_full()) return;
  refuse(destination_, fmt::format("the board gives no handle for 0x{:04x} ({})", destination_,
                                   to_string(response.status)));
  erase_messages([&](const Outgoing& message) { return message.destination == destination_; });
}

void BoardTraffic::on_handle_checked(const CommandResponse& response) {
  ByteReader data(response.data);
  data.read(4);  // the handle, the kind of address, whether it is subscribed
  const std::uint16_t address = data.read_u16_le();
  const bool is_known = response.status == Status::success && data.ok() && address == destination_;
  if (!is_known) board_.addresses.forget_publication(destination_);
}

void BoardTraffic::on_sent(const CommandResponse& response) {
  if (response.status == Status::success) {
    ++sent_;
    return;
  }
  // The board does not know the handle or the key. It counts how often an address was added, and
  // frees it after as many removals. So a handle that it still knows must not be added again.
  if (response.status == Status::rejected)
    handle_to_check_ = board_.addresses.publication_handle(destination_);
  refuse(destination_,
         response.status == Status::invalid_state
             ? "an earlier segmented message to this robot is still being sent"
             : fmt::format("the board refuses to send ({})", to_string(response.status)));
}

void BoardTraffic::refuse(std::uint16_t destination, std::string why) {
  ++refused_;
  actions_.push(SendRefused{destination, std::move(why)});
}

}  // namespace slamgw::ble
